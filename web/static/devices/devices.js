// Devices: connect, home, tare, details of each device, raw values, and the check of the axes' signs.
import { $, benchNote, blockReason, button, confirm, enable, latest, make, note, onStatus, replaceChanged, request, rigAnswer, sendCommand, setText, showFailure, unit, withCode, Refused } from "../page/station.js";
import { home } from "../page/header.js";
import { isOpen, onTab, poll } from "../page/tabs.js";
import { jogReason, jogWhileHeld } from "../jog/jog.js";

const rig = await rigAnswer();

const buttons = {
  connect: button("Connect", () => sendCommand("POST", "/api/connect", {})),
  home: button("Home…", home),
  tare: button("Zero the force sensors", tare),
};

/** Zero the force; where that would hide a contact, only after the user has confirmed that nothing touches the robot. */
export async function tare() {
  let untouched = false;
  try {
    await request("POST", "/api/tare", {});
  } catch (error) {
    if (!(error instanceof Refused && error.message.includes("untouched"))) return showFailure(error);
    const free = make("label", {}, make("input", { type: "checkbox" }), "I have checked that nothing touches the tubes.");
    if (!await confirm("Zero the force although the tip may have contact?", "Zero", make("p", {}, error.message), free)) return;
    untouched = true;
  }
  if (!untouched || await sendCommand("POST", "/api/tare", { untouched })) note("the force now reads zero", true);
}

const ALLOWED = { connect: ["OFF"], home: ["CONNECTED", "READY"], tare: ["READY"] };
const list = make("div", { className: "live" }), raw = make("table", { className: "live" }), joints = make("div", { className: "jog", style: "grid-template-columns:auto auto 1fr" });
const bench = make("p", { className: "small" });
const robot = make("p", { className: "small" }, `Robot: ${rig.robot}, ${rig.joints.length} motors.`);
$("devices").append(make("div", { className: "acts", style: "margin:0 0 8px" }, ...Object.values(buttons)), robot, list, bench,
  make("h3", {}, "Does every axis move in the right direction?"),
  make("p", { className: "small dim" }, "Hold a button for a second or two: the joint moves slowly in its positive direction. The tracker's motion is compared with the model's."),
  joints, make("h3", {}, "Raw values"), raw);

/** Show once how a virtual lab is started with another robot. */
async function showRobots() {
  if (!rig.virtual || robot.children.length > 0) return;
  const others = (await request("GET", "/api/robots").catch(() => [])).filter(({ name }) => name !== rig.robot);
  if (others.length === 0 || robot.children.length > 0) return; // the next opening of the tab tries again
  robot.append(" For another robot end the station and start it with ", make("code", {}, "ctr-station serve --robot NAME"),
    ": ", ...withCode(`${others.map(({ name, motors }) => `\`${name}\` (${motors} motors)`).join(", ")}.`));
}
onTab("devices", (open) => { if (open) showRobots(); });
if (isOpen("devices")) showRobots();

// ---- axis signs

/** Speed of an axis while its sign is checked [rad/s, m/s]: slow enough to stop in time, but clearly above the noise. */
const CHECK_SPEED = { rad: 0.06, m: 0.002 }, MIN_MOTION_M = 0.8e-3; // smallest motion of the model's tip that the check needs

function addAxisCheck(joint, index) {
  const control = make("button", { type: "button", className: "hold" }, `${joint.name.replaceAll("_", " ")} +`);
  const verdict = make("span", { className: "small dim" }, "not checked");
  let startStatus = null; // status at the start of the check; a check that was too short continues from it
  for (const type of ["pointerdown", "keydown"]) control.addEventListener(type, () => { startStatus ??= latest(); });
  jogWhileHeld(control, "joints", () => rig.joints.map((_, i) => (i === index ? CHECK_SPEED[joint.unit] : 0)), async () => {
    await new Promise((resolve) => setTimeout(resolve, 400)); // wait until the tracker, which has a delay, has measured the final position
    const start = startStatus, end = latest();
    if (start === null || end === null) return;
    if ([start, end].some((one) => one.tip_measured === null || one.tip_estimated === null)) {
      verdict.textContent = "the tip is not measured now: check the tracker, then hold the button again";
      startStatus = null;
      return;
    }
    const moved = (key) => end[key].map((x, i) => x - start[key][i]);
    const measured = moved("tip_measured"), expected = moved("tip_estimated");
    const dot = measured.reduce((sum, x, i) => sum + x * expected[i], 0), size = Math.hypot(...measured), model = Math.hypot(...expected);
    const [unitText, scale] = unit(joint.unit);
    const result = `${((end.joints[joint.name] - start.joints[joint.name]) * scale).toFixed(1)} ${unitText}: tip ${(1e3 * size).toFixed(1)} mm, model ${(1e3 * model).toFixed(1)} mm`;
    if (model >= MIN_MOTION_M) startStatus = null;
    verdict.textContent = model < MIN_MOTION_M ? `${result}; hold longer, or bend the tubes first`
      : dot > 0.7 * size * model ? `✓ right direction (${result})` : `✗ not as the model expects (${result}): check the sign of this axis, its wiring and the tracker's frame`;
  });
  onStatus((status, stale) => { enable(control, jogReason(status, stale)); });
  joints.append(control, verdict, make("span"));
}
rig.joints.forEach(addAxisCheck);

// ---- lists

const valueText = (value) => value !== null && typeof value === "object"
  ? Object.entries(value).map(([key, one]) => `${key.replaceAll("_", " ")} ${valueText(one)}`).join(", ") : typeof value === "number" ? String(Number(value.toPrecision(6))) : String(value);

/** Return the box of a device: {element, show(device)}. The box stays while its values change, so that a click on its details is not lost. */
function deviceBox(name) {
  const light = make("i", { className: "light", style: "display:inline-block" }), condition = make("b"), text = make("span"), details = make("table");
  const element = make("fieldset", {}, make("legend", {}, name), make("div", {}, light, " ", condition, " ", text), make("details", {}, make("summary", {}, "details"), details));
  const show = (one) => {
    light.dataset.severity = one.condition === "connected" ? one.severity : Math.max(1, one.severity);
    setText(condition, one.condition);
    setText(text, one.text);
    details.replaceChildren(...Object.entries(one.details).map(([key, value]) => make("tr", {}, make("td", {}, key.replaceAll("_", " ")), make("td", { className: "any" }, valueText(value)))));
  };
  return { element, show };
}
const boxes = new Map(); // boxes of the devices by name

poll("devices", "/api/devices", 500, (all) => {
  for (const one of all.devices) {
    if (!boxes.has(one.name)) boxes.set(one.name, deviceBox(one.name));
    boxes.get(one.name).show(one);
  }
  replaceChanged(list, all.devices.map((one) => one.name), () => all.devices.map((one) => boxes.get(one.name).element));
  raw.replaceChildren(...Object.entries(all.raw).map(([name, value]) => make("tr", {}, make("td", { className: "any" }, make("code", {}, name)), make("td", { className: "number" }, value.toFixed(6)))));
});
onStatus((status, stale) => {
  if (status !== null) {
    setText(bench, benchNote(status.devices));
    buttons.tare.hidden = !("sensors" in status.devices || "tracker" in status.devices);
  }
  for (const [name, control] of Object.entries(buttons)) {
    enable(control, blockReason(status, stale, ALLOWED[name]));
  }
});
