// The header without STOP and operator: state and message, next action, run, devices, loop timing.
import { $, make, mayCommand, onStatus } from "./station.js";
import { actionButton, reset } from "./next_action.js";
import { isOpen, openTab } from "./tabs.js";

const DEVICE_NAMES = { stages: "stages", tracker: "tracker", sensors: "force sensors" };
const LATCHED = ["HOLD", "STOPPED", "FAULT"];

$("reset").addEventListener("click", reset);

/** Show the button of the next action. Reset has a separate button; while the tab Run is open, Home replaces it. */
function showAction(status) {
  const action = status.action === "reset" ? "" : status.action === "start" && isOpen("start") ? "home" : status.action;
  const shown = JSON.stringify([action, action === status.action, mayCommand(status)]);
  if ($("act").dataset.shown === shown) return; // replacing an unchanged button would interrupt a click on it
  $("act").dataset.shown = shown;
  const button = actionButton(status, action);
  $("act").replaceChildren(...(button === null ? [] : [button]));
}

function minutes(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

function showRun(status) {
  const run = status.run, on = run !== null && status.state === "RUNNING";
  $("run-title").textContent = run === null ? status.lab : on ? run.title : `last run: ${run.title}`;
  $("run-title").title = run === null ? "" : `run ${run.id}`;
  $("run-progress").hidden = !on;
  $("run-left").textContent = !on ? "" : run.phase === "moving"
    ? `${minutes(run.duration * (1 - run.progress))} left of ${minutes(run.duration)}` : run.phase === "none" ? "" : status.message;
  if (on) $("run-progress").value = run.progress;
}

function showLights(devices, stale) {
  $("lights").replaceChildren(...Object.entries(devices).map(([key, device]) => {
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

let lights = "";
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
  const shown = JSON.stringify([status.devices, stale]);
  if (shown !== lights) showLights(status.devices, stale); // replacing unchanged lights would close an open tooltip
  lights = shown;
  showWarnings(status);
  const { late_us: late, tick_us: work, missed, ticks, scheduler } = status.loop;
  $("loop").textContent = `loop 500 Hz\nlate p99 ${late.p99.toFixed(0)} µs\nmissed ${missed}`;
  $("loop").title = `${ticks} ticks, ${missed} periods missed, ${scheduler}; late p50 ${late.p50} µs, p99.9 ${late.p99_9} µs, max ${late.max} µs;`
    + ` work p50 ${work.p50} µs, p99 ${work.p99} µs`;
});
