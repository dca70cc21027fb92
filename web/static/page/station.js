// Shared by every part of the page: elements, units, the client's identity, requests, the status, and notes to the user.

import { local, session } from "./storage.js";

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

/** Return a button that calls `onclick` when it is pressed. */
export const button = (text, onclick, fields = {}) => make("button", { type: "button", onclick, ...fields }, text);

/** Return the parts of a text for `make`: commands in backticks and quoted names with underscores, which a user types, as code. */
export const withCode = (text) => text.split(/(`[^`]+`|'\w+_\w+')/).map((part, i) => (i % 2 ? make("code", {}, part.slice(1, -1)) : part));

/** Set the text of `element` only if the text changes, because setting it would clear the user's selection. */
export const setText = (element, text) => { if (element.textContent !== text) element.textContent = text; };

/**
 * Replace the children of `element` with `children()` only if `content` has changed, because replacing unchanged children
 * would interrupt a click on a button or close an open tooltip.
 */
export function replaceChanged(element, content, children) {
  const shown = JSON.stringify(content);
  if (element.dataset.shown === shown) return;
  element.dataset.shown = shown;
  element.replaceChildren(...children().filter((child) => child !== null));
}

// Requests and answers use SI; the page shows millimetres and degrees, as in station/config/units.py.
const SHOWN = {
  m: ["mm", 1e3], "m/s": ["mm/s", 1e3], "m/s^2": ["mm/s²", 1e3], rad: ["°", 180 / Math.PI], "rad/s": ["°/s", 180 / Math.PI],
};

export const unit = (si) => SHOWN[si] ?? [si, 1];
/** Format a number with its significant digits only. */
export const tidy = (value) => String(Number(value.toPrecision(10)));

const NUMBER = "[-+]?\\d+(?:\\.\\d+)?(?:e[-+]?\\d+)?";
const SI = new RegExp(`(${NUMBER})( \\.\\.\\. )?(${NUMBER})? (rad/s|rad|m/s\\^2|m/s|m)(?![\\w/^²])`, "g");

/**
 * Convert the lengths and angles of a station's message to the page's units: "-0.13 ... -0.005 m" is "-130 ... -5
 * mm".
 */
export const inPageUnits = (text) => text.replace(SI, (whole, first, dots, second, si) => {
  if ((dots === undefined) !== (second === undefined)) return whole;
  const [shown, scale] = unit(si), number = (one) => String(Number((Number(one) * scale).toPrecision(4)));
  return `${number(first)}${dots === undefined ? "" : dots + number(second)} ${shown}`;
});

/** Format a time [s], for example "1:05". */
export function clock(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

const TIME = { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" };
/** Format the time of day of a date, for example "17:05:09". */
export const timeOfDay = (date) => date.toLocaleTimeString(undefined, TIME);
/** Format a date with its time of day. */
export const dateTime = (date) => date.toLocaleString(undefined, { year: "numeric", month: "short", day: "numeric", ...TIME });

/** Return the value that this tab of the browser has stored as JSON under `key`; null without a readable one. */
export function stored(key) {
  try { return JSON.parse(session.get(key)); } catch { return null; }
}

/** Secret random identity of this browser tab. */
export const { client } = window.STOP;
export const name = { get: () => local.get("name") ?? "", set: (text) => local.set("name", text) };

export class Refused extends Error {
  constructor(reason, status) { super(reason); this.status = status; }
}

let polls = new AbortController();
// A browser opens at most six connections, and STOP may need a free one now.
document.addEventListener("stop-press", () => {
  polls.abort();
  polls = new AbortController();
});

/** Return a value of a request; JSON would send a number that is refused or missing as null, which means "automatic". */
function finite(_, value) {
  if (typeof value === "number" && !Number.isFinite(value)) throw new Refused("A field has no valid number. Correct it, then try again.", 422);
  return value;
}

/**
 * Return the station's answer; throw Refused with the reason of a refusal, or an Error if there is no answer within
 * `timeout` [ms]. The signal `cancel` ends a request without `timeout`.
 */
export async function request(method, path, body, timeout, cancel) {
  const headers = { "x-ctr-client": client, "x-ctr-name": encodeURIComponent(name.get()) };
  if (method !== "GET") headers["content-type"] = "application/json";
  const answer = await fetch(path, {
    method, headers, cache: "no-store", body: body === undefined ? undefined : JSON.stringify(body, finite),
    signal: timeout === undefined ? cancel
      : AbortSignal.any([AbortSignal.timeout(timeout), ...(method === "GET" ? [polls.signal] : [])]),
  });
  const text = await answer.text();
  const read = () => { try { return JSON.parse(text); } catch { return { error: text.slice(0, 200) }; } };
  if (!answer.ok) throw new Refused(read().error ?? `answer ${answer.status}`, answer.status);
  return text === "" ? null : read();
}

/** Return a function that requests `path` at its first call and returns this answer at later calls; a refusal is not kept. */
export function once(path) {
  let answer = null;
  return () => (answer ??= request("GET", path).catch((error) => { answer = null; throw error; }));
}
/** The joints, devices and bounds of the rig, which do not change while a station runs. */
export const rigAnswer = once("/api/rig");

/**
 * Keep a socket to /api/`path` connected. Call `onMessage(value)` with each message and `onOpen()` after each connection;
 * return the function that sends a text.
 */
export function stream(path, onMessage, onOpen = () => {}) {
  let socket = null;
  const connect = () => {
    socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/${path}`);
    socket.addEventListener("open", onOpen);
    socket.addEventListener("message", (event) => onMessage(JSON.parse(event.data)));
    socket.addEventListener("close", () => setTimeout(connect, 1000));
  };
  connect();
  return (text) => { if (socket.readyState === WebSocket.OPEN) socket.send(text); };
}

