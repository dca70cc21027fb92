// Dial of the force that the tip exerts on an obstacle: estimated and desired force, and the force that ends a motion.
import { make, onStatus, rigAnswer, setText, SILENT_AFTER_S } from "./station.js";
import { svg } from "./chart.js";
import { isForceKnown, latestSample } from "./telemetry.js";

const REFRESH_INTERVAL_MS = 100;
/** Size of the drawing, centre and radius of the arc, width of the arc [px]; angles of its ends, clockwise from 12 o'clock [°]. */
const WIDTH = 220, HEIGHT = 158, X = 110, Y = 108, RADIUS = 82, BAND = 12, FIRST = -112, LAST = 112;
/** End of the scale, as a multiple of the largest allowed force. */
const BEYOND = 1.15;
const AXES = ["x", "y", "z"];

const rig = await rigAnswer();
const length = (vector) => Math.hypot(...vector);
/** Format a force [N] with a constant width; a force that rounds to zero has no sign. */
export const newton = (value) => (Math.abs(value) < 0.005 ? "0.00" : value.toFixed(2).replace("-", "−"));

/** Name a direction of the world frame: "+x", or the components of a unit vector. */
export function directionText(vector) {
  const unit = vector.map((x) => x / length(vector)), axis = unit.findIndex((x) => Math.abs(x) > 0.9999);
  return axis >= 0 ? `${unit[axis] > 0 ? "+" : "−"}${AXES[axis]}` : `(${unit.map(newton).join(", ")})`;
}

const end = BEYOND * rig.max_force;
const angle = (force) => FIRST + (LAST - FIRST) * Math.min(1, Math.max(0, force / end));
const at = (degrees, radius) => [X + radius * Math.sin((degrees * Math.PI) / 180), Y - radius * Math.cos((degrees * Math.PI) / 180)].map((x) => x.toFixed(2)).join(" ");
const arc = (from, to) => `M${at(from, RADIUS)}A${RADIUS} ${RADIUS} 0 ${to - from > 180 ? 1 : 0} 1 ${at(to, RADIUS)}`;

/** Describe the force of a telemetry sample along the desired one: {exerted [N], contact [s] since its start, or null}. */
function measured(sample, desired) {
  const known = sample !== null && sample.phase === "moving" && isForceKnown(sample, desired.map((x) => x / length(desired)));
  if (!known) return { exerted: null, contact: null };
  const exerted = -desired.reduce((sum, x, i) => sum + x * sample.force_filtered[i], 0) / length(desired);
  return { exerted, contact: sample.contact_start > 0 ? sample.time - sample.contact_start : null };
}

/** Return a dial, which is hidden unless the run holds a force. */
export function forceDial() {
  const value = svg("path", { class: "value" }), needle = svg("path", { class: "needle", d: `M${X - 5} ${Y - 50}L${X} ${Y - RADIUS - BAND / 2}L${X + 5} ${Y - 50}Z` });
  const goal = svg("path", { class: "goal", d: `M${X} ${Y - RADIUS + BAND / 2}v${-BAND}l-6 -9h12l-6 9` });
  const limit = angle(rig.max_force);
  const [limitX, limitY] = at(limit, RADIUS + 13).split(" ").map(Number), [zeroX, zeroY] = at(FIRST, RADIUS).split(" ").map(Number);
  const number = svg("text", { class: "number", x: X, y: Y + 6 }), unit = svg("text", { class: "unit", x: X, y: Y + 26 }, "N");
  const drawing = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, "aria-hidden": "true" },
    svg("path", { class: "band", d: arc(FIRST, LAST) }), value, svg("path", { class: "limit", d: arc(limit, LAST) }),
    svg("text", { x: zeroX, y: zeroY + 20, class: "scale" }, "0"), svg("text", { x: limitX, y: limitY + 4, class: "limit-text" }, newton(rig.max_force)),
    goal, needle, number, unit);
  const meter = make("div", { role: "meter", "aria-label": "force of the tip", "aria-valuemin": "0", "aria-valuemax": rig.max_force.toFixed(2) }, drawing);
  const contact = make("p", { className: "contact" }), since = make("span"), changes = make("span", { role: "status", className: "unseen" });
  const desiredText = make("dd"), possible = make("dd"), limitValue = make("dd", {}, `${newton(rig.max_force)} N`), along = make("dd");
  const element = make("div", { className: "dial", hidden: true }, meter, make("div", { className: "facts" }, contact, changes,
    make("dl", {}, make("dt", { className: "desired" }, "desired"), desiredText, make("dt", {}, "along"), along, make("dt", {}, "at most"), possible, make("dt", { className: "bound" }, "HOLD at"), limitValue)));
  contact.append(make("b"), since);

  let run = null;
  function show() {
    const desired = run?.desired_force ?? null;
    element.hidden = desired === null;
    if (desired === null) return;
    const sample = latestSample(SILENT_AFTER_S), goalForce = length(desired), { exerted, contact: seconds } = measured(sample, desired);
    const turn = angle(exerted ?? 0);
    goal.setAttribute("transform", `rotate(${angle(goalForce)} ${X} ${Y})`);
    needle.style.transform = `rotate(${turn}deg)`;
    needle.style.visibility = exerted === null ? "hidden" : "visible";
    value.setAttribute("d", exerted === null || turn - FIRST < 0.5 ? "" : arc(FIRST, turn));
    setText(number, exerted === null ? "–" : newton(exerted));
    setText(desiredText, `${newton(goalForce)} N`);
    setText(along, directionText(desired));
    setText(possible, exerted === null ? "–" : `${newton(sample.force_possible)} N`);
    const words = run.phase !== "moving" ? "not started yet" : exerted === null ? "force unknown" : seconds === null ? "no contact" : "in contact";
    element.dataset.contact = words;
    setText(contact.firstChild, words);
    setText(since, seconds === null || exerted === null ? "" : ` for ${Math.floor(seconds)} s`);
    setText(changes, words);
    meter.setAttribute("aria-valuenow", Math.min(rig.max_force, Math.max(0, exerted ?? 0)).toFixed(2));
    meter.setAttribute("aria-valuetext", exerted === null ? words : `${newton(exerted)} N of ${newton(goalForce)} N, ${words}`);
  }
  onStatus((status) => {
    if (status === null) return;
    run = status.state === "RUNNING" ? status.run : null;
    show();
  });
  setInterval(() => { if (!element.hidden && element.closest("[hidden]") === null) show(); }, REFRESH_INTERVAL_MS);
  return element;
}
