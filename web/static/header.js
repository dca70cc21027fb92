// The header beside STOP and operator: the state in words, what is next, the run, the devices, the loop.
import { $, make, mayCommand, onStatus } from "./station.js";
import { actButton, reset } from "./acts.js";
import { isOpen, open } from "./tabs.js";

const NAMES = { stages: "stages", tracker: "tracker", sensors: "force sensors" };
const LATCHED = ["HOLD", "STOPPED", "FAULT"];

$("reset").addEventListener("click", reset);

/** The button for what is next, beside the words; Reset has its own place. */
function showAct(status) {
  const there = status.act === "reset" || (status.act === "start" && isOpen("start"));
  const shown = JSON.stringify([!there && status.act, mayCommand(status)]);
  if ($("act").dataset.shown === shown) return; // a button must not vanish under the pointer
  $("act").dataset.shown = shown;
  const button = there ? null : actButton(status);
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
    ? `${minutes(run.duration * (1 - run.progress))} left of ${minutes(run.duration)}` : run.phase === "none" ? "" : status.says;
  if (on) $("run-progress").value = run.progress;
}

function showLights(devices, stale) {
  $("lights").replaceChildren(...Object.entries(devices).map(([key, device]) => {
    const severity = stale ? -1 : device.condition === "connected" ? device.severity : Math.max(device.severity, 1);
    const words = stale ? "no fresh word from it" : device.text || (severity === 0 ? "answers, nothing is wrong" : device.condition);
    const dot = make("i", { className: "light", "data-severity": severity });
    const item = make("li", { title: `${NAMES[key] ?? key}: ${words}`, tabIndex: 0 }, dot, NAMES[key] ?? key);
    item.setAttribute("aria-label", item.title);
    return item;
  }));
}

/** What a person should know and nothing is stopped by: counted here, spelt out in the tab Faults. */
function showMind(status) {
  const count = status.warnings.length, touched = status.touch !== null;
  $("mind").hidden = count === 0;
  $("mind").textContent = `▲ ${touched ? "load not at the tip" : count === 1 ? "1 warning" : `${count} warnings`}`;
  $("mind").title = status.warnings.join("\n");
}
$("mind").addEventListener("click", () => open("faults"));

let lights = "";
onStatus((status, stale) => {
  const state = status === null ? "NO ANSWER" : status.state;
  $("state").textContent = stale && status !== null && state !== "FAULT" ? `${state} (stale)` : state;
  $("state").dataset.state = state;
  if (status === null) {
    $("says").textContent = "the station does not answer";
    $("next").textContent = "use the emergency stop of the bench";
    return;
  }
  $("says").textContent = $("says").title = status.says;
  $("next").textContent = $("next").title = status.next;
  document.body.classList.toggle("latched", LATCHED.includes(state));
  showAct(status);
  $("reset").hidden = !LATCHED.includes(state);
  $("reset").disabled = !mayCommand(status);
  showRun(status);
  const shown = JSON.stringify([status.devices, stale]);
  if (shown !== lights) showLights(status.devices, stale); // a tooltip must not vanish under the pointer
  lights = shown;
  showMind(status);
  const { late_us: late, tick_us: work, missed, ticks, scheduler } = status.loop;
  $("loop").textContent = `loop 500 Hz\nlate p99 ${late.p99.toFixed(0)} µs\nmissed ${missed}`;
  $("loop").title = `${ticks} ticks, ${missed} periods missed, ${scheduler}; late p50 ${late.p50} µs, p99.9 ${late.p99_9} µs, max ${late.max} µs;`
    + ` work p50 ${work.p50} µs, p99 ${work.p99} µs`;
});
