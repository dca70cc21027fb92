// A hand at the tip: a gamepad or a space mouse. The tip moves while a dead man's button is held. Part of the tab Jog.
import { $, ask, latest, make, onStatus } from "./station.js";
import { tellWhy } from "./acts.js";
import { hold, isHeld, mayJog, release, speed } from "./jog.js";
import { isOpen } from "./tabs.js";

/** Between two looks at the pad [ms], and what a stick at rest may show. */
const LOOK = 25, DEAD_ZONE = 0.12;

/**
 * Pads by what they are: their dead man's buttons, and for x, y and z what a person does, which axis tells of it and
 * which way is plus. As seen from the side: z to the right, x down (gravity), y away from who looks.
 */
const LAYOUTS = [
  { fits: (pad) => pad.mapping === "standard", buttons: [4, 5], button: "a shoulder button (L1, R1)",
    axes: [["left stick down, up", 1, 1], ["right stick up, down", 3, -1], ["left stick right, left", 0, 1]] },
  { fits: (pad) => /3dconnexion|space ?(mouse|navigator|pilot|explorer)|256f/i.test(pad.id), buttons: [0, 1], button: "one of its buttons",
    axes: [["cap pressed, lifted", 2, 1], ["cap pushed away, pulled", 1, -1], ["cap to the right, left", 0, 1]] },
  { fits: () => true, buttons: [0], button: "its first button", axes: [["first axis", 0, 1], ["second axis", 1, 1], ["third axis", 2, 1]] },
];
const layout = (pad) => LAYOUTS.find((one) => one.fits(pad));

/** A wish of x, y, z no longer than 1: a corner of a stick's square is no faster than its side. */
export const bounded = (wish) => wish.map((part) => part / Math.max(1, Math.hypot(...wish)));
const beyondDeadZone = (part) => Math.sign(part) * Math.max(0, (Math.abs(part) - DEAD_ZONE) / (1 - DEAD_ZONE));

const wishOf = (pad) => bounded(layout(pad).axes.map(([, axis, way]) => beyondDeadZone(way * (pad.axes[axis] ?? 0))));
const pressed = (pad) => layout(pad).buttons.some((number) => pad.buttons[number]?.pressed);
const plugged = () => [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad?.connected);

const bench = await ask("GET", "/api/bench");
const fastest = speed("at most", "m/s", bench.tip_speed, 0.3);
/** [m/s] for a wish, by the slider. */
export const velocity = (wish) => wish.map((part) => part * fastest.value());

const says = make("p", { role: "status", className: "small", style: "margin:8px 0 0" });
const rows = ["x", "y", "z"].map((name) => ({ name, what: make("span", { className: "dim" }), bar: make("i"), said: make("output") }));
const axes = make("div", { className: "axes" }, ...rows.flatMap(({ name, what, bar, said }) => [make("b", {}, name), what, make("div", { className: "deflection" }, bar), said]));
/** Of all that moves the tip without a button on the page. */
export const hands = make("fieldset", {}, make("legend", {}, "Tip, by a pad or by keys"), make("div", { className: "rows" }, ...fastest.elements), says, axes);
$("hands").append(hands);

const seenUp = new Set(); // pads, by number, whose button was seen up: a press that was there before begins nothing
let leading = null, ready = false; // the pad that moves the tip, or did last; whether it may

/** What the leading pad asks for at this moment [m/s]; one that was let go, or is gone, ends it. */
function led() {
  const pad = plugged().find((one) => one.index === leading);
  if (pad !== undefined && pressed(pad)) return velocity(wishOf(pad));
  if (isHeld(axes)) release();
  return [0, 0, 0];
}

function look() {
  if (!isOpen("jog")) return;
  const pads = plugged();
  for (const number of seenUp) if (!pads.some((pad) => pad.index === number)) seenUp.delete(number);
  if (isHeld(axes)) led();
  for (const pad of pads) {
    if (!pressed(pad)) seenUp.add(pad.index);
    else if (seenUp.delete(pad.index) && ready && !isHeld(axes) && document.hasFocus() && !document.hidden) {
      leading = pad.index;
      hold(axes, "tip", led);
    }
  }
  const shown = pads.find((pad) => pad.index === leading) ?? pads[0] ?? null;
  axes.hidden = shown === null;
  if (shown !== null) show(shown);
  tell(shown);
}

/** Which axis does what, and what it asks for now. */
function show(pad) {
  const wish = wishOf(pad), now = velocity(wish);
  rows.forEach(({ what, bar, said }, i) => {
    what.textContent = layout(pad).axes[i][0];
    bar.style.transform = `scaleX(${wish[i]})`;
    said.textContent = `${(1e3 * now[i]).toFixed(1)} mm/s`;
  });
}

/** What a person has to do, or why nothing moves. */
function tell(pad) {
  const fresh = latest() !== null && !document.body.classList.contains("stale");
  if (fresh && !ready) {
    tellWhy(says, latest(), ready);
    return;
  }
  says.dataset.shown = "";
  const text = fresh ? advice(pad) : "nothing moves: there is no fresh word from the station";
  if (says.textContent !== text) says.replaceChildren(text);
}

function advice(pad) {
  if (navigator.getGamepads === undefined) return "pads are told only to pages of the station's own computer, or by https";
  if (pad === null) return "no pad is seen: plug one in and press one of its buttons";
  const name = pad.id.replace(/\s*\(.*$/, "") || "pad", { button } = layout(pad);
  if (isHeld(axes)) return `${name}: moves the tip until its button is let go`;
  if (!document.hasFocus()) return `${name}: click into this page first; it moves nothing from behind another window`;
  if (pressed(pad)) return `${name}: let go of its button, then press it again`;
  return `${name}: hold ${button} and move; letting go stops within 0.3 s`;
}

onStatus((status, stale) => { ready = mayJog(status, stale); });
window.addEventListener("gamepaddisconnected", look);
setInterval(look, LOOK);