let remedyButton = () => null;
/** Set the function `make(status)`, which returns a button (or null) to show with a refusal of status 409. */
export const onRefusal = (make) => { remedyButton = make; };

/**
 * Send a command of the user. Return the answer; if the command failed, show the reason and return null. `refuse(text)`
 * shows why a value is invalid; without it a note does.
 */
export async function sendCommand(method, path, body, refuse = null) {
  try {
    const answer = await request(method, path, body);
    pollStatus();
    return answer ?? {};
  } catch (error) {
    if (refuse !== null && error instanceof Refused && error.status === 422) refuse(error.message); else await showFailure(error);
    return null;
  }
}

/** Show why a command of the user failed, with a button that removes the reason, if there is one. */
export async function showFailure(error) {
  await pending;
  await pollStatus(); // the button must fit the state that refused the command
  const remedy = error instanceof Refused && error.status === 409 && status !== null ? remedyButton(status) : null;
  const before = status, same = (now) => now.state === before.state && now.operator.name === before.operator.name;
  note(error instanceof Refused ? error.message : `the station does not answer (${error.message})`, false, remedy, remedy && same);
}

/** The last notes, the newest first: {time, text}. They stay in the tab Faults after they have vanished. */
export const pastNotes = [];
const lasting = new Map(); // notes that stay while a condition is true, with their conditions

/** Show a note in the corner, optionally with a button, for 12 s or as long as `isCurrent(status)` is true. */
export function note(message, good = false, remedy = null, isCurrent = null) {
  const text = inPageUnits(message);
  pastNotes.unshift({ time: new Date(), text });
  pastNotes.length = Math.min(pastNotes.length, 30);
  for (const old of $("notes").children) if (old.firstChild.textContent === text) old.remove(); // an older note with the same text is replaced
  const close = button("×", () => box.remove(), { "aria-label": "close" });
  const box = make("div", { className: good ? "note good" : "note" }, make("div", {}, text), remedy, close);
  remedy?.addEventListener("click", () => box.remove());
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
  const check = () => { enable(yes, boxes.some((box) => !box.checked) ? "Tick every box first" : ""); };
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
const POLL_INTERVAL_MS = 150, TIMEOUT_MS = 10000, BUSY_MS = 500; // a check that is late by BUSY_MS shows a busy browser
/** Age of the status [s] from which the page sends no command but STOP, reports the silence, and considers the station lost. */
export const STALE_AFTER_S = 0.48, SILENT_AFTER_S = 1, LOST_AFTER_S = 4;
const FRESH_WITHIN_S = 3; // a press waits at most this long for current data
const listeners = [];
let status = null, receivedAt = 0, pending = null, wasStale = null, silent = false;

/** Call `listener(status, stale)` with each new status, and when the status becomes stale, silent or lost. */
export const onStatus = (listener) => { listeners.push(listener); };
export const latest = () => status;

/** States in which the robot may send no values, as in web/api/status.py; then only the status itself must be current. */
const WITHOUT_VALUES = ["OFF", "FAULT"];
const valuesAge = () => (status === null || WITHOUT_VALUES.includes(status.state) ? 0 : status.age);

/** Age of the robot's data [s]: the time since the last status, and the age that its values had then. */
export const dataAge = () => (performance.now() - receivedAt) / 1000 + valuesAge();

/** Return whether the data are so old that nothing on the page may appear live; all parts of the page use this answer. */
export const isSilent = () => silent;

function publish() {
  silent = dataAge() > SILENT_AFTER_S;
  wasStale = status === null || (status.stale && !WITHOUT_VALUES.includes(status.state)) || dataAge() > STALE_AFTER_S;
  document.body.classList.toggle("stale", wasStale);
  document.body.classList.toggle("silent", silent);
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
    if (dataAge() > LOST_AFTER_S) status = null;
  }
  publish();
}

