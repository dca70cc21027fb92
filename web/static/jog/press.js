// Jog: press on an obstacle. The tip moves in a direction until it touches something, and holds a force there. This is an
// ordinary run of the motion `force`, from the current pose.
import { blockReason, enable, ensureFresh, latest, make, note, onStatus, request, rigAnswer, sendCommand, setText, CHECKING } from "../page/station.js";
import { showReason } from "../page/header.js";
import { form, refuse, row, schemas, withMaximum } from "../page/form.js";
import { forceDial, newton } from "../page/dial.js";

/** Initial values of the form, SI. */
const INITIAL_VALUES = { force: 0.2, speed: 0.005, reach: 0.02, duration: 60 };
/** Directions to choose from: unit vectors of the world frame, or the tip's axis with a sign. */
const DIRECTIONS = [
  { text: "+x", vector: [1, 0, 0] }, { text: "+y", vector: [0, 1, 0] }, { text: "+z", vector: [0, 0, 1] }, { text: "forward", tip: 1 },
  { text: "−x", vector: [-1, 0, 0] }, { text: "−y", vector: [0, -1, 0] }, { text: "−z", vector: [0, 0, -1] }, { text: "backward", tip: -1 },
];
/** Obstacles that the virtual lab can put in front of the tip, with their stiffness [N/m]. */
const OBSTACLES = [["nothing", null], ["wall, 4 mm ahead", 1000], ["tissue, 4 mm ahead", 100]], OBSTACLE_DISTANCE_M = 0.004;

const rig = await rigAnswer(), all = await schemas();
/** Why this station cannot hold a force; empty if it can. */
const MISSING = rig.controller.inner === "type_2" ? "" : "needs the inner loop type_2, and so a tracker";
const { force, speed, reach } = withMaximum(all.ForceMotion, "force", rig.max_desired_force).properties, { duration } = all.Start.properties;
const values = form({ properties: { force, speed, reach, duration }, required: ["force", "speed", "reach", "duration"] }, { values: { ...INITIAL_VALUES, force: Math.min(INITIAL_VALUES.force, force.maximum) } });
const obstacle = make("select", { "aria-label": "simulated obstacle" }, ...OBSTACLES.map(([text], i) => make("option", { value: i }, text)));

if (rig.virtual) values.element.firstChild.append(...row("obstacle", obstacle, "virtual lab"));

const choices = DIRECTIONS.map((direction, i) => ({ ...direction, input: make("input", { type: "radio", name: "press-direction", value: i, checked: i === 0, className: "unseen", "aria-label": direction.tip ? `along the tip's axis, ${direction.text}` : direction.text }) }));
const chosen = () => choices.find(({ input }) => input.checked);

/** Return the chosen direction as a unit vector of the world frame; the model computes the tip's axis at the current pose and force. */
async function direction() {
  const { vector, tip } = chosen();
  if (tip === undefined) return vector;
  const { joints, force } = latest();
  const solution = await request("POST", "/api/model/solve", { joints, ...(force && { force }) });
  return solution.direction.map((component) => tip * component);
}

async function press() {
  if (!await ensureFresh()) return;
  try {
    const along = await direction(), stiffness = OBSTACLES[obstacle.value][1];
    const load = !rig.virtual ? {} : { load: stiffness === null ? { kind: "none" } : { kind: "wall", direction: along.map((x) => -x), distance: OBSTACLE_DISTANCE_M, stiffness } };
    const { duration: seconds, ...motion } = values.read();
    const answer = await sendCommand("POST", "/api/start", { trajectory: { kind: "force", direction: along, ...motion }, controller: { ...rig.controller, stiffness: null }, ...load, duration: seconds }, (text) => refuse(box, text));
    for (const text of answer?.warnings ?? []) note(`started, but ${text}`);
  } catch (error) {
    note(error.message);
  }
}

const start = make("button", { type: "submit", className: "main" }), reason = make("span", { className: "small dim" }), left = make("p", { className: "small dim" });
const fields = make("div", {},
  make("p", { className: "small dim" }, "The tip moves in the direction until it touches something, then holds the force. At the end the joints stop, so on an obstacle at rest the force stays."),
  make("div", { role: "radiogroup", "aria-label": "direction in which the tip presses", className: "directions" },
    ...choices.map(({ text, input }) => make("label", {}, input, make("span", {}, text)))),
  make("p", { className: "small dim" }, "x points down, along gravity; z along the straight tubes; forward and backward are along the tip's axis at the start."),
  values.element,
  make("div", { className: "acts" }, start, reason));
/** Form of a press, and its dial while the tip holds a force. */
export const box = make("form", { id: "press" }, make("fieldset", {}, make("legend", {}, "Hold a force"), forceDial(), left, fields));
box.addEventListener("submit", async (event) => {
  event.preventDefault();
  starting = true;
  show(latest(), false);
  await press();
  starting = false;
  show(latest(), false);
});
let starting = false;
const describe = () => {
  const { force: desired } = values.read(), { text, tip } = chosen();
  setText(start, desired > 0 ? `Press with ${newton(desired)} N ${tip ? `${text}` : `along ${text}`}` : "Press");
};
box.addEventListener("input", describe);
describe();

function show(status, stale) {
  if (status === null) return;
  const run = status.state === "RUNNING" ? status.run : null, pressing = Boolean(run?.desired_force), ready = status.state === "READY";
  left.hidden = !pressing;
  fields.hidden = pressing;
  if (pressing) setText(left, run.phase === "moving" ? "STOP ends it at once." : status.message);
  enable(start, MISSING || (starting ? CHECKING : blockReason(status, stale, ["READY"])));
  if (MISSING === "") showReason(reason, status, ready); else setText(reason, MISSING);
}
onStatus(show);
