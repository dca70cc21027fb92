// A small chart of finished runs: a few lines over time, axes, names, and values under the pointer.
import { make } from "./station.js";
import { step } from "./chart.js";

const DARK = matchMedia("(prefers-color-scheme: dark)").matches; // dark blue lines need a light background
const LINE_STYLES = [["#d55e00", ""], [DARK ? "#56b4e9" : "#0072b2", "6 3"], ["#009e73", "2 2"], ["#cc79a7", "9 2 2 2"], [DARK ? "#f0e442" : "#56b4e9", ""], ["#e69f00", "4 2"]];
const WIDTH = 420, HEIGHT = 128, LEFT = 40, RIGHT = 8, TOP = 6, BOTTOM = 18;

function svg(tag, fields, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(fields)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** Return the ticks of an axis from `low` to `high`: [[value, text]]. */
function marks(low, high, count) {
  const pace = step(high - low, count), digits = Math.max(0, -Math.floor(Math.log10(pace) + 1e-9));
  const found = [];
  for (let value = Math.ceil(low / pace - 1e-9) * pace; value <= high + 1e-9 * pace; value += pace) found.push([value, value.toFixed(digits)]);
  return found;
}

function at(line, time) {
  let best = 0;
  for (let i = 1; i < line.time.length; i++) if (Math.abs(line.time[i] - time) < Math.abs(line.time[best] - time)) best = i;
  return line.value[best];
}

/**
 * Return a chart of `lines`: [{name, time: [s], value: []}]. The value axis starts at 0. The time before `from` [s] is
 * shaded, because the errors before that time do not count.
 */
export function curve(title, unit, lines, from = 0) {
  const drawn = lines.filter((line) => line.time.length > 0);
  if (drawn.length === 0) return make("p", { className: "small dim" }, `${title}: nothing was recorded`);
  const end = Math.max(...drawn.map((line) => line.time.at(-1)), 1e-3), top = 1.08 * Math.max(...drawn.flatMap((line) => line.value), 1e-3);
  const x = (time) => LEFT + (Math.max(0, time) / end) * (WIDTH - LEFT - RIGHT), y = (value) => HEIGHT - BOTTOM - (value / top) * (HEIGHT - TOP - BOTTOM);
  const picture = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `${title} [${unit}] over time`, class: "curve" });
  if (from > 0) picture.append(svg("rect", { x: LEFT, y: TOP, width: x(Math.min(from, end)) - LEFT, height: HEIGHT - TOP - BOTTOM, class: "uncounted" }));
  for (const [value, text] of marks(0, top, 3)) {
    picture.append(svg("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y(value), y2: y(value) }), svg("text", { x: LEFT - 5, y: y(value) + 4, "text-anchor": "end" }, text));
  }
  for (const [time, text] of marks(0, end, 6)) {
    picture.append(svg("line", { x1: x(time), x2: x(time), y1: TOP, y2: HEIGHT - BOTTOM }),
      svg("text", { x: Math.min(x(time), WIDTH - 14), y: HEIGHT - 4, "text-anchor": "middle" }, `${text} s`));
  }
  drawn.forEach((line, i) => {
    const [colour, dash] = LINE_STYLES[i % LINE_STYLES.length];
    const points = line.time.map((time, k) => `${x(time).toFixed(1)},${y(line.value[k]).toFixed(1)}`).join(" ");
    picture.append(svg("polyline", { points, stroke: colour, "stroke-dasharray": dash }));
  });
  const mark = svg("line", { y1: TOP, y2: HEIGHT - BOTTOM, class: "mark", visibility: "hidden" });
  picture.append(mark);
  const names = drawn.map((line, i) => {
    const key = make("span", { hidden: drawn.length === 1 }, line.name), output = make("span", { className: "said" });
    key.style.borderBottom = `2px ${LINE_STYLES[i % LINE_STYLES.length][1] === "" ? "solid" : "dashed"} ${LINE_STYLES[i % LINE_STYLES.length][0]}`;
    return { element: make("span", { className: "key" }, key, output), output, line };
  });
  picture.addEventListener("pointermove", (event) => {
    const box = picture.getBoundingClientRect(), pointerX = ((event.clientX - box.left) / box.width) * WIDTH;
    const time = Math.min(end, Math.max(0, ((pointerX - LEFT) / (WIDTH - LEFT - RIGHT)) * end));
    mark.setAttribute("x1", x(time));
    mark.setAttribute("x2", x(time));
    mark.setAttribute("visibility", "visible");
    for (const { output, line } of names) output.textContent = ` ${at(line, time).toPrecision(3)} ${unit}`;
  });
  picture.addEventListener("pointerleave", () => { mark.setAttribute("visibility", "hidden"); for (const { output } of names) output.textContent = ""; });
  return make("figure", { className: "small" }, make("figcaption", {}, make("b", {}, `${title} [${unit}]`), ...names.map((name) => name.element)), picture);
}
