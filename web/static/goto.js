// Motion to a joint pose by numbers: the working pose of the robot's file, or any other. Part of the tab Jog.
import { $, request, confirm, ensureFresh, latest, make, mayCommand, onStatus, sendCommand } from "./station.js";
import { poseText, tidy, unit } from "./form.js";
import "./jog.js"; // imported first, because the fields of jog.js come first in the tab

const rig = await request("GET", "/api/rig");

const fields = rig.joints.map((joint) => {
  const [shown, scale] = unit(joint.unit);
  const input = make("input", { type: "number", step: "any", required: true, "aria-label": `${joint.name.replaceAll("_", " ")} to go to`,
    min: tidy(joint.lower * scale), max: tidy(joint.upper * scale) });
  const range = `${tidy(Math.round(joint.lower * scale))} … ${tidy(Math.round(joint.upper * scale))} ${shown}`;
  return { joint, input, scale, row: [make("label", {}, joint.name.replaceAll("_", " ")), input, make("span", { className: "unit" }, range)] };
});

const fillFields = (pose) => { for (const { joint, input, scale } of fields) if (pose?.[joint.name] !== undefined) input.value = tidy(Number((pose[joint.name] * scale).toFixed(2))); };
const readPose = () => Object.fromEntries(fields.map(({ joint, input, scale }) => [joint.name, Number(input.value) / scale]));

/** Return the motion's duration [s]: the joints move together, and the slowest one moves at half of its top speed. */
const seconds = (pose, current) => Math.max(...rig.joints.map((joint) => Math.abs(pose[joint.name] - current[joint.name]) / (0.5 * joint.speed)));

/** Go to `pose` [rad, m] after a confirmation; `body` is the request to the station. */
export async function go(title, pose, body) {
  const current = latest().joints;
  if (await confirm(title, "Go",
    make("p", {}, `All joints move at the same time, for about ${Math.ceil(seconds(pose, current))} s, to ${poseText(rig.joints, pose)}.`),
    make("p", { className: "dim" }, `Now: ${poseText(rig.joints, current)}. Check that the path is clear. STOP works at any time.`)) && await ensureFresh())
    await sendCommand("POST", "/api/goto", body);
}

const fillCurrent = make("button", { type: "button" }, "Fill in the current pose"), goButton = make("button", { type: "submit", className: "main" }, "Go there…");
const toWorkingPose = make("button", { type: "button", hidden: rig.working_pose === null,
  title: "the working pose leaves room for motions" }, "Go to the working pose…");
const form = make("form", { noValidate: false }, make("fieldset", {}, make("legend", {}, "Go to a pose"),
  make("div", { className: "rows" }, ...fields.flatMap(({ row }) => row)),
  make("div", { className: "acts" }, goButton, toWorkingPose, fillCurrent)));
fillCurrent.addEventListener("click", () => fillFields(latest()?.joints));
toWorkingPose.addEventListener("click", () => go("Go to the working pose?", rig.working_pose, {}));
form.addEventListener("submit", (event) => {
  event.preventDefault();
  const pose = readPose();
  go("Go to this pose?", pose, { joints: pose });
});
fillFields(rig.working_pose);
$("jog").append(form);

onStatus((status, stale) => {
  const enabled = status !== null && !stale && mayCommand(status) && status.state === "READY";
  for (const button of [goButton, toWorkingPose]) button.disabled = !enabled;
});
