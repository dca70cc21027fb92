// Jog the tip with a gamepad or a 3D mouse while a dead man's button is held, or with keys while their field has the focus.
import { $, latest, make, onStatus, rigAnswer, setText } from "../page/station.js";
import { showReason } from "../page/header.js";
import { isOpen } from "../page/tabs.js";
import { isHeld, jogReason, release, speed, startJogging, step, tipStep } from "./jog.js";

/** Interval between two polls of the pad [ms]; largest deflection that counts as rest, as a fraction of the full one. */
const POLL_INTERVAL_MS = 25, DEAD_ZONE = 0.12;

/**
 * Layouts of known pads: dead man's buttons, and for x, y and z the user's action, the axis number and its sign.
 * Seen from the side: z points right, x down (gravity), y away from the viewer.
 */
const LAYOUTS = [
  { fits: (pad) => pad.mapping === "standard", buttons: [4, 5], button: "a shoulder button (L1, R1)",
    axes: [["left stick: down +, up −", 1, 1], ["right stick: up +, down −", 3, -1], ["left stick: right +, left −", 0, 1]] },
  { fits: (pad) => /3dconnexion|space ?(mouse|navigator|pilot|explorer)|256f/i.test(pad.id), buttons: [0, 1], button: "any button of the 3D mouse",
    axes: [["cap: press +, lift −", 2, 1], ["cap: push away +, pull −", 1, -1], ["cap: right +, left −", 0, 1]] },
  { fits: () => true, buttons: [0], button: "its first button", axes: [["first axis", 0, 1], ["second axis", 1, 1], ["third axis", 2, 1]] },
];
/** Direction (x, y, z), world frame, in which each key moves the tip; the keys match the view from the side. */
const KEY_DIRECTIONS = {
  ArrowRight: [0, 0, 1], ArrowLeft: [0, 0, -1], ArrowDown: [1, 0, 0], ArrowUp: [-1, 0, 0], PageUp: [0, 1, 0], PageDown: [0, -1, 0],
};
const HELP = [["→", "←", "z, along the tubes"], ["↓", "↑", "x, down on the screen"], ["PgUp", "PgDn", "y, away from the viewer at the side"]];

const layout = (pad) => LAYOUTS.find((one) => one.fits(pad));

/** Limit the input (x, y, z) to length 1, so that a stick in a corner of its range gives no higher speed. */
const bounded = (input) => input.map((component) => component / Math.max(1, Math.hypot(...input)));
const beyondDeadZone = (component) => Math.sign(component) * Math.max(0, (Math.abs(component) - DEAD_ZONE) / (1 - DEAD_ZONE));

const stickInput = (pad) => bounded(layout(pad).axes.map(([, axis, sign]) => beyondDeadZone(sign * (pad.axes[axis] ?? 0))));
const pressed = (pad) => layout(pad).buttons.some((number) => pad.buttons[number]?.pressed);
const connectedPads = () => [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad?.connected);

const rig = await rigAnswer();
const maxSpeed = speed("at most", "m/s", rig.tip_speed, 0.3);
/** Return the tip's velocity [m/s] for an input, scaled by the speed slider. */
const velocity = (input) => input.map((component) => component * maxSpeed.value());

const hint = make("p", { role: "status", className: "small", style: "margin:8px 0 0" });
const rows = ["x", "y", "z"].map((name) => ({ name, label: make("span", { className: "dim" }), bar: make("i"), output: make("output") }));
const axes = make("div", { className: "axes" }, ...rows.flatMap(({ name, label, bar, output }) => [make("b", {}, name), label, make("div", { className: "deflection" }, bar), output]));
const keyHint = make("b"), field = make("div", { className: "keys", tabIndex: 0, role: "application", "aria-label": "move the tip by keys: arrows, Page Up and Page Down" },
  keyHint, make("div", { className: "key-help small" }, ...HELP.flatMap(([plus, minus, meaning]) => [
    make("span", {}, make("kbd", {}, plus), " ", make("kbd", {}, minus)), make("span", { className: "dim" }, meaning)])));
$("hands").append(make("fieldset", {}, make("legend", {}, "Tip, by gamepad or keys"), make("div", { className: "rows" }, ...maxSpeed.elements), hint, axes, field));

// ---- gamepad

