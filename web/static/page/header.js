// The header without STOP: the next action, the operator, state and message, silence, run, devices, loop timing.
import { $, blockReason, button, clock, confirm, dataAge, enable, isSilent, latest, make, mayCommand, name, note, onRefusal, onStatus, replaceChanged, rigAnswer, sendCommand, setText, silentReason } from "./station.js";
import { poseText } from "./form.js";
import { small } from "./layout.js";
import { isOpen, openTab } from "./tabs.js";

const DEVICE_NAMES = { stages: "stages", tracker: "tracker", sensors: "force sensors" };
/** Meaning of the states that last until a reset. */
const LATCHED = {
  HOLD: "HOLD: a fault or a limit has ended the motion. The robot keeps its position, and the motors are on. Reset makes the station ready for the next motion.",
  STOPPED: "STOPPED: an operator or viewer has pressed STOP. No axis moves. Reset makes the station ready for the next motion; nothing continues by itself.",
  FAULT: "FAULT: a device or a program has failed, and every axis was stopped. Remove the cause first, then press Reset.",
};

// ---- the next action that the station suggests

export async function home() {
  const rig = await rigAnswer();
  const workingPose = rig.working_pose === null ? null
    : make("p", {}, `Then the robot goes to its working pose: ${poseText(rig.joints, rig.working_pose)}.`);
  const clear = make("label", {}, make("input", { type: "checkbox" }), "The path is clear: I have checked that the tubes can be retracted and turned without touching anything.");
  if (await confirm("Home every stage?", "Home", make("p", {}, "First the tubes are retracted. Then the axes search for their home sensors, one after the other. STOP works at any time."), workingPose, clear))
    await sendCommand("POST", "/api/home", { way_is_clear: true });
}

async function reset() {
  if (await sendCommand("POST", "/api/reset", {})) window.STOP.alarm("");
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
  return enable(button(...ACTIONS[action], { className: action === status.action ? "main" : "" }), ["start", "calibrate"].includes(action) ? "" : blockReason(status));
}

/**
 * Show in `element` why no motion can start now, and a button for the next action. `element` is empty while a motion can
 * start.
 */
export function showReason(element, status, ready = status.action === "start") {
  const may = mayCommand(status);
  const reason = blockReason(status) || (ready ? "" : status.state === "READY" ? status.message : `not while ${status.state}: ${status.next || "wait for the end or press STOP"}`);
  replaceChanged(element, [reason, status.action, may], () => (reason === "" || !may ? [reason] : [reason, " ", actionButton(status)]));
}
$("reset").addEventListener("click", reset);

/**
 * Show the button of the next action. Reset has a separate button. While the tab Run is open, Home replaces the button
 * "Choose a motion". While the tab Jog is open, that button is not the main one.
 */
function showAction(status) {
  const action = status.action === "reset" ? "" : status.action === "start" && isOpen("start") ? "home" : status.action;
  const silent = isSilent(), second = action === "start" && isOpen("jog");
  replaceChanged($("act"), [action, action === status.action, mayCommand(status), silent, second], () => {
    const control = actionButton(status, action);
    if (second) control.className = "";
    if (silent && control !== null) enable(control, blockReason(status, true));
    return [control];
  });
}

// ---- the operator: take and release control, and report its loss

let mine = false, leaving = false; // whether this page is operator; whether this page is releasing control on purpose

/** Release control if this page is operator; otherwise ask, then take control. */
export async function changeOperator() {
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
  $("operator").dataset.holder = operator.you ? "you" : operator.name === null ? "none" : "other"; // a phone shows only the name of another operator
  $("operator-name").title = operator.name ?? "the first command makes its sender operator";
  act.hidden = operator.role !== "operator";
  act.textContent = operator.you ? "Release" : operator.name === null ? "Take control" : "Take over…";
  if (operator.role === "viewer") $("operator-name").textContent += " · you may view and STOP";
  reportLoss(operator);
});

// ---- state, run, devices, loop timing

const AT_REST = ["READY", "HOLD", "STOPPED", "FAULT"];

function showRun(status) {
  const run = status.run, on = run !== null && status.state === "RUNNING" && status.phase !== "jogging"; // a jog is no run
  // The last run is not shown during a motion that is no run, for example homing.
  $("run-title").textContent = run === null ? "" : on ? run.title : AT_REST.includes(status.state) ? `last run: ${run.title}` : "";
  $("run-title").title = run === null ? "" : `run ${run.id}`;
  $("run-progress").hidden = !on;
  $("run-left").textContent = !on ? "" : run.phase === "moving"
    ? `${clock(run.duration * (1 - run.progress))} left of ${clock(run.duration)}` : ""; // the message describes the other phases
  if (on) $("run-progress").value = run.progress;
}

/** Merge all cameras into one indicator, which shows the worst state, because the header of a phone is narrow. */
function mergedCameras(devices) {
  const entries = Object.entries(devices), cameras = entries.filter(([key]) => key.startsWith("camera "));
  if (cameras.length < 2) return entries;
  const problems = cameras.filter(([, camera]) => camera.text !== "").map(([key, camera]) => `${key}: ${camera.text}`);
  const worst = cameras.map(([, camera]) => camera).sort((a, b) => b.severity - a.severity)[0];
  return [...entries.filter(([key]) => !key.startsWith("camera ")), ["cameras", { ...worst, text: problems.join("; ") }]];
}

