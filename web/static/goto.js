// Going to a pose in joints, by numbers: the working pose of the robot's file, or any other. Part of the tab Jog.
import { $, ask, confirm, fresh, latest, make, mayCommand, onStatus, press } from "./station.js";
import { poseText, tidy, unit } from "./form.js";
import "./jog.js"; // stands above

const bench = await ask("GET", "/api/bench");

const fields = bench.joints.map((joint) => {
  const [shown, scale] = unit(joint.unit);
  const input = make("input", { type: "number", step: "any", required: true, "aria-label": `${joint.name.replaceAll("_", " ")} to go to`,
    min: tidy(joint.lower * scale), max: tidy(joint.upper * scale) });
  const range = `${tidy(Math.round(joint.lower * scale))} … ${tidy(Math.round(joint.upper * scale))} ${shown}`;
  return { joint, input, scale, row: [make("label", {}, joint.name.replaceAll("_", " ")), input, make("span", { className: "unit" }, range)] };
});

const fill = (pose) => { for (const { joint, input, scale } of fields) if (pose?.[joint.name] !== undefined) input.value = tidy(Number((pose[joint.name] * scale).toFixed(2))); };
const read = () => Object.fromEntries(fields.map(({ joint, input, scale }) => [joint.name, Number(input.value) / scale]));

/** All joints at the same time, the longest way at half its joint's top speed [s]. */
const seconds = (pose, now) => Math.max(...bench.joints.map((joint) => Math.abs(pose[joint.name] - now[joint.name]) / (0.5 * joint.speed)));

/** Go to `pose` [rad, m] once it is confirmed; `wish` is what is asked of the station. */
export async function go(title, pose, wish) {
  const now = latest().joints;
  if (await confirm(title, "Go",
    make("p", {}, `All joints move at the same time, for about ${Math.ceil(seconds(pose, now))} s, to ${poseText(bench.joints, pose)}.`),
    make("p", { className: "dim" }, `Now: ${poseText(bench.joints, now)}. Look that the way is clear; STOP works all the time.`)) && await fresh())
    await press("POST", "/api/goto", wish);
}

const here = make("button", { type: "button" }, "Fill in where it is"), there = make("button", { type: "submit", className: "main" }, "Go there…");
const work = make("button", { type: "button", hidden: bench.working_pose === null,
  title: "from the working pose motions have room" }, "Go to the working pose…");
const whole = make("form", { noValidate: false }, make("fieldset", {}, make("legend", {}, "Go to a pose"),
  make("div", { className: "rows" }, ...fields.flatMap(({ row }) => row)),
  make("div", { className: "acts" }, there, work, here)));
here.addEventListener("click", () => fill(latest()?.joints));
work.addEventListener("click", () => go("Go to the working pose?", bench.working_pose, {}));
whole.addEventListener("submit", (event) => {
  event.preventDefault();
  const pose = read();
  go("Go to this pose?", pose, { joints: pose });
});
fill(bench.working_pose);
$("jog").append(whole);

onStatus((status, stale) => {
  const may = status !== null && !stale && mayCommand(status) && status.state === "READY";
  for (const button of [there, work]) button.disabled = !may;
});
