// Jog: the robot moves only while a button is held; and motion to a joint pose by numbers. Each jog command expires after
// 0.3 s, so the robot also stops when the page is lost.
import { $, blockReason, button, confirm, enable, ensureFresh, latest, make, note, onStatus, request, rigAnswer, sendCommand, tidy, unit, Refused } from "../page/station.js";
import { showReason } from "../page/header.js";
import { onTab } from "../page/tabs.js";
import { form as formOf, poseText, refuse, row, schemas } from "../page/form.js";
import { box as press } from "./press.js";
import { numberField } from "../page/number.js";

const REPEAT_MS = 100; // interval between two jog commands [ms]
let active = null;

/** Return why no jog may start or continue; empty if it may. */
export const jogReason = (status, stale) => blockReason(status, stale, status?.phase === "jogging" ? null : ["READY"]);

/**
 * Jog until `release()` is called, and mark the element `shown` as active; `velocity()` returns the velocity in SI. No
 * effect while another jog is active.
 */
export function startJogging(shown, space, velocity, ended = () => {}) {
  if (active !== null) return;
  const jog = active = { shown, space, running: true, zero: velocity().map(() => 0), ended };
  shown.classList.add("held");
  repeat(jog, velocity);
}
export const isHeld = (shown) => active?.shown === shown;

/** Jog while `control` is held; `velocity()` returns the velocity in SI. The check of the axes' signs also calls this. */
export function jogWhileHeld(control, space, velocity, ended = () => {}) {
  const startJog = (event) => {
    if (active !== null || control.disabled || control.classList.contains("step")) return;
    event.preventDefault();
    if (event.pointerId !== undefined) control.setPointerCapture(event.pointerId);
    startJogging(control, space, velocity, ended);
  };
  control.addEventListener("pointerdown", (event) => { if (event.button === 0) startJog(event); });
  for (const type of ["pointerup", "pointercancel", "lostpointercapture", "blur", "contextmenu"]) control.addEventListener(type, release);
  // A captured pointer sends no leave event, so its position is compared with the control's.
  control.addEventListener("pointermove", (event) => {
    if (!isHeld(control)) return;
    const box = control.getBoundingClientRect();
    if (event.clientX < box.left || event.clientX > box.right || event.clientY < box.top || event.clientY > box.bottom) release();
  });
  control.addEventListener("keydown", (event) => {
    if ((event.code === "Space" || event.code === "Enter") && !event.shiftKey && !event.repeat) startJog(event);
  });
  control.addEventListener("keyup", (event) => { if (!control.classList.contains("step")) event.preventDefault(); release(); });
}

async function repeat(jog, velocity) {
  try {
    while (jog.running) {
      const sentAt = performance.now();
      await request("POST", "/api/jog", { space: jog.space, velocity: velocity() }, 1000);
      await new Promise((resolve) => setTimeout(resolve, Math.max(0, REPEAT_MS - (performance.now() - sentAt))));
    }
    // The zero velocity is sent after the last answer, so that no earlier jog command arrives later.
    await request("POST", "/api/jog", { space: jog.space, velocity: jog.zero }, 1000);
  } catch (error) {
    release();
    note(error instanceof Refused ? error.message : `jog: the station does not answer (${error.message}); the robot stops by itself`);
  }
  jog.ended();
}

export function release() {
  if (active === null) return;
  active.running = false;
  active.shown.classList.remove("held");
  active = null;
}
window.addEventListener("blur", release);
window.addEventListener("pagehide", release);
document.addEventListener("visibilitychange", () => { if (document.hidden) release(); });
document.addEventListener("keydown", (event) => { if (event.key === "Escape") release(); });

/** Return a slider for a speed up to `maximum`, in the SI unit `si`: {elements, value() in SI}. */
export function speed(label, si, maximum, initial) {
  const [shown, scale] = unit(si), output = make("output");
  const slider = make("input", { type: "range", min: 0.02, max: 1, step: 0.02, value: initial, "aria-label": label });
  const value = () => Number(slider.value) * maximum;
  const show = () => { output.textContent = `${tidy(Number((value() * scale).toPrecision(2)))} ${shown}`; };
  slider.addEventListener("input", show);
  show();
  return { elements: [make("label", {}, label), slider, output], value };
}

/** Sizes of a step for each unit of the page: SI values. */
const STEPS = { m: [0.1e-3, 1e-3, 5e-3], rad: [1, 5].map((degrees) => (degrees * Math.PI) / 180) };
let stepping = false, stepRun = ""; // whether a step has been sent and has not ended; its run

