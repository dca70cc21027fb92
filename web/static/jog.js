// Jog: the robot moves only while a button is held. Each word lasts 0.3 s; losing the page ends it.
import { $, ask, make, mayCommand, note, onStatus, Refused } from "./station.js";
import { tellWhy } from "./acts.js";
import { onTab } from "./tabs.js";
import { tidy, unit } from "./form.js";

const AGAIN = 100; // ms
let held = null;

/** Whether a jog may begin or go on. */
export const mayJog = (status, stale) => status !== null && !stale && mayCommand(status)
  && (status.state === "READY" || status.phase === "jogging");

/** Jog from now until `release`, with `shown` marked as held; `velocity()` is SI. Nothing begins while another one is held. */
export function hold(shown, space, velocity, ended = () => {}) {
  if (held !== null) return;
  const mine = held = { shown, space, on: true, still: velocity().map(() => 0), ended };
  shown.classList.add("held");
  repeat(mine, velocity);
}
export const isHeld = (shown) => held?.shown === shown;

/** Jog while `button` is held; `velocity()` is SI. Used by the axis check, too. */
export function holdable(button, space, velocity, ended = () => {}) {
  const begin = (event) => {
    if (held !== null || button.disabled) return;
    event.preventDefault();
    if (event.pointerId !== undefined) button.setPointerCapture(event.pointerId);
    hold(button, space, velocity, ended);
  };
  button.addEventListener("pointerdown", (event) => { if (event.button === 0) begin(event); });
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture", "blur", "contextmenu"]) button.addEventListener(kind, release);
  // Captured pointers do not leave: whether it is still over the button has to be looked at.
  button.addEventListener("pointermove", (event) => {
    if (!isHeld(button)) return;
    const box = button.getBoundingClientRect();
    if (event.clientX < box.left || event.clientX > box.right || event.clientY < box.top || event.clientY > box.bottom) release();
  });
  button.addEventListener("keydown", (event) => {
    if ((event.code === "Space" || event.code === "Enter") && !event.shiftKey && !event.repeat) begin(event);
  });
  button.addEventListener("keyup", (event) => { event.preventDefault(); release(); });
}

async function repeat(mine, velocity) {
  try {
    while (mine.on) {
      const sent = performance.now();
      await ask("POST", "/api/jog", { space: mine.space, velocity: velocity() }, 1000);
      await new Promise((resolve) => setTimeout(resolve, Math.max(0, AGAIN - (performance.now() - sent))));
    }
    // After the last answer, so that nothing overtakes it.
    await ask("POST", "/api/jog", { space: mine.space, velocity: mine.still }, 1000);
  } catch (error) {
    release();
    note(error instanceof Refused ? error.message : `jog: the station does not answer (${error.message}); it stops by itself`);
  }
  mine.ended();
}

export function release() {
  if (held === null) return;
  held.on = false;
  held.shown.classList.remove("held");
  held = null;
}
window.addEventListener("blur", release);
window.addEventListener("pagehide", release);
document.addEventListener("visibilitychange", () => { if (document.hidden) release(); });
document.addEventListener("keydown", (event) => { if (event.key === "Escape") release(); });

/** A slider up to `most` [si]: {elements, value() in SI}. */
export function speed(label, si, most, first) {
  const [shown, scale] = unit(si), said = make("output");
  const slider = make("input", { type: "range", min: 0.02, max: 1, step: 0.02, value: first, "aria-label": label });
  const value = () => Number(slider.value) * most;
  const show = () => { said.textContent = `${tidy(Number((value() * scale).toPrecision(2)))} ${shown}`; };
  slider.addEventListener("input", show);
  show();
  return { elements: [make("label", {}, label), slider, said], value };
}

const SIGNS = [[-1, "−"], [1, "+"]];
const buttons = [];

function axis(label, count, place, space, value, shown) {
  const pair = SIGNS.map(([sign, text]) => {
    const button = make("button", { type: "button", className: "hold", "aria-label": `${label} ${text === "+" ? "plus" : "minus"}: hold to move` }, text);
    const velocity = () => Array.from({ length: count }, (_, i) => (i === place ? sign * value() : 0));
    holdable(button, space, velocity);
    buttons.push(button);
    return button;
  });
  const now = make("span", { className: "dim live" });
  onStatus((status) => { if (status !== null && !$("jog").hidden) now.textContent = shown(status); });
  return [make("div", {}, make("div", {}, label.replaceAll("_", " ")), now), ...pair];
}

const degrees = (joint, status) => {
  const [shown, scale] = unit(joint.unit), value = status.joints[joint.name];
  return value === undefined ? "" : status.tip_estimated === null ? "not known now" : `${(value * scale).toFixed(2)} ${shown} (${tidy(Math.round(joint.lower * scale))} … ${tidy(Math.round(joint.upper * scale))})`;
};

const bench = await ask("GET", "/api/bench");
const turning = speed("turn at", "rad/s", Math.min(...bench.joints.filter((one) => one.motion === "rotation").map((one) => one.speed)), 0.26);
const sliding = speed("slide at", "m/s", Math.min(...bench.joints.filter((one) => one.motion === "translation").map((one) => one.speed)), 0.26);
const tip = speed("tip at", "m/s", bench.tip_speed, 0.3);
const swinging = bench.turn_speed === null ? null : speed("turn at", "rad/s", bench.turn_speed, 0.3);
const pointing = swinging === null ? [] : [make("fieldset", {}, make("legend", {}, "Where the tip points"),
  make("p", { className: "small dim" }, "about an axis of the world frame, its place kept"),
  make("div", { className: "rows" }, ...swinging.elements),
  make("div", { className: "jog", style: "margin-top:10px" }, ...["x", "y", "z"].flatMap((name, i) => axis(`turn about ${name}`, 3, i, "direction", swinging.value, () => ""))))];
const why = make("p", { className: "small" });
$("jog").append(
  make("p", {}, "The robot moves while a button is held, with the pointer or Space."), why,
  make("fieldset", {}, make("legend", {}, "Joints"),
    make("div", { className: "rows" }, ...turning.elements, ...sliding.elements),
    make("div", { className: "jog", style: "margin-top:10px" }, ...bench.joints.flatMap((joint, i) =>
      axis(joint.name, bench.joints.length, i, "joints", joint.motion === "rotation" ? turning.value : sliding.value, (status) => degrees(joint, status))))),
  make("fieldset", {}, make("legend", {}, "Tip, world frame"),
    make("p", { className: "small dim" }, "x: along gravity, down on the screen; z: along the straight tubes"),
    make("div", { className: "rows" }, ...tip.elements),
    make("div", { className: "jog", style: "margin-top:10px" }, ...["x", "y", "z"].flatMap((name, i) =>
      axis(name, 3, i, "tip", tip.value, (status) => (status.tip_measured === null ? "not measured now" : `${(1e3 * status.tip_measured[i]).toFixed(2)} mm`))))),
  ...pointing,
  make("div", { id: "hands" }),
);
onStatus((status, stale) => {
  const ready = mayJog(status, stale);
  if (!ready) release();
  for (const button of buttons) button.disabled = !ready;
  if (status !== null) tellWhy(why, status, ready);
});
onTab("jog", (open) => { if (!open) release(); });
