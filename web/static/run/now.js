// The run in progress, a view of the tab Run: what it does, its load, live error and force, and the
// stiffness of the tip.
import { blockReason, button, enable, make, note, onStatus, replaceChanged, sendCommand, setText } from "../page/station.js";
import { isOpen } from "../page/tabs.js";
import { Chart } from "../page/chart.js";
import { form, schemas } from "../page/form.js";
import { forceDial } from "../page/dial.js";
import { error, latestSample, samples } from "../page/telemetry.js";
import { stiffnessMap } from "../runs/result.js";

const REFRESH_INTERVAL_MS = 200, SHOWN_S = 30; // interval of the drawings [ms], and time shown in them [s]

const size = (vector) => (vector ? Math.hypot(...vector) : NaN);
const token = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const live = (title, unit, traces, span) => new Chart(title, unit, traces, span, () => {}, point);
const charts = [
  live("Error", "mm", [
    { name: "tracker error", value: (sample) => size(error(sample, "tip_measured")), colour: token("--dim") },
    { name: "true error", value: (sample) => size(error(sample, "tip_true")), colour: token("--error"), dash: [] }], 0.5),
  live("Force", "N", [{ name: "size", value: (sample) => size(sample.force_filtered), colour: token("--force") }], 0.1),
];
const title = make("h3"), phase = make("p", { className: "small dim" }), load = make("p", { className: "small" });
const progress = make("progress", { max: 1, value: 0, "aria-label": "progress" });
const marked = make("input", { type: "text", value: "touched", maxLength: 200, "aria-label": "text of the mark" });
const mark = button("Mark this moment", async () => { if (await sendCommand("POST", "/api/mark", { text: marked.value.trim() || "marked" })) note("marked in the recording", true); });
const map = make("div", { id: "palpated", "aria-live": "off" });
const stiffnessBox = make("div", { id: "stiffness", hidden: true });
const setStiffness = button("Set stiffness", async () => {
  const valid = [...stiffnessBox.querySelectorAll("input")].every((input) => input.reportValidity());
  if (valid && await sendCommand("PUT", "/api/stiffness", stiffness.read())) note("the tip reaches this stiffness within 1 s", true);
});
/** The run in progress; the tab shows it instead of the motions. */
export const box = make("section", { id: "now", hidden: true, "aria-label": "run in progress" }, title, phase, progress, load, map, forceDial(), ...charts.map((chart) => chart.element), make("div", { className: "acts" }, marked, mark), stiffnessBox);

function point(time) {
  for (const chart of charts) chart.point(time);
}

let shown = "", filled = ""; // id of the shown run; id of the run whose stiffness the fields had at first, and whether it has one
let stiffness = null; // form with these fields
onStatus((status, stale) => {
  for (const control of [mark, setStiffness]) enable(control, blockReason(status, stale));
  if (status === null) return; // no answer: what the station did last stays visible, in grey
  const run = status.state === "RUNNING" ? status.run : null;
  if (run === null) return;
  setText(title, run.title);
  setText(phase, status.message);
  setText(load, run.load === "" ? "no load from the lab" : `load: ${run.load}`);
  load.hidden = !status.simulated;
  progress.value = run.progress;
  replaceChanged(map, run.stiffness, () => (run.stiffness === null ? [] : [stiffnessMap(run)]));
  shown = run.id;
});

/** Show the fields of the stiffness, at first with its present values, or why this motion has none. */
async function showStiffness(present) {
  const yields = present?.some((one) => one > 0), key = `${shown} ${yields}`;
  stiffnessBox.hidden = present === undefined;
  if (stiffnessBox.hidden || filled === key) return;
  filled = key;
  if (!yields) {
    stiffnessBox.replaceChildren(make("p", { className: "small dim" }, "The tip is as stiff as the joints allow. To change its stiffness in a motion, fill in “Stiffness of the tip” before you start it."));
    return;
  }
  stiffness = form((await schemas()).SetStiffness, { values: { stiffness: present } });
  stiffnessBox.replaceChildren(stiffness.element, make("div", { className: "acts" }, setStiffness));
}

setInterval(() => {
  if (box.hidden || !isOpen("start")) return;
  const newest = samples.at(-1)?.time ?? 0;
  showStiffness(latestSample()?.stiffness);
  for (const chart of charts) chart.show(samples, [newest - SHOWN_S, newest], newest);
}, REFRESH_INTERVAL_MS);
