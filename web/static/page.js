// The page's header: state at a glance, STOP and Reset over REST, outside the scene.
"use strict";
const $ = (id) => document.getElementById(id);
const NAMES = { stages: "stages", tracker: "tracker", force_sensors: "force sensors" };
const PERIOD = 200, PATIENCE = 450; // ms

async function ask(path) {
  try {
    const answer = await fetch(path, { method: "POST", headers: { "content-type": "application/json" } });
    if (!answer.ok) show_refusal((await answer.json()).error);
  } catch (error) {
    show_refusal(`the station does not answer (${error.message}); use the emergency stop of the bench`);
  }
  look();
}

function show_refusal(text) {
  $("cause").textContent = text;
}

function minutes(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}

function show(status) {
  const stale = status === null || status.stale;
  const state = status === null ? "NO ANSWER" : status.state;
  document.body.classList.toggle("stale", stale);
  $("state").textContent = state;
  $("state").dataset.state = state;
  if (status === null) {
    $("cause").textContent = "the station does not answer; use the emergency stop of the bench";
    return;
  }
  $("cause").textContent = status.cause;
  $("cause").title = status.cause;
  $("reset").hidden = !["HOLD", "STOPPED", "FAULT"].includes(state);
  const run = status.run;
  const on = run !== null && state === "RUNNING";
  $("run-title").textContent = run === null ? status.lab : run.title;
  $("run-progress").hidden = !on;
  $("run-left").textContent = on
    ? (run.phase === "moving" ? `${minutes(run.duration * (1 - run.progress))} left` : `${run.phase} …`) : "";
  if (on) $("run-progress").value = run.progress;
  $("lights").replaceChildren(...Object.entries(status.devices).map(([name, device]) => {
    const light = document.createElement("span"), dot = document.createElement("i");
    if (!device.ok) dot.className = "bad";
    light.title = device.text;
    light.append(dot, NAMES[name] ?? name);
    return light;
  }));
  const loop = status.loop;
  $("loop").textContent = `500 Hz loop  late p99 ${loop.late_us.p99.toFixed(0)} µs\nmissed ${loop.missed}  ${loop.scheduler}`;
  $("loop").title = `${loop.ticks} ticks; late p50 ${loop.late_us.p50} µs, p99.9 ${loop.late_us.p99_9} µs, max ${loop.late_us.max} µs;`
    + ` work p50 ${loop.tick_us.p50} µs, p99 ${loop.tick_us.p99} µs`;
}

let looking = false;
async function look() {
  if (looking) return;
  looking = true;
  try {
    const answer = await fetch("/api/status", { signal: AbortSignal.timeout(PATIENCE), cache: "no-store" });
    show(answer.ok ? await answer.json() : null);
  } catch {
    show(null);
  }
  looking = false;
}

const stop = () => ask("/api/stop");
$("stop").addEventListener("click", stop);
$("reset").addEventListener("click", () => ask("/api/reset"));

const hot = (event) => {
  if (event.code === "Space" && event.shiftKey) {
    event.preventDefault();
    stop();
  }
};
document.addEventListener("keydown", hot, true);
// The scene is same-origin: the key works with the focus in there, too.
$("scene").addEventListener("load", () => $("scene").contentWindow.addEventListener("keydown", hot, true));

setInterval(look, PERIOD);
look();