/** Return a choice of what one press does: {elements, value()}; the value is 0 while the robot moves as long as a button is held. */
function stepSize(label, si) {
  const [shown, scale] = unit(si), size = make("select", { "aria-label": label }, make("option", { value: 0 }, "while held"),
    ...STEPS[si].map((value) => make("option", { value }, `by ${tidy(value * scale)} ${shown} each press`)));
  return { elements: [make("label", {}, label), size, make("span")], size, value: () => Number(size.value) };
}

/** Send one step, a motion to the pose of `body`; no effect before the previous step has ended. */
export async function step(body) {
  if (stepping) return;
  stepping = true;
  stepRun = "";
  const answer = await sendCommand("POST", "/api/goto", body);
  if (answer === null) stepping = false; else stepRun = answer.run_id;
}

// ---- buttons of the joints and of the tip

const SIGNS = [[-1, "−", "minus"], [1, "+", "plus"]];
const controls = [];

function axisRow(label, count, index, space, value, shown, size = null, target = null) {
  const pair = SIGNS.map(([sign, text, word]) => {
    const control = make("button", { type: "button", className: "hold", "aria-label": `${label} ${word}: hold to move` }, text);
    size?.size.addEventListener("change", () => {
      control.classList.toggle("step", size.value() > 0);
      control.setAttribute("aria-label", `${label} ${word}: ${size.value() > 0 ? "one step" : "hold to move"}`);
    });
    control.addEventListener("click", () => { if (size?.value() > 0) step(target(sign * size.value())); });
    jogWhileHeld(control, space, () => Array.from({ length: count }, (_, i) => (i === index ? sign * value() : 0)));
    controls.push(control);
    return control;
  });
  const current = make("span", { className: "dim live" });
  onStatus((status) => { if (status !== null && !$("jog").hidden) current.textContent = shown(status); });
  return [make("div", {}, make("div", {}, label), current), ...pair];
}

/** Text of a value that a station does not send before it is READY, although its devices answer. */
const NOT_YET = "known after homing";
const jointText = (joint, status) => {
  const [shown, scale] = unit(joint.unit), value = status.joints[joint.name];
  return value === undefined ? "" : status.tip_estimated === null ? NOT_YET : `${(value * scale).toFixed(2)} ${shown} (${tidy(Math.round(joint.lower * scale))} … ${tidy(Math.round(joint.upper * scale))})`;
};

const rig = await rigAnswer();
const topSpeed = (motion) => Math.min(...rig.joints.filter((one) => one.motion === motion).map((one) => one.speed));
const turning = speed("turn at", "rad/s", topSpeed("rotation"), 0.26);
const sliding = speed("slide at", "m/s", topSpeed("translation"), 0.26);
const tip = speed("tip at", "m/s", rig.tip_speed, 0.3);
const turnSize = stepSize("turn", "rad"), slideSize = stepSize("slide", "m"), tipSize = stepSize("move", "m");
/** Size of a step of the tip [m]; 0: the tip moves while a button or key is held. */
export const tipStep = tipSize.value;
const reason = make("p", { className: "small" });

/** Return a group of fields with its hint, its sliders and its rows of buttons. */
const group = (title, hint, sliders, rows) => make("fieldset", {}, make("legend", {}, title), hint && make("p", { className: "small dim" }, hint),
  make("div", { className: "rows" }, ...sliders.flatMap((slider) => slider.elements)), make("div", { className: "jog", style: "margin-top:10px" }, ...rows.flat()));

$("jog").append(
  make("p", {}, `The robot moves while you hold a button${matchMedia("(hover: none)").matches ? "" : " with the mouse or with Space"}, or by one step for each press.`), reason,
  group("Joints", null, [turning, turnSize, sliding, slideSize], rig.joints.map((joint, i) =>
    axisRow(joint.name.replaceAll("_", " "), rig.joints.length, i, "joints", joint.motion === "rotation" ? turning.value : sliding.value, (status) => jointText(joint, status),
      joint.motion === "rotation" ? turnSize : slideSize, (by) => ({ by: { [joint.name]: by } })))),
  group("Tip, world frame", "x points down, along gravity; z points along the tubes when they are straight", [tip, tipSize], ["x", "y", "z"].map((name, i) =>
    axisRow(name, 3, i, "tip", tip.value, (status) => (status.tip_measured !== null ? `${(1e3 * status.tip_measured[i]).toFixed(2)} mm` : status.tip_estimated === null ? NOT_YET : "not measured now"),
      tipSize, (by) => ({ tip: [0, 1, 2].map((axis) => (axis === i ? by : 0)) })))),
);
if (rig.turn_speed !== null) {
  const turnRate = speed("turn at", "rad/s", rig.turn_speed, 0.3);
  $("jog").append(group("Direction of the tip", "about an axis of the world frame; the tip keeps its position", [turnRate],
    ["x", "y", "z"].map((name, i) => axisRow(`turn about ${name}`, 3, i, "direction", turnRate.value, () => ""))));
}
const teach = button("Add the tip to the waypoints", async () => {
  const { addHere } = await import("../run/waypoints.js");
  taught.replaceChildren(`${addHere()} `, openList);
}, { title: "at the measured position of the tip; the first waypoint is the start" });
const taught = make("span", { className: "small", role: "status" }); // beside its button, which a note would cover
const openList = button("Open the list", async () => (await import("../run/run.js")).openMotion("waypoints"));
$("jog").append(make("div", { className: "acts" }, teach, taught), press, make("div", { id: "hands" }));
onTab("jog", (open) => { if (!open) release(); });

