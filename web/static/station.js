// Shared by every part of the page: the client's identity, requests to the station, its status, and notes to the user.
import { inPageUnits } from "./units.js";

export const $ = (id) => document.getElementById(id);

/** Return a new HTML element, for example make("p", {className: "dim"}, "text", child). */
export function make(tag, fields = {}, ...children) {
  const element = Object.assign(document.createElement(tag), fields);
  for (const [name, value] of Object.entries(fields)) {
    if (name.includes("-") || name === "role") element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

function identity() {
  const stored = sessionStorage.getItem("client");
  if (stored !== null) return stored;
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  const created = Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
  sessionStorage.setItem("client", created);
  return created;
}

/** Secret random identity of this browser tab. */
export const client = identity();
export const name = {
  get: () => localStorage.getItem("name") ?? "",
  set: (text) => localStorage.setItem("name", text),
};

export class Refused extends Error {
  constructor(reason, status) { super(reason); this.status = status; }
}

let polls = new AbortController();
/** Cancel all polling requests, because a browser opens at most six connections and a command needs a free one now. */
export function abortPolls() {
  polls.abort();
  polls = new AbortController();
}

/** Return the station's answer; throw Refused with the reason of a refusal, or an Error if there is no answer within `timeout` [ms]. */
export async function request(method, path, body, timeout) {
  const headers = { "x-ctr-client": client, "x-ctr-name": encodeURIComponent(name.get()) };
  if (method !== "GET") headers["content-type"] = "application/json";
  const answer = await fetch(path, {
    method, headers, cache: "no-store", body: body === undefined ? undefined : JSON.stringify(body),
    signal: timeout === undefined ? undefined
      : AbortSignal.any([AbortSignal.timeout(timeout), ...(method === "GET" ? [polls.signal] : [])]),
  });
  const text = await answer.text();
  const read = () => { try { return JSON.parse(text); } catch { return { error: text.slice(0, 200) }; } };
  if (!answer.ok) throw new Refused(read().error ?? `answer ${answer.status}`, answer.status);
  return text === "" ? null : read();
}

let remedyButton = () => null;
/** Set the function `make(status)`, which returns a button (or null) to show with a refusal of status 409. */
export const onRefusal = (make) => { remedyButton = make; };

/** Send a command of the user. Return the answer; if the command failed, show the reason and return null. */
export async function sendCommand(method, path, body) {
  try {
    const answer = await request(method, path, body);
    pollStatus();
    return answer ?? {};
  } catch (error) {
    await pending;
    await pollStatus(); // the button must fit the state that refused the command
    const button = error instanceof Refused && error.status === 409 && status !== null ? remedyButton(status) : null;
    const before = status, same = (now) => now.state === before.state && now.operator.name === before.operator.name;
    note(error instanceof Refused ? error.message : `the station does not answer (${error.message})`, false, button, button && same);
    return null;
  }
}

const lasting = new Map(); // notes that stay while a condition is true, with their conditions

/** Show a note in the corner, optionally with a button, for 12 s or as long as `isCurrent(status)` is true. */
export function note(message, good = false, button = null, isCurrent = null) {
  const text = inPageUnits(message);
  for (const old of $("notes").children) if (old.firstChild.textContent === text) old.remove(); // an older note with the same text is replaced
  const close = make("button", { type: "button", "aria-label": "close" }, "×");
  const box = make("div", { className: good ? "note good" : "note" }, make("div", {}, text), button, close);
  for (const one of [button, close]) one?.addEventListener("click", () => box.remove());
  $("notes").append(box);
  while ($("notes").children.length > 4) $("notes").firstChild.remove();
  if (isCurrent === null) setTimeout(() => box.remove(), 12000); else lasting.set(box, isCurrent);
}

let closeQuestion = () => {}; // function that closes the open question

/**
 * Ask the user to confirm; resolves to true or false. Every checkbox in `content` must be ticked first.
 * The header stays usable, because no question covers STOP and the state. A newer question cancels an older one.
 */
export function confirm(title, action, ...content) {
  closeQuestion();
  const dialog = $("question"), form = dialog.querySelector("form"), yes = dialog.querySelector("[value=yes]");
  const others = [...dialog.parentElement.children].filter((one) => one !== dialog), ends = new AbortController(), { signal } = ends;
  dialog.querySelector("h2").textContent = title;
  form.querySelector("div").replaceChildren(...content);
  yes.textContent = action;
  const boxes = [...form.querySelectorAll("input[type=checkbox]")];
  const check = () => { yes.disabled = boxes.some((box) => !box.checked); };
  boxes.forEach((box) => box.addEventListener("change", check));
  check();
  for (const one of others) one.inert = true;
  dialog.show();
  return new Promise((resolve) => {
    closeQuestion = (sure = false) => {
      closeQuestion = () => {};
      ends.abort();
      for (const one of others) one.inert = false;
      dialog.close();
      resolve(sure);
    };
    form.addEventListener("submit", (event) => { event.preventDefault(); closeQuestion(true); }, { signal });
    dialog.querySelector("[value=no]").addEventListener("click", () => closeQuestion(), { signal });
    document.addEventListener("keydown", (event) => { if (event.key === "Escape") closeQuestion(); }, { signal });
  });
}

// ---- status of the station: polled several times a second, and marked as stale if it is too old

// The timeout is long, because a late answer is useful, too. While the page waits, it marks its data as stale.
const POLL_INTERVAL_MS = 150, TIMEOUT_MS = 10000, STALE_AFTER_MS = 480; // ms
const listeners = [];
let status = null, receivedAt = -Infinity, pending = null, wasStale = null;

/** Call `listener(status, stale)` with each new status, and when the status becomes stale. */
export const onStatus = (listener) => { listeners.push(listener); };
export const latest = () => status;

const age = () => performance.now() - receivedAt + 1000 * (status?.age ?? 0);

function publish() {
  wasStale = status === null || status.stale || age() > STALE_AFTER_MS;
  document.body.classList.toggle("stale", wasStale);
  for (const listener of listeners) listener(status, wasStale);
  for (const [box, isCurrent] of lasting) if (status !== null && !(box.isConnected && isCurrent(status))) { box.remove(); lasting.delete(box); }
}

/** Request the status, or wait for the answer to the pending request. */
export const pollStatus = () => (pending ??= fetchStatus().finally(() => { pending = null; }));

async function fetchStatus() {
  try {
    status = await request("GET", "/api/status", undefined, TIMEOUT_MS);
    receivedAt = performance.now();
  } catch {
    if (age() > STALE_AFTER_MS) status = null;
  }
  publish();
}

/**
 * Return whether the status is current. A stale status is requested once more; if it stays stale, a note reports that
 * nothing was started.
 */
export async function ensureFresh() {
  if (wasStale) await pollStatus();
  if (wasStale) note("nothing was started: the page's data of the robot is stale. Wait until the state is no longer stale, then press again");
  return !wasStale;
}

/**
 * Return whether this page may send commands now: it is operator, or there is no operator and it could become
 * operator.
 */
export const mayCommand = (now = status) =>
  now !== null && now.operator.role === "operator" && (now.operator.you || now.operator.name === null);

export function start() {
  setInterval(pollStatus, POLL_INTERVAL_MS);
  // Stale data must be marked even while a request is pending.
  setInterval(() => { if (age() > STALE_AFTER_MS && !wasStale) { if (age() > 2 * STALE_AFTER_MS) status = null; publish(); } }, 50);
  pollStatus();
}
