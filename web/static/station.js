// What every part of the page shares: who we are, asking the station, its status, and notes to the person.
import { inPageUnits } from "./units.js";

export const $ = (id) => document.getElementById(id);

/** An element: make("p", {className: "dim"}, "text", child). */
export function make(tag, fields = {}, ...children) {
  const element = Object.assign(document.createElement(tag), fields);
  for (const [name, value] of Object.entries(fields)) {
    if (name.includes("-") || name === "role") element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

function identity() {
  const known = sessionStorage.getItem("client");
  if (known !== null) return known;
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  const fresh = Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
  sessionStorage.setItem("client", fresh);
  return fresh;
}

/** Of this tab; nobody else knows it. */
export const client = identity();
export const name = {
  get: () => localStorage.getItem("name") ?? "",
  set: (text) => localStorage.setItem("name", text),
};

export class Refused extends Error {
  constructor(reason, status) { super(reason); this.status = status; }
}

let looks = new AbortController();
/** Give up every question that is asked again anyway: a browser opens six connections, and something must pass now. */
export function makeWay() {
  looks.abort();
  looks = new AbortController();
}

/** The station's answer; throws Refused with its reason, or an Error when there is no answer within `patience` [ms]. */
export async function ask(method, path, body, patience) {
  const headers = { "x-ctr-client": client, "x-ctr-name": encodeURIComponent(name.get()) };
  if (method !== "GET") headers["content-type"] = "application/json";
  const answer = await fetch(path, {
    method, headers, cache: "no-store", body: body === undefined ? undefined : JSON.stringify(body),
    signal: patience === undefined ? undefined
      : AbortSignal.any([AbortSignal.timeout(patience), ...(method === "GET" ? [looks.signal] : [])]),
  });
  const text = await answer.text();
  const read = () => { try { return JSON.parse(text); } catch { return { error: text.slice(0, 200) }; } };
  if (!answer.ok) throw new Refused(read().error ?? `answer ${answer.status}`, answer.status);
  return text === "" ? null : read();
}

let remedy = () => null;
/** Have `make(status)` give the button that is shown with what the state, or who is operator, forbids; or null. */
export const onRefusal = (make) => { remedy = make; };

/** Ask for something that a person has pressed; a refusal is shown. The answer, or null. */
export async function press(method, path, body) {
  try {
    const answer = await ask(method, path, body);
    look();
    return answer ?? {};
  } catch (error) {
    await question;
    await look(); // the way out is that of the state that has refused it
    const button = error instanceof Refused && error.status === 409 && status !== null ? remedy(status) : null;
    const before = status, same = (now) => now.state === before.state && now.operator.name === before.operator.name;
    note(error instanceof Refused ? error.message : `the station does not answer (${error.message})`, false, button, button && same);
    return null;
  }
}

const standing = new Map(); // notes, and what must hold for them

/** A note in the corner, with a button or without; gone after a while, or when `holds(status)` does no more. */
export function note(said, good = false, button = null, holds = null) {
  const text = inPageUnits(said);
  for (const old of $("notes").children) if (old.firstChild.textContent === text) old.remove(); // said once, not three times
  const close = make("button", { type: "button", "aria-label": "close" }, "×");
  const box = make("div", { className: good ? "note good" : "note" }, make("div", {}, text), button, close);
  for (const one of [button, close]) one?.addEventListener("click", () => box.remove());
  $("notes").append(box);
  while ($("notes").children.length > 4) $("notes").firstChild.remove();
  if (holds === null) setTimeout(() => box.remove(), 12000); else standing.set(box, holds);
}

let dismiss = () => {}; // the question that is open

/**
 * Have a person confirm; resolves to whether they did. Every checkbox in `content` must be ticked first.
 * The header stays alive: STOP and the state are behind no question. A newer question ends an older one.
 */
export function confirm(title, action, ...content) {
  dismiss();
  const dialog = $("question"), form = dialog.querySelector("form"), yes = dialog.querySelector("[value=yes]");
  const rest = [...dialog.parentElement.children].filter((one) => one !== dialog), ends = new AbortController(), { signal } = ends;
  dialog.querySelector("h2").textContent = title;
  form.querySelector("div").replaceChildren(...content);
  yes.textContent = action;
  const boxes = [...form.querySelectorAll("input[type=checkbox]")];
  const check = () => { yes.disabled = boxes.some((box) => !box.checked); };
  boxes.forEach((box) => box.addEventListener("change", check));
  check();
  for (const one of rest) one.inert = true;
  dialog.show();
  return new Promise((resolve) => {
    dismiss = (sure = false) => {
      dismiss = () => {};
      ends.abort();
      for (const one of rest) one.inert = false;
      dialog.close();
      resolve(sure);
    };
    form.addEventListener("submit", (event) => { event.preventDefault(); dismiss(true); }, { signal });
    dialog.querySelector("[value=no]").addEventListener("click", () => dismiss(), { signal });
    document.addEventListener("keydown", (event) => { if (event.key === "Escape") dismiss(); }, { signal });
  });
}

// ---- status: asked for several times a second; too old, it is called stale

// An answer that is late is better than none: what is old looks so meanwhile, and a question given up would never be answered.
const PERIOD = 150, PATIENCE = 10000, STALE = 480; // ms
const listeners = [];
let status = null, heard = -Infinity, question = null, wasStale = null;

/** Call `listener(status, stale)` with each status, and when it becomes stale. */
export const onStatus = (listener) => { listeners.push(listener); };
export const latest = () => status;

const age = () => performance.now() - heard + 1000 * (status?.age ?? 0);

function tell() {
  wasStale = status === null || status.stale || age() > STALE;
  document.body.classList.toggle("stale", wasStale);
  for (const listener of listeners) listener(status, wasStale);
  for (const [box, holds] of standing) if (status !== null && !(box.isConnected && holds(status))) { box.remove(); standing.delete(box); }
}

/** Ask for the status, or wait for the answer to the question that is open. */
export const look = () => (question ??= hear().finally(() => { question = null; }));

async function hear() {
  try {
    status = await ask("GET", "/api/status", undefined, PATIENCE);
    heard = performance.now();
  } catch {
    if (age() > STALE) status = null;
  }
  tell();
}

/** Whether the status is fresh, asked for once more if it is not. When it stays old a person is told that nothing was done. */
export async function fresh() {
  if (wasStale) await look();
  if (wasStale) note("nothing was started: what the page knows of the robot is old. Wait until the state is no longer stale, then press again");
  return !wasStale;
}

/** Whether this page may command now: it is operator, or nobody is and it could become so. */
export const mayCommand = (now = status) =>
  now !== null && now.operator.role === "operator" && (now.operator.you || now.operator.name === null);

export function start() {
  setInterval(look, PERIOD);
  // What is old must look old even while a question is still open.
  setInterval(() => { if (age() > STALE && !wasStale) { if (age() > 2 * STALE) status = null; tell(); } }, 50);
  look();
}
