// The next action that the station suggests, as a button.
import { request, confirm, make, mayCommand, onRefusal, sendCommand } from "./station.js";
import { poseText } from "./form.js";
import { takeOver } from "./operator.js";
import { alarm } from "./stop.js";
import { openTab } from "./tabs.js";

export async function home() {
  const rig = await request("GET", "/api/rig");
  const workingPose = rig.working_pose === null ? null
    : make("p", {}, `Then the robot goes to its working pose: ${poseText(rig.joints, rig.working_pose)}.`);
  const clear = make("label", {}, make("input", { type: "checkbox" }), "The path is clear: I have checked that the tubes can be retracted and turned without touching anything.");
  if (await confirm("Home every stage?", "Home", make("p", {}, "The translation is retracted first. Then the axes search for their home sensors, one after the other. STOP works at any time."), workingPose, clear))
    await sendCommand("POST", "/api/home", { way_is_clear: true });
}

export async function reset() {
  if (await sendCommand("POST", "/api/reset", {})) alarm("");
}

/** Button label and effect of each `status.action`. */
const ACTIONS = {
  connect: ["Connect", () => sendCommand("POST", "/api/connect", {})],
  home: ["Home…", home],
  reset: ["Reset", reset],
  start: ["Choose a motion", () => openTab("start")],
  calibrate: ["Calibrate", () => openTab("calibrate")],
};

/** Return the button of an action, by default the next one of `status`; null for an unknown action. */
export function actionButton(status, action = status.action) {
  if (!(action in ACTIONS)) return null;
  const [label, onClick] = ACTIONS[action];
  const className = action === status.action ? "main" : "";
  const button = make("button", { type: "button", className, disabled: !mayCommand(status) && !["start", "calibrate"].includes(action) }, label);
  button.addEventListener("click", onClick);
  return button;
}

/**
 * Show in `element` why no motion can start now, and a button for the next action. `element` is empty while a motion can
 * start.
 */
export function showReason(element, status, ready = status.action === "start") {
  const may = mayCommand(status);
  const reason = status.operator.role === "viewer" ? "viewers cannot start anything" : !may ? `'${status.operator.name}' is operator`
    : ready ? "" : status.state === "READY" ? status.message : `not while ${status.state}; ${status.next || "wait for the end or press STOP"}`;
  const shown = JSON.stringify([reason, status.action, may]);
  if (element.dataset.shown === shown) return; // replacing an unchanged button would interrupt a click on it
  element.dataset.shown = shown;
  const button = reason === "" || !may ? null : actionButton(status);
  element.replaceChildren(reason, ...(button === null ? [] : [" ", button]));
}

onRefusal((status) => (status.operator.role === "viewer" || status.action === "start" ? null : mayCommand(status) ? actionButton(status) : takeOver()));