// ---- motion to a joint pose: the working pose of the robot's file, or any other

const fields = rig.joints.map((joint) => {
  const [shown, scale] = unit(joint.unit), label = joint.name.replaceAll("_", " "), [low, high] = [joint.lower * scale, joint.upper * scale];
  const input = numberField(`${label} to go to`, null, { min: Number(tidy(low)), max: Number(tidy(high)), required: true });
  return { joint, input, scale, cells: row(label, input, `${tidy(Math.round(low))} … ${tidy(Math.round(high))} ${shown}`) };
});

const fillFields = (pose) => { for (const { joint, input, scale } of fields) if (pose?.[joint.name] !== undefined) input.value = tidy(Number((pose[joint.name] * scale).toFixed(2))); };
const readPose = () => Object.fromEntries(fields.map(({ joint, input, scale }) => [joint.name, input.number / scale]));

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

const goButton = make("button", { type: "submit", className: "main" }, "Go there…");
const toWorkingPose = button("Go to the working pose…", () => go("Go to the working pose?", rig.working_pose, {}),
  { hidden: rig.working_pose === null, title: "the working pose leaves room for motions" });
const form = make("form", {}, make("fieldset", {}, make("legend", {}, "Go to a pose"),
  make("div", { className: "rows" }, ...fields.flatMap(({ cells }) => cells)),
  make("div", { className: "acts" }, goButton, toWorkingPose, button("Fill in the current pose", () => fillFields(latest()?.joints)))));
form.addEventListener("submit", (event) => {
  event.preventDefault();
  const pose = readPose();
  go("Go to this pose?", pose, { joints: pose });
});
fillFields(rig.working_pose);

// ---- motion of the tip to a place, by the model

const xyz = (tip) => tip.map((value) => tidy(Number((1e3 * value).toFixed(1))));
const tipNow = () => latest()?.tip_measured ?? latest()?.tip_estimated ?? null;
const { place } = (await schemas()).Goto.properties;
const placeFields = formOf({ properties: { place: { ...place.anyOf[0], description: "position of the tip, world frame [m]" } }, required: ["place"] });
const placeInputs = [...placeFields.element.querySelectorAll("input")];
const fillPlace = () => { if (tipNow() !== null) xyz(tipNow()).forEach((text, i) => { placeInputs[i].value = text; }); };
const placeButton = make("button", { type: "submit", className: "main" }, "Send the tip there…");
const placeForm = make("form", {}, make("fieldset", {}, make("legend", {}, "Go to a place"), placeFields.element,
  make("div", { className: "acts" }, placeButton, button("Fill in the present place", fillPlace))));
placeForm.addEventListener("submit", async (event) => {
  event.preventDefault();
  const body = placeFields.read(), text = (tip) => `x, y, z = ${xyz(tip).join(", ")} mm`;
  if (await confirm("Send the tip to this place?", "Go", make("p", {}, `From ${text(tipNow())} to ${text(body.place)}. The model computes the joints; all of them move at the same time.`),
    make("p", { className: "dim" }, "Check that the path is clear. STOP works at any time.")) && await ensureFresh())
    await sendCommand("POST", "/api/goto", body, (reason) => refuse(placeForm, reason));
});
onTab("jog", (open) => { if (open) fillPlace(); });
$("jog").append(placeForm, form);

onStatus((status, stale) => {
  const blocked = jogReason(status, stale), ready = blocked === "", goBlocked = blockReason(status, stale, ["READY"]);
  if (!ready) release();
  if (status === null || (status.state !== "RUNNING" && status.run?.id === stepRun)) stepping = false;
  // During a step its button stays enabled, because a disabled one would lose the keyboard's focus.
  for (const control of controls) enable(control, stepping && control.classList.contains("step") ? "" : blocked);
  for (const control of [goButton, toWorkingPose]) enable(control, goBlocked);
  enable(placeButton, goBlocked || (tipNow() === null ? "The tip is not measured now" : ""));
  if (!placeInputs.some((input) => input.value || input === document.activeElement)) fillPlace();
  enable(teach, goBlocked || (status.tip_measured === null ? "The tip is not measured now" : ""));
  if (status !== null) showReason(reason, status, ready);
});
