// Plots of the live telemetry: choose the values, pause, zoom into a time interval.
import { $, request, make } from "./station.js";
import { isOpen, onTab } from "./tabs.js";
import { Chart } from "./chart.js";
import { unit } from "./form.js";
import { gap, samples } from "./history.js";
import { error, valueOf, onOpen, onSample, directionError } from "./telemetry.js";

const HISTORY_S = 300; // duration of the kept telemetry [s]
const DARK = matchMedia("(prefers-color-scheme: dark)").matches; // dark blue lines need a light background
const COLOURS = ["#d55e00", "#009e73", DARK ? "#56b4e9" : "#0072b2", "#cc79a7", DARK ? "#e69f00" : "#56b4e9"], DASHES = [[], [6, 3], [2, 2], [9, 2, 2, 2], []];
const rig = await request("GET", "/api/rig");

/** Traces of a vector's components: `valueAt` returns the drawn value, `raw` the unfiltered one if there is one. */
const xyz = (valueAt, raw) => ["x", "y", "z"].map((name, i) => ({ name, value: (sample) => valueAt(sample)?.[i] ?? NaN, raw: raw && ((sample) => raw(sample)?.[i] ?? NaN) }));
const size = (valueAt) => ({ name: "size", value: (sample) => { const v = valueAt(sample); return v ? Math.hypot(...v) : NaN; }, on: false });
const scaled = (sample, group, factor) => valueOf(sample, group)?.map((x) => factor * x) ?? null;
const components = (valueAt, raw) => [...xyz(valueAt, raw), size(valueAt)];

/** Available charts: title, unit, traces, smallest span. */
const ALL = {
  error: ["Error, measured", "mm", components((s) => error(s, "tip_measured")), 1],
  true: ["Error, true", "mm", components((s) => error(s, "tip_true")), 1],
  force: ["Force at the tip", "N", components((s) => valueOf(s, "force_filtered"), (s) => valueOf(s, "force"))
    .map((trace, i) => (i < 3 ? { ...trace, spread: (s) => 2 * Math.sqrt(valueOf(s, "force_variance")?.[i] ?? NaN) } : trace)), 0.1],
  deflection: ["Deflection", "mm", components((s) => scaled(s, "deflection_filtered", 1e3), (s) => scaled(s, "deflection", 1e3)), 1],
  direction: ["Error of the direction", "°", [
    { name: "measured", value: (s) => directionError(s, "direction_measured") ?? NaN }, { name: "true", value: (s) => directionError(s, "direction_true") ?? NaN }], 1],
  timing: ["Loop timing, 99 % over a second", "µs", [
    { name: "late", value: (s) => s.late_us ?? NaN }, { name: "work", value: (s) => s.tick_us ?? NaN }], 100],
  tip: ["Measured tip", "mm", xyz((s) => scaled(s, "tip_measured", 1e3)), 1],
  ...Object.fromEntries(rig.joints.map((joint, i) => {
    const [shown, scale] = unit(joint.unit);
    return [`joint ${joint.name}`, [joint.name.replaceAll("_", " "), shown, [{ name: "measured", value: (s) => s.joints[i] * scale }], 1]];
  })),
};

let paused = null, zoom = null, span = 30;
const charts = new Map();

const area = make("div"), chips = make("div", { className: "chips", role: "group", "aria-label": "what to plot" });
const pause = make("button", { type: "button", "aria-pressed": "false" }, "Pause");
const whole = make("button", { type: "button", hidden: true }, "Whole time");
const spans = make("select", { "aria-label": "time shown" }, ...[10, 30, 60, 300].map((one) => make("option", { value: one }, `${one} s`)));
const zoomIn = make("button", { type: "button", "aria-label": "zoom in" }, "+"), zoomOut = make("button", { type: "button", "aria-label": "zoom out" }, "−");
spans.value = "30";
$("plots").append(chips, make("div", { className: "acts" }, spans, pause, zoomIn, zoomOut, whole,
  make("span", { className: "small dim" }, "drag to zoom · pale: single samples; band: ± 2 standard deviations")), area);

for (const key of Object.keys(ALL)) {
  const chip = make("button", { type: "button", "aria-pressed": "false" }, key.replace("joint ", "").replaceAll("_", " "));
  chip.addEventListener("click", () => toggle(key, chip));
  chips.append(chip);
  if (["error", "force", "deflection"].includes(key)) toggle(key, chip);
}

function toggle(key, chip) {
  if (charts.has(key)) {
    charts.get(key).element.remove();
    charts.delete(key);
  } else {
    const [title, unitText, traces, minimumSpan] = ALL[key];
    const styled = traces.map((trace, i) => ({ ...trace, colour: COLOURS[i], dash: DASHES[i] }));
    charts.set(key, new Chart(title, unitText, styled, minimumSpan, zoomTo, point));
    area.replaceChildren(...Object.keys(ALL).filter((one) => charts.has(one)).map((one) => charts.get(one).element));
  }
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
pause.addEventListener("click", () => { setPaused(paused === null); if (paused === null) zoomTo(null); });
whole.addEventListener("click", () => zoomTo(null));
zoomIn.addEventListener("click", () => scale(0.5));
zoomOut.addEventListener("click", () => scale(2));
spans.addEventListener("change", () => { span = Number(spans.value); zoomTo(null); });

function shownRange() {
  const newest = (paused ?? samples).at(-1)?.time ?? 0;
  return zoom ?? [newest - span, newest];
}
function draw() {
  if (!isOpen("plots")) return;
  const shown = paused ?? samples, newest = shown.at(-1)?.time ?? 0;
  for (const chart of charts.values()) chart.show(shown, shownRange(), newest);
}

onOpen(gap);
onSample((sample) => {
  if (samples.length && sample.time < samples.at(-1).time) samples.length = 0; // the time has decreased, so the control process has restarted
  samples.push(sample);
  while (samples.length && samples[0].time < sample.time - HISTORY_S) samples.shift();
});
setInterval(() => { if (paused === null) draw(); }, 100);
window.addEventListener("resize", draw);
onTab("plots", draw);