function showLights(devices) {
  const silent = isSilent();
  replaceChanged($("lights"), [devices, silent], () => mergedCameras(devices).map(([key, device]) => {
    const severity = silent ? -1 : device.condition === "connected" ? device.severity : Math.max(device.severity, 1);
    const text = silent ? "no current data" : device.text || (severity === 0 ? "connected, nothing is wrong" : device.condition);
    const dot = make("i", { className: "light", "data-severity": severity });
    const label = DEVICE_NAMES[key] ?? key;
    return make("li", { title: `${label}: ${text}` }, dot, label, make("span", { className: "unseen" }, `: ${text}`));
  }));
}

/** Show the number of warnings, which do not stop the robot. The tab Faults shows their texts. */
function showWarnings(status) {
  const count = status.warnings.length, contact = status.contact !== null;
  $("mind").hidden = count === 0;
  replaceChanged($("mind"), [count, contact], () => [`▲ ${contact ? "" : count}`, make("span", {}, contact ? "load not at the tip" : count === 1 ? " warning" : " warnings")]);
  $("mind").title = status.warnings.join("\n");
}
$("mind").addEventListener("click", () => openTab("faults"));

// ---- silence: after one second without data a chip with their age, a banner, and no colours of live values

let simulated = false; // whether the last status was one of simulated devices
let known = null; // last status of a station that answers

/** Show or hide the age of the data and the banner. State, values and buttons change at the same moment: see publish(). */
function showSilence() {
  const age = dataAge(), text = `no data for ${age.toFixed(age < 10 ? 1 : 0)} s`, lost = latest() === null;
  $("age").hidden = $("silence").hidden = !isSilent();
  if (!isSilent()) return;
  setText($("age"), text);
  $("silence").dataset.lost = lost;
  const emergency = simulated ? "" : " To stop the robot now, press the emergency stop of the rig.";
  setText($("silence"), lost
    ? `The station does not answer: ${text}. It has ended, or its computer or the network is too busy.${emergency} The page tries again.`
    : `${text[0].toUpperCase()}${text.slice(1)}; trying again. Nothing on this page is live.`);
}
setInterval(showSilence, 100);

/** Show what depends on current data: the next action, the indicators of the devices, the loop's timing and buttons. */
function showUsable(status) {
  showAction(status);
  showLights(status.devices);
  enable($("reset"), blockReason(status, isSilent()));
  enable($("operator-act"), silentReason());
  setText($("loop"), `500 Hz, ${isSilent() ? "–" : status.loop.missed} missed`);
}

// ---- the state and its message; a latched state has a separate bar, so that its message is shown completely

const meaning = make("details", {}, make("summary", {}, "What does this mean?"), make("p"), make("p", { className: "dim" }));
$("latched").append(meaning);

function showLatched(state, details) {
  const latched = state in LATCHED;
  document.body.classList.toggle("latched", latched);
  $("latched").hidden = !latched;
  $("latched").dataset.state = state;
  const box = $(latched ? "latched" : "state-box");
  if ($("message").parentElement !== box) box.insertBefore($("message"), latched ? meaning : null);
  if (latched) setText(meaning.children[1], `${LATCHED[state]}${simulated ? " At the end of a motion the lab removes its load, so the tip springs back." : ""}`);
  setText(meaning.lastChild, details); // address, device and raw values, which the message omits
}

/** Next step of a user who is not operator, in a state that lasts until a reset. */
const whoResets = ({ name, role }) => (role === "viewer" ? "An operator can reset the station." : `Only operator '${name}' can reset the station. Take over to reset it yourself.`);

/** Next step while a motion can start; it names a visible control. On a small screen the list is below the header. */
function startHint() {
  const submit = $("start").querySelector("[type=submit]");
  if (!isOpen("start")) return small.matches ? "" : "choose an experiment in the tab Run"; // the button 'Choose a motion' is visible
  if (submit === null) return small.matches ? "choose an experiment below" : "choose an experiment on the right";
  return submit.disabled ? "" : `press ${submit.textContent}`;
}

onStatus((status) => {
  if (status === null && known === null && !isSilent()) return; // the page has just been opened
  const state = status === null ? "NO ANSWER" : status.state;
  known = status ?? known;
  setText($("state"), state);
  $("state").dataset.state = state;
  showSilence();
  if (known !== null) showUsable(known);
  showLatched(state, status?.details ?? "");
  if (status === null) {
    setText($("says"), small.matches ? "" : "the values on the page are old");
    setText($("next"), "start the station, or wait for its answer");
    return;
  }
  simulated = status.simulated;
  $("badge").hidden = false;
  setText($("badge"), simulated ? "SIMULATED" : "REAL BENCH");
  $("badge").dataset.simulated = simulated;
  $("badge").title = status.lab;
  const next = state in LATCHED && !mayCommand(status) ? whoResets(status.operator) : status.action === "start" ? startHint() : status.next;
  setText($("says"), status.action === "start" && next !== "" && small.matches ? "" : status.message); // a small screen has room for the next step only
  setText($("next"), next);
  if (!(state in LATCHED)) $("message").title = [status.message, next].filter((text) => text !== "").join(": ");
  $("reset").hidden = !(state in LATCHED);
  showRun(status);
  showWarnings(status);
  const { late_us: late, tick_us: work, missed, ticks, scheduler } = status.loop;
  $("loop").title = `Control loop: it should run 500 times a second. A period is missed if this computer was too busy; single missed periods do no harm.\n${ticks} ticks, ${missed} periods missed, ${scheduler}; late p50 ${late.p50} µs, p99 ${late.p99.toFixed(0)} µs,`
    + ` p99.9 ${late.p99_9} µs, max ${late.max} µs; work p50 ${work.p50} µs, p99 ${work.p99} µs`;
});

// The run continues without this page, but has no operator then, so the browser asks before it leaves the page.
window.addEventListener("beforeunload", (event) => {
  if (latest()?.state === "RUNNING" && latest().operator.you) event.preventDefault();
});
