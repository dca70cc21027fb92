// Values that are always visible: error, force, deflection and time left; after a run, its result.
import { $, button, clock, isSilent, make, onStatus, request, setText, Refused, SILENT_AFTER_S } from "./station.js";
import { directionError, error, follows, latestSample } from "./telemetry.js";
import { countedFrom, errorOf, errorSummary, ended } from "../runs/result.js";

const REFRESH_INTERVAL_MS = 200; // ms
const length = (vector, scale = 1) => (vector ? scale * Math.hypot(...vector) : null);
const BEFORE = { approaching: "to start", settling: "at rest" };
let status = null, stale = true, silent = false;

let truth = false; // whether the newest sample contained the true tip
const reference = (sample) => {
  if (sample !== null) truth = Boolean(sample.truth_known);
  return truth ? "true" : "measured";
};
function timeLeft() {
  const run = status?.run;
  if (isSilent() || !run || status.state !== "RUNNING") return null;
  return run.phase === "moving" ? clock(run.duration * (1 - run.progress)) : BEFORE[run.phase] ?? null;
}

/** Return the addition to the error's name in a run that follows a target. */
const ofTarget = (sample) => (follows(sample) ? (sample.target_visible ? " off target" : ", target not seen") : "");
/** Return the error by the tracker beside the true one, which only a virtual lab knows; empty without a motion. */
function trackerError(sample) {
  const size = sample && reference(sample) === "true" ? length(error(sample, "tip_measured")) : null;
  return size === null ? "" : `tracker\u00a0error ${size.toFixed(2)}\u00a0mm`;
}
/** Whether the bench has no force sensors, so that the force is estimated from the deflection of the tip. */
const byDeflection = (sample) => sample?.trouble?.[2] === -1 && sample.force_filtered !== null;
/** Whether the bench has a tracker that does not measure the tip now: a deflection would look as if it were measured. */
const isTipLost = (sample) => sample.trouble?.[1] !== -1 && !sample.tip_measured;
const fixed = (digits) => (value) => value.toFixed(digits);
/** Quantity with a colour on the page, name, line below the value, unit, value of the newest sample (or null), format, explanation of a dash, whether the cell may be hidden. */
const CELLS = [
  { quantity: "error", name: (sample) => `${reference(sample) === "true" ? "true" : "tracker"} error${ofTarget(sample)}`, below: trackerError, unit: "mm", value: (s) => s && length(error(s, `tip_${reference(s)}`)), text: fixed(2), none: "shown during a motion while its devices answer", help: "tips" },
  { name: () => "direction", unit: "°", value: (s) => s && directionError(s, `direction_${reference(s)}`), text: fixed(1), none: "", optional: true },
  { quantity: "force", name: (sample) => (byDeflection(sample) ? "force, est." : "force"), unit: "N", value: (s) => s && length(s.force_filtered), text: fixed(2), none: "no current force measurement" },
  { name: () => "deflection", unit: "mm", value: (s) => (s && !isTipLost(s) ? length(s.deflection_filtered, 1e3) : null), text: fixed(1), none: "needs a measured tip and force sensors that measure" },
  { name: () => "time left", unit: "", value: timeLeft, text: String, none: "no motion is running" },
].map((cell) => ({ ...cell, label: make("span", { className: "dim", ...(cell.quantity && { "data-quantity": cell.quantity }) }), shown: make("output"), note: cell.below && make("span", { className: "dim" }) }));

const helpMark = (section) => button("?", () => document.dispatchEvent(new CustomEvent("help", { detail: section })), { className: "help-mark", "aria-label": "explain true and tracker" });
for (const cell of CELLS) $("strip").append(cell.element = make("div", { hidden: Boolean(cell.optional) }, cell.label, cell.shown, cell.help ? helpMark(cell.help) : null, cell.note ?? null));

/** Show the values. Old ones turn grey at once and disappear after a second, so that a busy computer does not blank them. */
function show() {
  const sample = isSilent() ? null : latestSample(SILENT_AFTER_S), old = stale || latestSample() === null;
  for (const { name, below, note, unit, value, text, none, optional, element, label, shown } of CELLS) {
    const now = value(sample) ?? null;
    if (optional) element.hidden = now === null; // no direction is desired
    label.textContent = name(sample);
    if (note) setText(note, below(sample));
    setText(shown, now === null ? "–" : `${text(now)}${unit && ` ${unit}`}`);
    shown.title = now === null ? none : "";
    shown.classList.toggle("old", old);
  }
}

// ---- the end of a run

let reported = null; // id of the run whose end was reported or must not be reported
const again = button("Run again", null, { title: "Start a run with the same settings" });

async function reportEnd(run) {
  reported = run.id;
  let result;
  try {
    result = await request("GET", `/api/runs/${encodeURIComponent(run.id)}`, undefined, 5000);
  } catch (error) {
    if (!(error instanceof Refused)) reported = null; // the station did not answer, so the result is requested again
    return;
  }
  if (reported !== run.id) return;
  const [largest, rms] = errorSummary(result), force = Math.max(...Object.values(result.outcomes).map((one) => one.force ?? NaN));
  const numbers = largest === "–" ? ended(result) : `${ended(result)} · ${errorOf(result)} at most ${largest}\u00a0mm, RMS ${rms}\u00a0mm${countedFrom(result)}${Number.isFinite(force) ? ` · force at most ${force.toFixed(2)} N` : ""}`;
  again.onclick = async () => (await import("../run/run.js")).runAgain(run.id);
  $("ended").replaceChildren(make("div", {}, make("b", {}, run.title), make("span", { className: result.label }, numbers)),
    button("Result", async () => (await import("../runs/runs.js")).showRun(run.id)),
    again,
    button("×", () => { $("ended").hidden = true; }, { "aria-label": "close" }));
  $("ended").hidden = false;
}

onStatus((now, old) => {
  status = now;
  if (stale !== old || silent !== isSilent()) { stale = old; silent = isSilent(); show(); }
  again.disabled = silent;
  const run = now?.run;
  if (!run) return;
  if (now.phase === "jogging") return; // the last result stays: the panel must not move under a pointer that holds a button
  if (now.state === "RUNNING") { reported = null; $("ended").hidden = true; }
  else if (run.recorded && run.id !== reported && !run.recording && !old) reportEnd(run);
});
setInterval(show, REFRESH_INTERVAL_MS);
show();
