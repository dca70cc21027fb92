// Values that are always visible: error, force, deflection and time left; after a run, its result.
import { $, button, clock, enable, isSilent, make, mayCommand, onStatus, request, setText, silentReason, Refused, SILENT_AFTER_S } from "./station.js";
import { directionError, error, follows, isForceKnown, latestSample } from "./telemetry.js";
import { ended, outcomeAndCause } from "../runs/result.js";

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
/** Return the tracker error as a text below the true error, which only a virtual lab knows; empty without a motion. */
function trackerError(sample) {
  const size = sample && reference(sample) === "true" ? length(error(sample, "tip_measured")) : null;
  return size === null ? "" : `tracker\u00a0error ${size.toFixed(2)}\u00a0mm`;
}
/** Whether no sensors measure the whole load, so that the force is estimated from the deflection of the tip. */
const byDeflection = (sample) => sample?.deflection_filtered === null && sample.force_filtered !== null;
const knownAxes = (sample) => [0, 1, 2].filter((axis) => isForceKnown(sample, [0, 1, 2].map((i) => Number(i === axis))));
/** Return the name of the force, with the axes along which it is known if these are not all. */
function forceName(sample) {
  const axes = byDeflection(sample) ? knownAxes(sample) : [0, 1, 2];
  return axes.length === 3 || axes.length === 0 ? `force${byDeflection(sample) ? ", est." : ""}` : `force in ${axes.map((axis) => "xyz"[axis]).join(", ")}`;
}
/** Return the axes along which the force is unknown or, if there are none, the force that is possible with the errors of its estimate; empty in the place of the button that zeros it, and while no force is known. */
export function possibleForce(sample) {
  if (!zero.hidden || !sample?.force_filtered) return "";
  const unknown = byDeflection(sample) ? [0, 1, 2].filter((axis) => !knownAxes(sample).includes(axis)) : [];
  return unknown.length > 0 ? `${unknown.map((axis) => "xyz"[axis]).join(",\u00a0")}\u00a0unknown` : `up to\u00a0${sample.force_possible.toFixed(2)}\u00a0N`;
}
/** Whether the bench has a tracker that does not measure the tip now: a deflection would look as if it were measured. */
const isTipLost = (sample) => sample.trouble?.[1] !== -1 && !sample.tip_measured;
const fixed = (digits) => (value) => value.toFixed(digits);
/** Fields of each cell: quantity with a colour on the page, name, line below the value, unit, value of the newest sample (or null), format, explanation of a dash, whether the cell may be hidden. */
const CELLS = [
  { quantity: "error", name: (sample) => `${reference(sample) === "true" ? "true" : "tracker"} error${ofTarget(sample)}`, below: trackerError, unit: "mm", value: (s) => s && length(error(s, `tip_${reference(s)}`)), text: fixed(2), none: "shown during a motion while its devices answer", help: "tips" },
  { name: () => "direction", unit: "°", value: (s) => s && directionError(s, `direction_${reference(s)}`), text: fixed(1), none: "", optional: true },
  { quantity: "force", name: forceName, below: possibleForce, unit: "N", value: (s) => (s && s.force_filtered && knownAxes(s).length > 0 ? length(knownAxes(s).map((axis) => s.force_filtered[axis])) : null), text: fixed(2), none: "no force is known now" },
  { name: () => "deflection", unit: "mm", value: (s) => (s && !isTipLost(s) ? length(s.deflection_filtered, 1e3) : null), text: fixed(1), none: "needs a measured tip and measured forces" },
  { name: () => "time left", unit: "", value: timeLeft, text: String, none: "no motion is running", narrow: true }, // the header of a larger page shows it
].map((cell) => ({ ...cell, label: make("span", { className: "dim", ...(cell.quantity && { "data-quantity": cell.quantity }) }), shown: make("output"), note: cell.below && make("span", { className: "dim" }) }));

const zero = button("zero", async () => (await import("../devices/devices.js")).tare(), { className: "zero", title: "Zero the force sensors, while nothing touches the robot" });
const helpMark = (section) => button("?", () => document.dispatchEvent(new CustomEvent("help", { detail: section })), { className: "help-mark", "aria-label": "explain true and tracker" });
for (const cell of CELLS) $("strip").append(cell.element = make("div", { hidden: Boolean(cell.optional), className: cell.narrow ? "narrow" : "" }, cell.label, cell.shown, cell.help ? helpMark(cell.help) : null, cell.note ?? null, cell.quantity === "force" ? zero : null));

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

let reported = null; // id of the run whose end was reported or must not be reported; empty during a run
const again = button("Run again", null, { title: "Start a run with the same settings" });

async function reportEnd(run) {
  reported = run.id;
  let result;
  try {
    result = await request("GET", `/api/runs/${encodeURIComponent(run.id)}`, undefined, 5000);
  } catch (error) {
    if (error instanceof Refused) place(run.title, `no result: ${error.message}`, "dim");
    else reported = null; // the station did not answer, so the result is requested again
    return;
  }
  if (reported !== run.id) return;
  const main = result.headline, numbers = main === null ? "" : `${main.number} ${main.sentence}`, [outcome, cause] = outcomeAndCause(result);
  // The numbers of a complete run come first, the cause of another end comes first.
  const parts = result.label === "complete" ? [outcome, numbers, cause] : [ended(result), numbers];
  again.onclick = async () => (await import("../run/run.js")).runAgain(run.id);
  place(run.title, parts.filter(Boolean).join(" · "), result.label, button("Result", async () => (await import("../runs/runs.js")).showRun(run.id)), again);
}

/** Replace the last result by two lines. The height never changes, so that nothing moves under a pointer. */
function place(first, second, label, ...buttons) {
  $("ended").replaceChildren(make("div", { title: `${first}\n${second}` }, make("b", {}, first), make("span", { className: label }, second)), ...buttons);
}
place("No result yet", "The result of a run appears here.", "dim");

onStatus((now, old) => {
  status = now;
  if (stale !== old || silent !== isSilent()) { stale = old; silent = isSilent(); show(); }
  enable(again, silentReason());
  zero.hidden = old || now?.state !== "READY" || !mayCommand(now) || !("sensors" in now.devices || "tracker" in now.devices);
  const run = now?.run;
  if (!run) return;
  if (now.phase === "jogging") return; // the last result stays
  if (now.state === "RUNNING" && run.recorded) {
    if (reported !== "") place(run.title, "The result appears here at the end.", "dim");
    reported = "";
  }
  else if (run.recorded && run.id !== reported && !run.recording && !old) reportEnd(run);
});
setInterval(show, REFRESH_INTERVAL_MS);
show();