/**
 * Request the status after a press, because a question may depend on the pose, and return whether it is current. A busy
 * computer gets some time; if the status stays stale, a note reports that nothing is started.
 */
export async function ensureFresh() {
  const end = performance.now() + 1000 * FRESH_WITHIN_S, late = new Promise((resolve) => setTimeout(resolve, 1000 * FRESH_WITHIN_S));
  await Promise.race([pending, late]); // the answer to this request may be older than the press
  do await Promise.race([pollStatus(), late]); while (wasStale && performance.now() < end);
  if (wasStale) note("Not started: the page has no current data from the robot. Wait for new data, then press again.");
  return !wasStale;
}

/**
 * Return whether this page may send commands now: it is operator, or there is no operator and it could become
 * operator.
 */
export const mayCommand = (now = status) =>
  now !== null && now.operator.role === "operator" && (now.operator.you || now.operator.name === null);

/** Why a control that needs current data is disabled; empty if the page has them. */
export const silentReason = (old = silent) => (old ? "The page has no current data from the robot" : "");
/** Why a second press of a start has no effect yet. */
export const CHECKING = "The station checks the motion";

/** Why this page may not send a command now, empty if it may. `states`: the only states in which it has an effect. */
export function blockReason(now, stale = false, states = null) {
  if (now === null) return "The station does not answer";
  if (now.operator.role === "viewer") return "A viewer may only view and STOP";
  if (!mayCommand(now)) return `'${now.operator.name}' is operator: take over first`;
  if (states !== null && !states.includes(now.state)) return `Possible while ${states.join(" or ")}, not while ${now.state}`;
  return silentReason(stale);
}

/** Enable a control if `reason` is empty; otherwise disable it, and show the reason instead of its usual explanation. */
export function enable(control, reason) {
  control.dataset.usual ??= control.title;
  const title = reason || control.dataset.usual;
  if (control.title !== title) control.title = title;
  control.disabled = reason !== "";
  return control;
}

/**
 * Return a sentence about what a rig without tracker or force sensors can do; empty for a rig with all devices, and while
 * the devices are not known yet.
 */
export function benchNote(devices) {
  if (!("stages" in devices)) return "";
  const tracker = "tracker" in devices, sensors = "sensors" in devices;
  if (tracker && sensors) return "";
  if (tracker) return "This bench has stages and a tracker, but no force sensors: the force is estimated from the deflection of the tip. Everything works but the calibration and the tare of force sensors.";
  return sensors ? "This bench has stages and force sensors, but no tracker: the loaded model computes the tip, and its error is not measured. Calibrations need a tracker."
    : "This bench has stages alone: the tip moves by the unloaded model, and nothing measures the tip or the force. Home, Jog, and motions with the inner loop “unloaded” work.";
}

const MOVING = ["RUNNING", "HOMING"];
window.STOP.motion = () => (status === null || dataAge() > SILENT_AFTER_S ? "unknown" : MOVING.includes(status.state) ? "moving" : "rest");
document.addEventListener("stop-report", (event) => {
  event.preventDefault(); // the page shows the state, so an accepted STOP needs no other message
  if (event.detail !== "") note(event.detail, true);
  pollStatus();
});

export function start() {
  setInterval(pollStatus, POLL_INTERVAL_MS);
  // Old data must be marked even while a request is pending.
  let checkedAt = performance.now(), waited = false;
  setInterval(() => {
    // After the browser was busy, answers may wait to be read. One check is skipped for them, the next check is not.
    const now = performance.now();
    waited = !waited && now - checkedAt > BUSY_MS;
    checkedAt = now;
    if (waited) return;
    const age = dataAge(), lost = age > LOST_AFTER_S && status !== null;
    if (lost) status = null;
    if (lost || (age > STALE_AFTER_S && !wasStale) || age > SILENT_AFTER_S !== silent) publish();
  }, 50);
  pollStatus();
}
