// The header without STOP: the next action, the operator, state and message, run, devices, loop timing.
import { $, button, clock, confirm, latest, make, mayCommand, name, note, onRefusal, onStatus, replaceChanged, request, sendCommand } from "./station.js";
import { poseText } from "./form.js";
import { alarm } from "./stop.js";
import { isOpen, openTab } from "./tabs.js";

const DEVICE_NAMES = { stages: "stages", tracker: "tracker", sensors: "force sensors" };
const LATCHED = ["HOLD", "STOPPED", "FAULT"];

// ---- the next action that the station suggests

export async function home() {
  const rig = await request("GET", "/api/rig");
  const workingPose = rig.working_pose === null ? null
    : make("p", {}, `Then the robot goes to its working pose: ${poseText(rig.joints, rig.working_pose)}.`);
  const clear = make("label", {}, make("input", { type: "checkbox" }), "The path is clear: I have checked that the tubes can be retracted and turned without touching anything.");
  if (await confirm("Home every stage?", "Home", make("p", {}, "The translation is retracted first. Then the axes search for their home sensors, one after the other. STOP works at any time."), workingPose, clear))
    await sendCommand("POST", "/api/home", { way_is_clear: true });
}

async function reset() {
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
  const disabled = !mayCommand(status) && !["start", "calibrate"].includes(action);
  return button(...ACTIONS[action], { className: action === status.action ? "main" : "", disabled });
}

/**
 * Show in `element` why no motion can start now, and a button for the next action. `element` is empty while a motion can
 * start.
 */
export function showReason(element, status, ready = status.action === "start") {
  const may = mayCommand(status);
  const reason = status.operator.role === "viewer" ? "viewers cannot start anything" : !may ? `'${status.operator.name}' is operator`
    : ready ? "" : status.state === "READY" ? status.message : `not while ${status.state}; ${status.next || "wait for the end or press STOP"}`;
  replaceChanged(element, [reason, status.action, may], () => (reason === "" || !may ? [reason] : [reason, " ", actionButton(status)]));
}
$("reset").addEventListener("click", reset);

/** Show the button of the next action. Reset has a separate button; while the tab Run is open, Home replaces it. */
function showAction(status) {
  const action = status.action === "reset" ? "" : status.action === "start" && isOpen("start") ? "home" : status.action;
  replaceChanged($("act"), [action, action === status.action, mayCommand(status)], () => [actionButton(status, action)]);
}

// ---- the operator: take and release control, and report its loss

let mine = false, leaving = false; // whether this page is operator; whether this page is releasing control on purpose

async function changeOperator() {
  const { you, name: current } = latest().operator;
  if (you) {
    leaving = true;
    return sendCommand("DELETE", "/api/operator");
  }
  const field = make("input", { type: "text", maxLength: 40, value: name.get(), "aria-label": "your name", required: true });
  const text = current === null ? "All users will see this name." : `'${current}' is operator now, and will only be able to view and to STOP.`;
  const title = current === null ? "Take control" : "Take over";
  if (!await confirm(title, title, make("p", {}, text), make("label", {}, "Your name", field))) return null;
  name.set(field.value.trim());
  return sendCommand("POST", "/api/operator", { name: field.value.trim() || null, take_over: current !== null });
}
$("operator-act").addEventListener("click", changeOperator);

/** Return a button that takes control from the current operator. */
const takeOver = () => button("Take over…", changeOperator);

function reportLoss(operator) {
  if (mine && !operator.you && !leaving) {
    if (operator.name === null) note("You are no longer operator: the station has received nothing from this page for too long. Your next command makes you operator again.");
    else note(`'${operator.name}' has taken control: you may view and STOP.`, false, takeOver(), (now) => now.operator.name === operator.name);
  }
  if (!operator.you) leaving = false;
  mine = operator.you;
}

onRefusal((status) => (status.operator.role === "viewer" || status.action === "start" ? null : mayCommand(status) ? actionButton(status) : takeOver()));

onStatus((status) => {
  if (status === null) return;
  const { operator } = status, act = $("operator-act");
  $("operator-name").textContent = operator.you ? "You are operator" : operator.name === null ? "No operator" : `Operator: ${operator.name}`;
  $("operator-name").title = operator.name ?? "the first command makes its sender operator";
  act.hidden = operator.role !== "operator";
  act.textContent = operator.you ? "Release" : operator.name === null ? "Take control" : "Take over…";
  if (operator.role === "viewer") $("operator-name").textContent += " · you may view and STOP";
  reportLoss(operator);
});

// ---- state, run, devices, loop timing

function showRun(status) {
  const run = status.run, on = run !== null && status.state === "RUNNING";
  $("run-title").textContent = run === null ? status.lab : on ? run.title : `last run: ${run.title}`;
  $("run-title").title = run === null ? "" : `run ${run.id}`;
  $("run-progress").hidden = !on;
  $("run-left").textContent = !on ? "" : run.phase === "moving"
    ? `${clock(run.duration * (1 - run.progress))} left of ${clock(run.duration)}` : run.phase === "none" ? "" : status.message;
  if (on) $("run-progress").value = run.progress;
}

function showLights(devices, stale) {
  replaceChanged($("lights"), [devices, stale], () => Object.entries(devices).map(([key, device]) => {
    const severity = stale ? -1 : device.condition === "connected" ? device.severity : Math.max(device.severity, 1);
    const text = stale ? "no current data" : device.text || (severity === 0 ? "connected, nothing is wrong" : device.condition);
    const dot = make("i", { className: "light", "data-severity": severity });
    const item = make("li", { title: `${DEVICE_NAMES[key] ?? key}: ${text}`, tabIndex: 0 }, dot, DEVICE_NAMES[key] ?? key);
    item.setAttribute("aria-label", item.title);
    return item;
  }));
}

/** Show the number of warnings, which do not stop the robot. The tab Faults shows their texts. */
function showWarnings(status) {
  const count = status.warnings.length, contact = status.contact !== null;
  $("mind").hidden = count === 0;
  $("mind").textContent = `▲ ${contact ? "load not at the tip" : count === 1 ? "1 warning" : `${count} warnings`}`;
  $("mind").title = status.warnings.join("\n");
}
$("mind").addEventListener("click", () => openTab("faults"));

onStatus((status, stale) => {
  const state = status === null ? "NO ANSWER" : status.state;
  $("state").textContent = stale && status !== null && state !== "FAULT" ? `${state} (stale)` : state;
  $("state").dataset.state = state;
  if (status === null) {
    $("says").textContent = "the station does not answer: it has ended, or its computer or the network is too busy";
    $("next").textContent = "to stop now, press the emergency stop of the rig; if the computer is overloaded, close other pages and programs on it";
    return;
  }
  $("says").textContent = $("says").title = status.message;
  $("next").textContent = $("next").title = status.next;
  document.body.classList.toggle("latched", LATCHED.includes(state));
  showAction(status);
  $("reset").hidden = !LATCHED.includes(state);
  $("reset").disabled = !mayCommand(status);
  showRun(status);
  showLights(status.devices, stale);
  showWarnings(status);
  const { late_us: late, tick_us: work, missed, ticks, scheduler } = status.loop;
  $("loop").textContent = `loop 500 Hz\nlate p99 ${late.p99.toFixed(0)} µs\nmissed ${missed}`;
  $("loop").title = `${ticks} ticks, ${missed} periods missed, ${scheduler}; late p50 ${late.p50} µs, p99.9 ${late.p99_9} µs, max ${late.max} µs;`
    + ` work p50 ${work.p50} µs, p99 ${work.p99} µs`;
});
