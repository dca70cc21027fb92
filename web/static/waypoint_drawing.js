// A small drawing of the path through the waypoints, from the side and from above, in one scale.
import { step } from "./chart.js";

const SIZE = 196, GAP = 12, MARGIN = 20;
/** Views of the drawing: [name, axis to the right, its sign, axis upward, its sign, text]. */
const VIEWS = [["side", 2, 1, 0, -1, "z → x ↓"], ["above", 2, 1, 1, 1, "z → y ↑"]];
/** Smallest extent that is drawn [m], so that a short path appears short. */
const MIN_EXTENT_M = 0.004;

function svg(tag, fields, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(fields)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/**
 * Draw `positions` (offsets of the waypoints from the start [m]) and the `path` through the waypoints. `bad` is the index
 * of an unreachable waypoint, or null.
 */
export function drawing(positions, path, bad) {
  const all = [[0, 0, 0], ...positions, ...path];
  const low = [0, 1, 2].map((axis) => Math.min(...all.map((one) => one[axis]))), high = [0, 1, 2].map((axis) => Math.max(...all.map((one) => one[axis])));
  const scale = (SIZE - 2 * MARGIN) / Math.max(MIN_EXTENT_M, ...low.map((least, axis) => high[axis] - least));
  const whole = svg("svg", { viewBox: `0 0 ${2 * SIZE + GAP} ${SIZE}`, role: "img", "aria-label": `path through ${positions.length} waypoints, from the side and from above`, class: "way" });
  for (const [i, [name, across, sign, up, sense, axesText]] of VIEWS.entries()) {
    const middle = (axis) => (low[axis] + high[axis]) / 2;
    const at = (position) => [SIZE / 2 + sign * scale * (position[across] - middle(across)), SIZE / 2 - sense * scale * (position[up] - middle(up))];
    const part = svg("g", { transform: `translate(${i * (SIZE + GAP)} 0)` }, svg("rect", { x: 0.5, y: 0.5, width: SIZE - 1, height: SIZE - 1, rx: 6 }));
    part.append(svg("polyline", { points: (path.length > 1 ? path : [[0, 0, 0], ...positions]).map((one) => at(one).map((x) => x.toFixed(1)).join(",")).join(" "), class: path.length > 1 ? "" : "guess" }));
    const [x0, y0] = at([0, 0, 0]);
    part.append(svg("path", { d: `M${x0 - 5} ${y0}h10M${x0} ${y0 - 5}v10`, class: "start" }));
    const labelled = positions[bad] === undefined ? [] : [at(positions[bad])];
    positions.forEach((position, k) => {
      const [x, y] = at(position);
      part.append(svg("circle", { cx: x, cy: y, r: k === bad ? 5 : 3, class: k === bad ? "bad" : "" }));
      // The numbers of waypoints must not overlap. The unreachable waypoint always has its number.
      if (k !== bad && labelled.some(([u, v]) => Math.hypot(x - u, y - v) < 12)) return;
      labelled.push([x, y]);
      const label = svg("text", { x: x + 6, y: y - 5, class: k === bad ? "bad" : "" });
      label.textContent = k + 1;
      part.append(label);
    });
    const title = svg("text", { x: 7, y: 14 }), bar = step((SIZE - 2 * MARGIN) / scale, 3), ruler = svg("text", { x: 12 + bar * scale, y: SIZE - 6 });
    title.textContent = `${name}: ${axesText}`;
    ruler.textContent = `${Number((1e3 * bar).toPrecision(3))} mm`;
    part.append(title, svg("path", { d: `M7 ${SIZE - 12}v4h${bar * scale}v-4`, class: "start" }), ruler);
    whole.append(part);
  }
  return whole;
}
