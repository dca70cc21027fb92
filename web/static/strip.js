// Always in sight: error, force, deflection and the time left; and when a run is over, how well it went.
import { $, ask, make, onStatus, Refused } from "./station.js";
import { error, follows, known, latestSample, turned } from "./telemetry.js";
import { atOneLook, ended, SHAPES } from "./result.js";

const PERIOD = 200; // ms
const length = (vector, scale = 1) => (vector === null ? null : scale * Math.hypot(...vector));
const BEFORE = { approaching: "to start", settling: "at rest" };
let status = null, stale = true;

let truth = false; // whether the newest sample had one
const against = (sample) => {
  if (sample !== null) truth = Boolean(sample.truth_known);
  return truth ? "true" : "measured";
};
function left() {
  const run = status?.run;
  if (stale || !run || status.state !== "RUNNING") return null;
  if (run.phase !== "moving") return BEFORE[run.phase] ?? null;
  const seconds = Math.max(0, Math.round(run.duration * (1 - run.progress)));
  return `${Math.floor(seconds / 60)}:${String(seconds % 60).padStart(2, "0")}`;
}

const asks = (sample) => (follows(sample) ? (sample.target_seen ? "off target" : "target not seen") : "error");
const fixed = (digits) => (value) => value.toFixed(digits);
/** Name, unit, value of the newest sample (or null), how it is written, what a dash means, or that there is none. */
const CELLS = [
  { name: (sample) => `${asks(sample)}, ${against(sample) === "true" ? "true" : "tracker"}`, unit: "mm", value: (s) => s && length(error(s, `tip_${against(s)}`)), text: fixed(2), none: "known while a motion is on and its devices answer" },
  { name: () => "direction", unit: "°", value: (s) => s && turned(s, `direction_${against(s)}`), text: fixed(1), none: "", asked: true },
  { name: () => "force", unit: "N", value: (s) => s && length(known(s, "force_filtered")), text: fixed(2), none: "no fresh word of the force" },
  { name: () => "deflection", unit: "mm", value: (s) => s && length(known(s, "deflection_filtered"), 1e3), text: fixed(1), none: "no fresh word of the force" },
  { name: () => "time left", unit: "", value: left, text: String, none: "no motion is on" },
].map((cell) => ({ ...cell, label: make("span", { className: "dim" }), shown: make("output") }));

for (const cell of CELLS) $("strip").append(cell.element = make("div", { hidden: Boolean(cell.asked) }, cell.label, cell.shown));

function show() {
  const sample = stale ? null : latestSample();
  for (const { name, unit, value, text, none, asked, element, label, shown } of CELLS) {
    const now = value(sample) ?? null;
    if (asked) element.hidden = now === null; // nobody asks where the tip points
    const words = now === null ? "–" : `${text(now)}${unit && ` ${unit}`}`;
    label.textContent = name(sample);
    if (shown.textContent !== words) shown.textContent = words;
    shown.title = now === null ? none : "";
  }
}

// ---- the end of a run

let told = null; // the run whose end has been told, or is not to be told

async function tell(run) {
  told = run.id;
  let found;
  try {
    found = await ask("GET", `/api/runs/${encodeURIComponent(run.id)}`, undefined, 5000);
  } catch (error) {
    if (!(error instanceof Refused)) told = null; // nobody answers: asked again
    return;
  }
  if (told !== run.id) return;
  const [largest, rms] = atOneLook(found), force = Math.max(...Object.values(found.outcomes).map((one) => one.force ?? NaN));
  const numbers = largest === "–" ? ended(found) : `${SHAPES[found.label] ?? "○"} ${found.label} · error at most ${largest}, RMS ${rms} mm${Number.isFinite(force) ? ` · force at most ${force.toFixed(2)} N` : ""}`;
  const more = make("button", { type: "button" }, "Result"), close = make("button", { type: "button", "aria-label": "close" }, "×");
  more.addEventListener("click", async () => (await import("./runs.js")).showRun(run.id));
  close.addEventListener("click", () => { $("ended").hidden = true; });
  $("ended").replaceChildren(make("div", {}, make("b", {}, run.title), make("span", { className: found.label }, numbers)), more, close);
  $("ended").hidden = false;
}

onStatus((now, old) => {
  status = now;
  if (stale !== old) { stale = old; show(); } // what is old is gone at once
  const run = now?.run;
  if (!run) return;
  if (now.state === "RUNNING") { told = null; $("ended").hidden = true; }
  else if (run.recorded && run.id !== told && !run.recording && !old) tell(run);
});
setInterval(show, PERIOD);
show();
