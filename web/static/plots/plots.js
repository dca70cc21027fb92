// Plots of the live telemetry: choose the values, pause, zoom into a time interval.
import { $, button, make, rigAnswer, unit } from "../page/station.js";
import { isOpen, onTab } from "../page/tabs.js";
import { Chart } from "../page/chart.js";
import { directionError, error, HISTORY_S, samples } from "../page/telemetry.js";

const rig = await rigAnswer();

/** Traces of a vector's components and its size: `valueAt` returns the drawn value, `raw` the unfiltered one if there is one. */
const components = (valueAt, raw) => [...xyz(valueAt, raw), { name: "size", value: (sample) => { const v = valueAt(sample); return v ? Math.hypot(...v) : NaN; }, on: false }];
const xyz = (valueAt, raw) => ["x", "y", "z"].map((name, i) => ({ name, value: (sample) => valueAt(sample)?.[i] ?? NaN, raw: raw && ((sample) => raw(sample)?.[i] ?? NaN) }));
const scaled = (sample, group, factor) => sample[group]?.map((x) => factor * x) ?? null;

/** Available charts: title, unit, traces, smallest span. */
const ALL = {
  "tracker error": ["Tracker error", "mm", components((s) => error(s, "tip_measured")), 1],
  "true error": ["True error", "mm", components((s) => error(s, "tip_true")), 1],
  force: ["Force at the tip", "N", components((s) => s.force_filtered, (s) => s.force)
    .map((trace, i) => (i < 3 ? { ...trace, spread: (s) => 2 * Math.sqrt(s.force_variance?.[i] ?? NaN) } : trace)), 0.1],
  deflection: ["Deflection", "mm", components((s) => scaled(s, "deflection_filtered", 1e3), (s) => scaled(s, "deflection", 1e3)), 1],
  direction: ["Error of the direction", "°", [
    { name: "measured", value: (s) => directionError(s, "direction_measured") ?? NaN }, { name: "true", value: (s) => directionError(s, "direction_true") ?? NaN }], 1],
  timing: ["Loop timing, 99th percentile of each second", "µs", [
    { name: "late", value: (s) => s.late_us ?? NaN }, { name: "work", value: (s) => s.tick_us ?? NaN }], 100],
  tip: ["Measured tip", "mm", xyz((s) => scaled(s, "tip_measured", 1e3)), 1],
  ...Object.fromEntries(rig.joints.map((joint, i) => {
    const [shown, scale] = unit(joint.unit);
    return [`joint ${joint.name}`, [joint.name.replaceAll("_", " "), shown, [{ name: "measured", value: (s) => s.joints[i] * scale }], 1]];
  })),
};

let paused = null, zoom = null;
const charts = new Map();

const area = make("div"), chips = make("div", { className: "chips", role: "group", "aria-label": "what to plot" });
const pause = button("Pause", () => { setPaused(paused === null); if (paused === null) zoomTo(null); }, { "aria-pressed": "false" });
const whole = button("Whole time", () => zoomTo(null), { hidden: true });
const spans = make("select", { "aria-label": "time shown", onchange: () => zoomTo(null) }, ...[10, 30, 60, 300].map((one) => make("option", { value: one, selected: one === 30 }, `${one} s`)));
$("plots").append(chips, make("div", { className: "acts" }, spans, pause,
  button("+", () => scale(0.5), { "aria-label": "zoom in" }), button("−", () => scale(2), { "aria-label": "zoom out" }), whole,
  make("span", { className: "small dim" }, "drag to zoom · pale: single samples; band: ± 2 standard deviations")), area);

for (const key of Object.keys(ALL)) {
  const chip = button(key.replace("joint ", "").replaceAll("_", " "), () => toggle(key, chip), { "aria-pressed": "false" });
  chips.append(chip);
  if (["tracker error", "force", "deflection"].includes(key)) toggle(key, chip);
}

function toggle(key, chip) {
  if (!charts.delete(key)) charts.set(key, new Chart(...ALL[key], zoomTo, point));
  area.replaceChildren(...Object.keys(ALL).filter((one) => charts.has(one)).map((one) => charts.get(one).element));
  chip.setAttribute("aria-pressed", String(charts.has(key)));
  draw();
}

/** Mark the time under the pointer [s] in all charts; null: no pointer. */
function point(time) {
  for (const chart of charts.values()) chart.point(time);
}

function setPaused(on) {
  paused = on ? [...samples] : null;
  pause.setAttribute("aria-pressed", String(on));
  pause.textContent = on ? "Resume" : "Pause";
}
function zoomTo(range) {
  zoom = range;
  if (range !== null && paused === null) setPaused(true);
  whole.hidden = range === null;
  draw();
}
function scale(factor) {
  const [from, to] = shownRange(), middle = (from + to) / 2, half = ((to - from) / 2) * factor;
  if (half > 0.05 && half < HISTORY_S) zoomTo([middle - half, middle + half]);
}

function shownRange() {
  const newest = (paused ?? samples).at(-1)?.time ?? 0;
  return zoom ?? [newest - Number(spans.value), newest];
}
function draw() {
  if (!isOpen("plots")) return;
  const shown = paused ?? samples, newest = shown.at(-1)?.time ?? 0;
  for (const chart of charts.values()) chart.show(shown, shownRange(), newest);
}

setInterval(() => { if (paused === null) draw(); }, 100);
window.addEventListener("resize", draw);
onTab("plots", draw);
