// Jog: the robot moves only while a button is held. Each command expires after 0.3 s, so the robot also stops when the page is lost.
import { $, request, make, mayCommand, note, onStatus, Refused } from "./station.js";
import { showReason } from "./next_action.js";
import { onTab } from "./tabs.js";
import { tidy, unit } from "./form.js";

const REPEAT_MS = 100; // interval between two jog commands [ms]
let active = null;

/** Return whether a jog may start or continue. */
export const mayJog = (status, stale) => status !== null && !stale && mayCommand(status)
  && (status.state === "READY" || status.phase === "jogging");

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

/** Jog while `button` is held; `velocity()` returns the velocity in SI. The check of the axes' signs also calls this. */
export function jogWhileHeld(button, space, velocity, ended = () => {}) {
  const startJog = (event) => {
    if (active !== null || button.disabled) return;
    event.preventDefault();
    if (event.pointerId !== undefined) button.setPointerCapture(event.pointerId);
    startJogging(button, space, velocity, ended);
  };
  button.addEventListener("pointerdown", (event) => { if (event.button === 0) startJog(event); });
  for (const type of ["pointerup", "pointercancel", "lostpointercapture", "blur", "contextmenu"]) button.addEventListener(type, release);
  // A captured pointer sends no leave event, so its position is compared with the button's.
  button.addEventListener("pointermove", (event) => {
    if (!isHeld(button)) return;
    const box = button.getBoundingClientRect();
    if (event.clientX < box.left || event.clientX > box.right || event.clientY < box.top || event.clientY > box.bottom) release();
  });
  button.addEventListener("keydown", (event) => {
    if ((event.code === "Space" || event.code === "Enter") && !event.shiftKey && !event.repeat) startJog(event);
  });
  button.addEventListener("keyup", (event) => { event.preventDefault(); release(); });
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

const SIGNS = [[-1, "−"], [1, "+"]];
const buttons = [];

function axisRow(label, count, index, space, value, shown) {
  const pair = SIGNS.map(([sign, text]) => {
    const button = make("button", { type: "button", className: "hold", "aria-label": `${label} ${text === "+" ? "plus" : "minus"}: hold to move` }, text);
    const velocity = () => Array.from({ length: count }, (_, i) => (i === index ? sign * value() : 0));
    jogWhileHeld(button, space, velocity);
    buttons.push(button);
    return button;
  });
  const current = make("span", { className: "dim live" });
  onStatus((status) => { if (status !== null && !$("jog").hidden) current.textContent = shown(status); });
  return [make("div", {}, make("div", {}, label.replaceAll("_", " ")), current), ...pair];
}

const jointText = (joint, status) => {
  const [shown, scale] = unit(joint.unit), value = status.joints[joint.name];
  return value === undefined ? "" : status.tip_estimated === null ? "unknown" : `${(value * scale).toFixed(2)} ${shown} (${tidy(Math.round(joint.lower * scale))} … ${tidy(Math.round(joint.upper * scale))})`;
};

const rig = await request("GET", "/api/rig");
const turning = speed("turn at", "rad/s", Math.min(...rig.joints.filter((one) => one.motion === "rotation").map((one) => one.speed)), 0.26);
const sliding = speed("slide at", "m/s", Math.min(...rig.joints.filter((one) => one.motion === "translation").map((one) => one.speed)), 0.26);
const tip = speed("tip at", "m/s", rig.tip_speed, 0.3);
const turnRate = rig.turn_speed === null ? null : speed("turn at", "rad/s", rig.turn_speed, 0.3);
const directionFields = turnRate === null ? [] : [make("fieldset", {}, make("legend", {}, "Direction of the tip"),
  make("p", { className: "small dim" }, "about an axis of the world frame; the tip keeps its position"),
  make("div", { className: "rows" }, ...turnRate.elements),
  make("div", { className: "jog", style: "margin-top:10px" }, ...["x", "y", "z"].flatMap((name, i) => axisRow(`turn about ${name}`, 3, i, "direction", turnRate.value, () => ""))))];
const reason = make("p", { className: "small" });
$("jog").append(
  make("p", {}, "The robot moves while a button is held, with the pointer or Space."), reason,
  make("fieldset", {}, make("legend", {}, "Joints"),
    make("div", { className: "rows" }, ...turning.elements, ...sliding.elements),
    make("div", { className: "jog", style: "margin-top:10px" }, ...rig.joints.flatMap((joint, i) =>
      axisRow(joint.name, rig.joints.length, i, "joints", joint.motion === "rotation" ? turning.value : sliding.value, (status) => jointText(joint, status))))),
  make("fieldset", {}, make("legend", {}, "Tip, world frame"),
    make("p", { className: "small dim" }, "x points down, along gravity; z points along the tubes when they are straight"),
    make("div", { className: "rows" }, ...tip.elements),
    make("div", { className: "jog", style: "margin-top:10px" }, ...["x", "y", "z"].flatMap((name, i) =>
      axisRow(name, 3, i, "tip", tip.value, (status) => (status.tip_measured === null ? "not measured now" : `${(1e3 * status.tip_measured[i]).toFixed(2)} mm`))))),
  ...directionFields,
  make("div", { id: "hands" }),
);
onStatus((status, stale) => {
  const ready = mayJog(status, stale);
  if (!ready) release();
  for (const button of buttons) button.disabled = !ready;
  if (status !== null) showReason(reason, status, ready);
});
onTab("jog", (open) => { if (!open) release(); });
