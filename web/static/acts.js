// What a message asks a person to do, as the button that does it.
import { ask, confirm, make, mayCommand, onRefusal, press } from "./station.js";
import { poseText } from "./form.js";
import { takeOver } from "./operator.js";
import { alarm } from "./stop.js";
import { open } from "./tabs.js";

export async function home() {
  const bench = await ask("GET", "/api/bench");
  const toWork = bench.working_pose === null ? null
    : make("p", {}, `Then the robot goes to its working pose: ${poseText(bench.joints, bench.working_pose)}.`);
  const sure = make("label", {}, make("input", { type: "checkbox" }), "The way is clear: I have looked, the tubes can be retracted and turned without touching anything.");
  if (await confirm("Home every stage?", "Home", make("p", {}, "The translation is retracted first, then one axis after the other looks for its home sensor. STOP works all the time."), toWork, sure))
    await press("POST", "/api/home", { way_is_clear: true });
}

export async function reset() {
  if (await press("POST", "/api/reset", {})) alarm("");
}

/** By the station's own word for what is next. */
const ACTS = {
  connect: ["Connect", () => press("POST", "/api/connect", {})],
  home: ["Home…", home],
  reset: ["Reset", reset],
  start: ["Choose a motion", () => open("start")],
  calibrate: ["Calibrate", () => open("calibrate")],
};

/** The button for what `status` asks a person to do; null where it asks for nothing. */
export function actButton(status) {
  if (!(status.act in ACTS)) return null;
  const [label, act] = ACTS[status.act];
  const button = make("button", { type: "button", className: "main", disabled: !mayCommand(status) && !["start", "calibrate"].includes(status.act) }, label);
  button.addEventListener("click", act);
  return button;
}

/** Tell in `place` why nothing can be begun now, with the button that changes it; nothing while the station is `ready`. */
export function tellWhy(place, status, ready = status.act === "start") {
  const may = mayCommand(status);
  const why = status.operator.role === "viewer" ? "viewers cannot start anything" : !may ? `'${status.operator.name}' is operator`
    : ready ? "" : status.state === "READY" ? status.says : `not while ${status.state}; ${status.next || "wait for the end or press STOP"}`;
  const shown = JSON.stringify([why, status.act, may]);
  if (place.dataset.shown === shown) return; // a button must not vanish under the pointer
  place.dataset.shown = shown;
  const button = why === "" || !may ? null : actButton(status);
  place.replaceChildren(why, ...(button === null ? [] : [" ", button]));
}

onRefusal((status) => (status.operator.role === "viewer" || status.act === "start" ? null : mayCommand(status) ? actButton(status) : takeOver()));
