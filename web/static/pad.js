// Jog the tip with a gamepad or a 3D mouse while a dead man's button is held. Part of the tab Jog.
import { $, request, latest, make, onStatus } from "./station.js";
import { showReason } from "./next_action.js";
import { startJogging, isHeld, mayJog, release, speed } from "./jog.js";
import { isOpen } from "./tabs.js";

/** Interval between two polls of the pad [ms]; largest deflection that counts as rest, as a fraction of the full one. */
const POLL_INTERVAL_MS = 25, DEAD_ZONE = 0.12;

/**
 * Layouts of known pads: dead man's buttons, and for x, y and z the user's action, the axis number and its sign.
 * Seen from the side: z points right, x down (gravity), y away from the viewer.
 */
const LAYOUTS = [
  { fits: (pad) => pad.mapping === "standard", buttons: [4, 5], button: "a shoulder button (L1, R1)",
    axes: [["left stick down, up", 1, 1], ["right stick up, down", 3, -1], ["left stick right, left", 0, 1]] },
  { fits: (pad) => /3dconnexion|space ?(mouse|navigator|pilot|explorer)|256f/i.test(pad.id), buttons: [0, 1], button: "any button of the gamepad",
    axes: [["cap pressed, lifted", 2, 1], ["cap pushed away, pulled", 1, -1], ["cap to the right, left", 0, 1]] },
  { fits: () => true, buttons: [0], button: "its first button", axes: [["first axis", 0, 1], ["second axis", 1, 1], ["third axis", 2, 1]] },
];
const layout = (pad) => LAYOUTS.find((one) => one.fits(pad));

/** Limit the input (x, y, z) to length 1, so that a stick in a corner of its range gives no higher speed. */
export const bounded = (input) => input.map((component) => component / Math.max(1, Math.hypot(...input)));
const beyondDeadZone = (component) => Math.sign(component) * Math.max(0, (Math.abs(component) - DEAD_ZONE) / (1 - DEAD_ZONE));

const stickInput = (pad) => bounded(layout(pad).axes.map(([, axis, sign]) => beyondDeadZone(sign * (pad.axes[axis] ?? 0))));
const pressed = (pad) => layout(pad).buttons.some((number) => pad.buttons[number]?.pressed);
const connectedPads = () => [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad?.connected);

const rig = await request("GET", "/api/rig");
const maxSpeed = speed("at most", "m/s", rig.tip_speed, 0.3);
/** Return the tip's velocity [m/s] for an input, scaled by the speed slider. */
export const velocity = (input) => input.map((component) => component * maxSpeed.value());

const hint = make("p", { role: "status", className: "small", style: "margin:8px 0 0" });
const rows = ["x", "y", "z"].map((name) => ({ name, label: make("span", { className: "dim" }), bar: make("i"), output: make("output") }));
const axes = make("div", { className: "axes" }, ...rows.flatMap(({ name, label, bar, output }) => [make("b", {}, name), label, make("div", { className: "deflection" }, bar), output]));
/** Fields for gamepad, 3D mouse and keys, which move the tip without a button of the page. */
export const hands = make("fieldset", {}, make("legend", {}, "Tip, by gamepad or keys"), make("div", { className: "rows" }, ...maxSpeed.elements), hint, axes);
$("hands").append(hands);

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
  const text = current ? advice(pad) : "the tip does not move: no current data from the station";
  if (hint.textContent !== text) hint.replaceChildren(text);
}

function advice(pad) {
  if (navigator.getGamepads === undefined) return "browsers allow gamepads only on the station's computer, or over https";
  if (pad === null) return "no gamepad detected: connect one and press one of its buttons";
  const name = pad.id.replace(/\s*\(.*$/, "") || "pad", { button } = layout(pad);
  if (isHeld(axes)) return `${name}: moves the tip until its button is released`;
  if (!document.hasFocus()) return `${name}: click into this page first; gamepads have no effect while another window has the focus`;
  if (pressed(pad)) return `${name}: release its button, then press it again`;
  return `${name}: hold ${button} and move; releasing it stops within 0.3 s`;
}

onStatus((status, stale) => { ready = mayJog(status, stale); });
window.addEventListener("gamepaddisconnected", pollPads);
setInterval(pollPads, POLL_INTERVAL_MS);