const released = new Set(); // indices of pads whose dead man's button was seen released; only these pads may start a jog
let activePad = null, ready = false; // index of the pad that moves the tip or moved it last; whether a jog may start

/** Return the velocity of the active pad [m/s]; a released or missing pad ends the jog. */
function padVelocity() {
  const pad = connectedPads().find((one) => one.index === activePad);
  if (pad !== undefined && pressed(pad)) return velocity(stickInput(pad));
  if (isHeld(axes)) release();
  return [0, 0, 0];
}

function pollPads() {
  if (!isOpen("jog")) return;
  const pads = connectedPads();
  for (const number of released) if (!pads.some((pad) => pad.index === number)) released.delete(number);
  if (isHeld(axes)) padVelocity();
  for (const pad of pads) {
    if (!pressed(pad)) released.add(pad.index);
    else if (released.delete(pad.index) && ready && !isHeld(axes) && document.hasFocus() && !document.hidden) {
      activePad = pad.index;
      startJogging(axes, "tip", padVelocity);
    }
  }
  const shown = pads.find((pad) => pad.index === activePad) ?? pads[0] ?? null;
  axes.hidden = shown === null;
  if (shown !== null) showInput(shown);
  showHint(shown);
}

/** Show the function of each axis and its current velocity. */
function showInput(pad) {
  const input = stickInput(pad), now = velocity(input);
  rows.forEach(({ label, bar, output }, i) => {
    label.textContent = layout(pad).axes[i][0];
    bar.style.transform = `scaleX(${input[i]})`;
    output.textContent = `${(1e3 * now[i]).toFixed(1)} mm/s`;
  });
}

/** Show what to do, or why the tip does not move. */
function showHint(pad) {
  const current = latest() !== null && !document.body.classList.contains("stale");
  if (current && !ready) {
    showReason(hint, latest(), ready);
    return;
  }
  hint.dataset.shown = "";
  setText(hint, current ? advice(pad) : "the tip does not move: no current data from the station");
}

function advice(pad) {
  if (navigator.getGamepads === undefined) return "browsers allow gamepads only on the station's computer, or over https";
  if (pad === null) return "no gamepad detected: connect one and press one of its buttons";
  const name = pad.id.replace(/\s*\(.*$/, "") || "pad", { button } = layout(pad);
  if (isHeld(axes)) return `${name} moves the tip. Release its button to stop.`;
  if (!document.hasFocus()) return `${name}: click into this page first; gamepads have no effect while another window has the focus`;
  if (pressed(pad)) return `${name}: release its button, then press it again`;
  return `${name}: hold ${button} and move; releasing it stops within 0.3 s`;
}

window.addEventListener("gamepaddisconnected", pollPads);
setInterval(pollPads, POLL_INTERVAL_MS);

// ---- keys

const down = new Set();

const keyVelocity = () => velocity(bounded([...down].reduce((sum, key) => sum.map((part, i) => part + KEY_DIRECTIONS[key][i]), [0, 0, 0])));

field.addEventListener("keydown", (event) => {
  if (!(event.key in KEY_DIRECTIONS) || event.ctrlKey || event.altKey || event.metaKey || event.shiftKey) return;
  event.preventDefault(); // otherwise the key would scroll the panel
  if (event.repeat || !ready) return;
  if (tipStep() > 0) { step({ tip: KEY_DIRECTIONS[event.key].map((part) => part * tipStep()) }); return; }
  if (!isHeld(field)) down.clear(); // after the end of a jog, keys that are still down must be pressed again
  down.add(event.key);
  startJogging(field, "tip", keyVelocity);
});
field.addEventListener("keyup", (event) => {
  down.delete(event.key);
  if (down.size === 0 && isHeld(field)) release();
});
field.addEventListener("blur", () => { if (isHeld(field)) release(); showKeyHint(); });
field.addEventListener("focus", showKeyHint);

function showKeyHint() {
  keyHint.textContent = document.activeElement !== field ? "Keys: click here, or focus this field with Tab"
    : !ready ? "These keys are disabled now" : tipStep() > 0 ? "Each press of a key is a step of the tip" : "These keys move the tip while they are held";
}

onStatus((status, stale) => { ready = jogReason(status, stale) === ""; showKeyHint(); });
showKeyHint();
