// One chart on a canvas: traces over time, their values above it, zoom by dragging. No library.
import { make } from "./station.js";

const LEFT = 46, RIGHT = 8, TOP = 6, BOTTOM = 20;

/** Return a step of 1, 2 or 5 times a power of ten that gives about `count` ticks. */
export function step(span, count) {
  const rough = span / count, power = 10 ** Math.floor(Math.log10(rough)), part = rough / power;
  return power * (part < 1.5 ? 1 : part < 3.5 ? 2 : part < 7.5 ? 5 : 10);
}

/** Format a number with a constant width. */
function shown(value) {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(Math.abs(value) >= 99.95 ? 0 : Math.abs(value) >= 9.995 ? 1 : 2);
  return Number(text) === 0 ? text.replace("-", "") : text;
}

export class Chart {
  /**
   * `traces`: [{name, colour, dash, value(sample) -> number or NaN, raw: unfiltered values, drawn pale, spread: half the
   * height of a band around the trace}]; `minimumSpan`: smallest span of the value axis; `onPoint(time)`: called with the
   * time under the pointer, or null when the pointer leaves the chart.
   */
  constructor(title, unitText, traces, minimumSpan, onZoom, onPoint) {
    this.traces = traces.map((trace) => ({ ...trace, on: trace.on ?? true }));
    this.unit = unitText;
    this.minimumSpan = minimumSpan;
    this.canvas = make("canvas", { tabIndex: 0, role: "img", "aria-label": `${title} over time` });
    this.keys = this.traces.map((trace) => {
      const output = make("output", {}, "–"), key = make("button", { type: "button", "aria-pressed": String(trace.on) }, `${trace.name} `, output);
      trace.output = output;
      key.style.borderBottom = `2px ${trace.dash.length === 0 ? "solid" : trace.dash[0] > 3 ? "dashed" : "dotted"} ${trace.colour}`;
      key.addEventListener("click", () => { trace.on = !trace.on; key.setAttribute("aria-pressed", String(trace.on)); this.draw(); });
      return key;
    });
    this.element = make("div", { className: "chart" },
      make("div", { className: "chart-head" }, make("b", {}, `${title} [${unitText}]`), ...this.keys), this.canvas);
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

  show(samples, range, zero) {
    this.samples = samples;
    this.range = range;
    this.zero = zero; // telemetry time at which the time axis shows 0
    this.draw();
  }

  draw() {
    const { canvas } = this, width = canvas.clientWidth, height = canvas.clientHeight;
    if (width === 0) return;
    const ratio = window.devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d"), css = getComputedStyle(document.documentElement);
    const ink = css.getPropertyValue("--dim").trim(), grid = css.getPropertyValue("--grid").trim();
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "11px system-ui, sans-serif";
    const [from, to] = this.range, within = this.samples.filter((sample) => sample.time >= from && sample.time <= to);
    const [low, high] = this.bounds(within);
    const x = (time) => LEFT + ((time - from) / (to - from)) * (width - LEFT - RIGHT);
    const y = (value) => height - BOTTOM - ((value - low) / (high - low)) * (height - TOP - BOTTOM);
    this.axes(pen, { width, height, low, high, from, to, x, y, ink, grid });
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, 0, width - LEFT - RIGHT, height - BOTTOM);
    pen.clip();
    for (const trace of this.traces.filter((one) => one.on && one.raw)) this.line(pen, { ...trace, value: trace.raw, dash: [] }, within, x, y, 0.3);
    for (const trace of this.traces.filter((one) => one.on && one.spread)) this.band(pen, trace, within, x, y);
    for (const trace of this.traces.filter((one) => one.on)) this.line(pen, trace, within, x, y);
    pen.restore();
    this.pointer(pen, within, { width, height, x, y, ink });
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

  bounds(samples) {
    let low = Infinity, high = -Infinity;
    for (const trace of this.traces.filter((one) => one.on)) {
      for (const sample of samples) {
        for (const value of trace.raw ? [trace.value(sample), trace.raw(sample)] : [trace.value(sample)]) {
          if (value < low) low = value;
          if (value > high) high = value;
        }
      }
    }
    if (low > high) return [-this.minimumSpan / 2, this.minimumSpan / 2];
    const margin = Math.max((high - low) * 0.08, (this.minimumSpan - (high - low)) / 2);
    return [low - margin, high + margin];
  }

  axes(pen, { width, height, low, high, from, to, x, y, ink, grid }) {
    pen.lineWidth = 1;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const rise = step(high - low, 4), digits = Math.max(0, -Math.floor(Math.log10(rise) + 1e-9));
    for (let value = Math.ceil(low / rise) * rise; value <= high; value += rise) {
      pen.strokeStyle = grid;
      pen.beginPath();
      pen.moveTo(LEFT, y(value));
      pen.lineTo(width - RIGHT, y(value));
      pen.stroke();
      pen.fillStyle = ink;
      pen.fillText(value.toFixed(digits), LEFT - 5, y(value));
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    const pace = step(to - from, 6), timeDigits = Math.max(0, -Math.floor(Math.log10(pace) + 1e-9));
    for (let time = Math.ceil((from - this.zero) / pace) * pace; time + this.zero <= to; time += pace) {
      pen.strokeStyle = grid;
      pen.beginPath();
      pen.moveTo(x(time + this.zero), TOP);
      pen.lineTo(x(time + this.zero), height - BOTTOM);
      pen.stroke();
      pen.fillStyle = ink;
      pen.fillText(`${time.toFixed(timeDigits)} s`, Math.min(x(time + this.zero), width - 16), height - BOTTOM + 5);
    }
  }

  line(pen, trace, samples, x, y, opacity = 1) {
    pen.globalAlpha = opacity;
    pen.strokeStyle = trace.colour;
    pen.lineWidth = opacity < 1 ? 1 : 2;
    pen.setLineDash(trace.dash);
    pen.beginPath();
    let connected = false;
    for (const sample of samples) {
      const value = trace.value(sample);
      if (!Number.isFinite(value)) { connected = false; continue; }
      if (connected) pen.lineTo(x(sample.time), y(value)); else pen.moveTo(x(sample.time), y(value));
      connected = true;
    }
    pen.stroke();
    pen.setLineDash([]);
    pen.globalAlpha = 1;
  }

  pointer(pen, samples, { height, width, x, ink }) {
    if (this.drag !== null && Math.abs(this.drag[0] - this.drag[1]) > 3) {
      pen.fillStyle = "#0072b233";
      pen.fillRect(Math.min(...this.drag), TOP, Math.abs(this.drag[0] - this.drag[1]), height - TOP - BOTTOM);
    }
    const time = this.cursor, nearest = time === null || samples.length === 0 ? samples.at(-1)
      : samples.reduce((best, one) => (Math.abs(one.time - time) < Math.abs(best.time - time) ? one : best));
    for (const trace of this.traces) {
      const text = nearest === undefined ? "–" : shown(trace.value(nearest));
      if (trace.output.textContent !== text) trace.output.textContent = text;
    }
    if (time === null || nearest === undefined) return;
    pen.strokeStyle = ink;
    pen.beginPath();
    pen.moveTo(x(nearest.time), TOP);
    pen.lineTo(x(nearest.time), height - BOTTOM);
    pen.stroke();
    pen.fillStyle = ink;
    const behind = x(nearest.time) > width - 70;
    pen.textAlign = behind ? "right" : "left";
    pen.textBaseline = "top";
    pen.fillText(`${(nearest.time - this.zero).toFixed(2)} s`, x(nearest.time) + (behind ? -5 : 5), TOP);
  }
}
