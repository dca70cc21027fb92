// Charts over time: a live one on a canvas, which zooms, and a small one of finished runs (SVG). No library.
import { button, make, setText } from "./station.js";

const DARK = matchMedia("(prefers-color-scheme: dark)").matches; // dark blue lines need a light background

/** Return a step of 1, 2 or 5 times a power of ten that gives about `count` ticks. */
export function step(span, count) {
  const rough = span / count, power = 10 ** Math.floor(Math.log10(rough)), part = rough / power;
  return power * (part < 1.5 ? 1 : part < 3.5 ? 2 : part < 7.5 ? 5 : 10);
}

/** Return the ticks of an axis from `low` to `high`: [[value, text]]. */
function ticks(low, high, count) {
  const pace = step(high - low, count), digits = Math.max(0, -Math.floor(Math.log10(pace) + 1e-9));
  const found = [];
  for (let value = Math.ceil(low / pace - 1e-9) * pace; value <= high + 1e-9 * pace; value += pace) found.push([value, value.toFixed(digits)]);
  return found;
}

const nearest = (times, time) => times.reduce((best, one, i) => (Math.abs(one - time) < Math.abs(times[best] - time) ? i : best), 0);

/** Clear a canvas, and fit its resolution to its size on the screen: {pen, width, height}; null while it is hidden. */
export function cleared(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas, ratio = window.devicePixelRatio || 1;
  if (width === 0 || height === 0) return null;
  const [w, h] = [width, height].map((size) => Math.round(size * ratio));
  if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

/** Return a new SVG element. */
export function svg(tag, fields, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(fields)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

// ---- live chart

const LEFT = 46, RIGHT = 8, TOP = 6, BOTTOM = 20;
const COLOURS = ["#d55e00", "#009e73", DARK ? "#56b4e9" : "#0072b2", "#cc79a7", DARK ? "#e69f00" : "#56b4e9"], DASHES = [[], [6, 3], [2, 2], [9, 2, 2, 2], []];

/** Format a number with a constant width. */
function shown(value) {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(Math.abs(value) >= 99.95 ? 0 : Math.abs(value) >= 9.995 ? 1 : 2);
  return Number(text) === 0 ? text.replace("-", "") : text;
}

/** Draw a line through `points` [pixels]; a point without a finite height interrupts it. */
function line(pen, points, { colour, dash = [], width = 1, opacity = 1 }) {
  Object.assign(pen, { globalAlpha: opacity, strokeStyle: colour, lineWidth: width });
  pen.setLineDash(dash);
  pen.beginPath();
  let connected = false;
  for (const [x, y] of points) {
    if (connected && Number.isFinite(y)) pen.lineTo(x, y); else pen.moveTo(x, y);
    connected = Number.isFinite(y);
  }
  pen.stroke();
  pen.setLineDash([]);
  pen.globalAlpha = 1;
}

export class Chart {
  /**
   * `traces`: [{name, value(sample) -> number or NaN, raw: unfiltered values, drawn pale, spread: half the height of a band
   * around the trace}]; `minimumSpan`: smallest span of the value axis; `onZoom([from, to])`: called after a drag, with null
   * after a double click; `onPoint(time)`: called with the time under the pointer, or null when the pointer leaves.
   */
  constructor(title, unitText, traces, minimumSpan, onZoom, onPoint) {
    this.traces = traces.map((trace, i) => ({ on: true, colour: COLOURS[i], dash: DASHES[i], output: make("output", {}, "–"), ...trace }));
    this.minimumSpan = minimumSpan;
    this.canvas = make("canvas", { tabIndex: 0, role: "img", "aria-label": `${title} over time` });
    const keys = this.traces.map((trace) => {
      const key = button(`${trace.name} `, () => { trace.on = !trace.on; key.setAttribute("aria-pressed", String(trace.on)); this.draw(); }, { "aria-pressed": String(trace.on) });
      key.append(trace.output);
      key.style.borderBottom = `2px ${trace.dash.length === 0 ? "solid" : trace.dash[0] > 3 ? "dashed" : "dotted"} ${trace.colour}`;
      return key;
    });
    this.element = make("div", { className: "chart" },
      make("div", { className: "chart-head" }, make("b", {}, `${title} [${unitText}]`), ...keys), this.canvas);
    this.samples = [];
    this.range = [0, 1];
    this.cursor = this.drag = null; // cursor: marked time [s]; drag: horizontal start and end of a drag [pixels]
    this.listen(onZoom, onPoint);
  }

  listen(onZoom, onPoint) {
    const at = (event) => event.clientX - this.canvas.getBoundingClientRect().left;
    this.canvas.addEventListener("pointerdown", (event) => { this.drag = [at(event), at(event)]; this.canvas.setPointerCapture(event.pointerId); });
    this.canvas.addEventListener("pointermove", (event) => {
      if (this.drag !== null) this.drag[1] = at(event);
      onPoint(this.time(at(event)));
    });
    this.canvas.addEventListener("pointerup", () => {
      const [a, b] = this.drag ?? [0, 0];
      this.drag = null;
      if (Math.abs(a - b) > 6) onZoom([this.time(Math.min(a, b)), this.time(Math.max(a, b))]);
      this.draw();
    });
    this.canvas.addEventListener("pointercancel", () => { this.drag = null; });
    this.canvas.addEventListener("pointerleave", () => onPoint(null));
    this.canvas.addEventListener("dblclick", () => onZoom(null));
  }

  time(x) {
    const width = this.canvas.clientWidth - LEFT - RIGHT;
    return this.range[0] + ((x - LEFT) / width) * (this.range[1] - this.range[0]);
  }

  /** Mark a time in the chart and show the values at this time; null: show the newest values. */
  point(time) {
    this.cursor = time;
    this.draw();
  }

  /** Show `samples` over the time `range`; `zero` is the telemetry time at which the time axis shows 0. */
  show(samples, range, zero) {
    Object.assign(this, { samples, range, zero });
    this.draw();
  }

  draw() {
    const area = cleared(this.canvas);
    if (area === null) return;
    const { pen, width, height } = area, css = getComputedStyle(document.documentElement);
    const [ink, grid] = ["--dim", "--grid"].map((name) => css.getPropertyValue(name).trim());
    const [from, to] = this.range, samples = this.samples.filter((sample) => sample.time >= from && sample.time <= to);
    const traces = this.traces.filter((trace) => trace.on), [low, high] = this.bounds(traces, samples);
    const x = (time) => LEFT + ((time - from) / (to - from)) * (width - LEFT - RIGHT);
    const y = (value) => height - BOTTOM - ((value - low) / (high - low)) * (height - TOP - BOTTOM);
    const points = (value) => samples.map((sample) => [x(sample.time), y(value(sample))]);
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = ink;
    Object.assign(pen, { textAlign: "right", textBaseline: "middle" });
    for (const [value, text] of ticks(low, high, 4)) {
      line(pen, [[LEFT, y(value)], [width - RIGHT, y(value)]], { colour: grid });
      pen.fillText(text, LEFT - 5, y(value));
    }
    Object.assign(pen, { textAlign: "center", textBaseline: "top" });
    for (const [time, text] of ticks(from - this.zero, to - this.zero, 6)) {
      const tick = x(time + this.zero);
      line(pen, [[tick, TOP], [tick, height - BOTTOM]], { colour: grid });
      pen.fillText(`${text} s`, Math.min(tick, width - 16), height - BOTTOM + 5);
    }
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, 0, width - LEFT - RIGHT, height - BOTTOM);
    pen.clip();
    for (const { raw, colour } of traces) if (raw) line(pen, points(raw), { colour, opacity: 0.3 });
    for (const trace of traces) if (trace.spread) this.band(pen, trace, samples, x, y);
    for (const trace of traces) line(pen, points(trace.value), { ...trace, width: 2 });
    pen.restore();
    this.pointer(pen, samples, { width, height, x, ink });
  }

  /** Draw the uncertainty of a trace as a band, for samples whose uncertainty is known. */
  band(pen, trace, samples, x, y) {
    const drawn = samples.filter((sample) => Number.isFinite(trace.value(sample)) && Number.isFinite(trace.spread(sample)));
    if (drawn.length < 2) return;
    pen.globalAlpha = 0.15;
    pen.fillStyle = trace.colour;
    pen.beginPath();
    for (const sample of drawn) pen.lineTo(x(sample.time), y(trace.value(sample) + trace.spread(sample)));
    for (const sample of drawn.reverse()) pen.lineTo(x(sample.time), y(trace.value(sample) - trace.spread(sample)));
    pen.fill();
    pen.globalAlpha = 1;
  }

  bounds(traces, samples) {
    let low = Infinity, high = -Infinity;
    for (const read of traces.flatMap(({ value, raw }) => (raw ? [value, raw] : [value]))) {
      for (const value of samples.map(read)) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    if (low > high) return [-this.minimumSpan / 2, this.minimumSpan / 2];
    const margin = Math.max((high - low) * 0.08, (this.minimumSpan - (high - low)) / 2);
    return [low - margin, high + margin];
  }

  /** Draw the dragged interval and the marked time; show the values at this time. */
  pointer(pen, samples, { height, width, x, ink }) {
    if (this.drag !== null && Math.abs(this.drag[0] - this.drag[1]) > 3) {
      pen.fillStyle = "#0072b233";
      pen.fillRect(Math.min(...this.drag), TOP, Math.abs(this.drag[0] - this.drag[1]), height - TOP - BOTTOM);
    }
    const marked = this.cursor === null ? samples.at(-1) : samples[nearest(samples.map((sample) => sample.time), this.cursor)];
    for (const trace of this.traces) setText(trace.output, marked === undefined ? "–" : shown(trace.value(marked)));
    if (this.cursor === null || marked === undefined) return;
    const at = x(marked.time), behind = at > width - 70;
    line(pen, [[at, TOP], [at, height - BOTTOM]], { colour: ink });
    Object.assign(pen, { fillStyle: ink, textAlign: behind ? "right" : "left", textBaseline: "top" });
    pen.fillText(`${(marked.time - this.zero).toFixed(2)} s`, at + (behind ? -5 : 5), TOP);
  }
}

// ---- small chart of finished runs

const LINE_STYLES = [["#d55e00", ""], [DARK ? "#56b4e9" : "#0072b2", "6 3"], ["#009e73", "2 2"], ["#cc79a7", "9 2 2 2"], [DARK ? "#f0e442" : "#56b4e9", ""], ["#e69f00", "4 2"]];
/** Size and margins of a small chart, in units of its viewBox. */
const SMALL = { width: 420, height: 128, left: 40, right: 412, top: 6, bottom: 110 };

/** Return a small line chart of `lines`: [{time: [s], value: []}], without axes; all lines have one scale that starts at 0. */
export function sparkline(lines) {
  const { width, height } = SPARK, end = Math.max(...lines.map((one) => one.time.at(-1) ?? 0), 1e-3), highest = Math.max(...lines.flatMap((one) => one.value), 1e-3);
  const picture = svg("svg", { viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true", class: "curve" });
  for (const [i, { time, value }] of lines.entries()) {
    const points = time.map((one, k) => `${((one / end) * width).toFixed(1)},${(height - 1 - (value[k] / highest) * (height - 2)).toFixed(1)}`).join(" ");
    picture.append(svg("polyline", { points, stroke: LINE_STYLES[i % LINE_STYLES.length][0] }));
  }
  return picture;
}
const SPARK = { width: 64, height: 30 };

/**
 * Return a chart of `lines`: [{name, time: [s], value: []}], with the values under the pointer. The value axis starts at
 * 0. The time before `from` [s] is shaded, because the errors before that time do not count. `marks`: [{time: [s], text}].
 * Charts with the same `cursors` (a Set) have one cursor; `onPick(time)` is called with the time of a press. A single line has the `colour`.
 */
export function curve(title, unit, lines, { from = 0, marks = [], cursors = new Set(), onPick = null, colour: own = null } = {}) {
  const drawn = lines.filter((one) => one.time.length > 0).map((one, i, all) => ({ ...one, style: own !== null && all.length === 1 ? [own, ""] : LINE_STYLES[i % LINE_STYLES.length] }));
  if (drawn.length === 0) return make("p", { className: "small dim" }, `${title}: nothing was recorded`);
  const { width, height, left, right, top, bottom } = SMALL;
  const end = Math.max(...drawn.map((one) => one.time.at(-1)), 1e-3), highest = 1.08 * Math.max(...drawn.flatMap((one) => one.value), 1e-3);
  const x = (time) => left + (Math.max(0, time) / end) * (right - left), y = (value) => bottom - (value / highest) * (bottom - top);
  const picture = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${title} [${unit}] over time`, class: "curve" });
  if (from > 0) picture.append(svg("rect", { x: left, y: top, width: x(Math.min(from, end)) - left, height: bottom - top, class: "uncounted" }));
  for (const [value, text] of ticks(0, highest, 3)) {
    picture.append(svg("line", { x1: left, x2: right, y1: y(value), y2: y(value) }), svg("text", { x: left - 5, y: y(value) + 4, "text-anchor": "end" }, text));
  }
  for (const [time, text] of ticks(0, end, 6)) {
    picture.append(svg("line", { x1: x(time), x2: x(time), y1: top, y2: bottom }),
      svg("text", { x: Math.min(x(time), width - 14), y: height - 4, "text-anchor": "middle" }, `${text} s`));
  }
  const names = drawn.map(({ name, time, value, style: [colour, dash] }) => {
    const points = time.map((one, k) => `${x(one).toFixed(1)},${y(value[k]).toFixed(1)}`).join(" ");
    picture.append(svg("polyline", { points, stroke: colour, "stroke-dasharray": dash }));
    const largest = value.reduce((best, one, k) => (time[k] >= from && !(one <= value[best]) ? k : best), nearest(time, from));
    picture.append(svg("circle", { cx: x(time[largest]), cy: y(value[largest]), r: 3, stroke: colour, class: "largest" }));
    const key = make("span", { hidden: drawn.length === 1 }, name), output = make("span", { className: "said" });
    key.style.borderBottom = `2px ${dash === "" ? "solid" : "dashed"} ${colour}`;
    const showAt = (moment) => { output.textContent = moment === null ? "" : ` ${value[nearest(time, moment)].toPrecision(3)} ${unit}`; };
    return { element: make("span", { className: "key" }, key, output), showAt };
  });
  for (const { time, text } of marks.filter((one) => one.time >= 0 && one.time <= end)) {
    picture.append(svg("line", { x1: x(time), x2: x(time), y1: top, y2: bottom, class: "noted" }), svg("text", { x: x(time) + 3, y: top + 9, class: "noted" }, text));
  }
  const mark = svg("line", { y1: top, y2: bottom, class: "mark", visibility: "hidden" }), moment = make("span", { className: "said" });
  picture.append(mark);
  cursors.add((time) => {
    if (time !== null) for (const side of ["x1", "x2"]) mark.setAttribute(side, x(Math.min(time, end)));
    mark.setAttribute("visibility", time === null ? "hidden" : "visible");
    moment.textContent = time === null ? "" : `at ${time.toFixed(2)} s`;
    for (const { showAt } of names) showAt(time);
  });
  const timeAt = (event) => {
    const box = picture.getBoundingClientRect(), pointerX = ((event.clientX - box.left) / box.width) * width;
    return Math.min(end, Math.max(0, ((pointerX - left) / (right - left)) * end));
  };
  picture.addEventListener("pointermove", (event) => { for (const show of cursors) show(timeAt(event)); });
  picture.addEventListener("pointerleave", () => { for (const show of cursors) show(null); });
  if (onPick !== null) {
    picture.classList.add("pick");
    picture.addEventListener("click", (event) => onPick(timeAt(event)));
  }
  return make("figure", { className: "small" }, make("figcaption", {}, make("b", {}, `${title} [${unit}]`), ...names.map((one) => one.element), moment), picture);
}
