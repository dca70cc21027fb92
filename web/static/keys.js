// Arrow keys, Page Up and Page Down move the tip while their field has the focus. Part of the tab Jog.
import { make, onStatus } from "./station.js";
import { startJogging, isHeld, mayJog, release } from "./jog.js";
import { bounded, hands, velocity } from "./pad.js";

/** Direction (x, y, z), world frame, in which each key moves the tip; the keys match the view from the side. */
const KEY_DIRECTIONS = {
  ArrowRight: [0, 0, 1], ArrowLeft: [0, 0, -1], ArrowDown: [1, 0, 0], ArrowUp: [-1, 0, 0], PageUp: [0, 1, 0], PageDown: [0, -1, 0],
};
const HELP = [["→", "←", "z, along the tubes"], ["↓", "↑", "x, down on the screen"], ["PgUp", "PgDn", "y, away from the viewer at the side"]];

const hint = make("b"), field = make("div", { className: "keys", tabIndex: 0, role: "application", "aria-label": "move the tip by keys: arrows, Page Up and Page Down" },
  hint, make("div", { className: "key-help small" }, ...HELP.flatMap(([plus, minus, meaning]) => [
    make("span", {}, make("kbd", {}, plus), " ", make("kbd", {}, minus)), make("span", { className: "dim" }, meaning)])));
hands.append(field);

const down = new Set();
let ready = false;

const keyVelocity = () => velocity(bounded([...down].reduce((sum, key) => sum.map((part, i) => part + KEY_DIRECTIONS[key][i]), [0, 0, 0])));

field.addEventListener("keydown", (event) => {
  if (!(event.key in KEY_DIRECTIONS) || event.ctrlKey || event.altKey || event.metaKey || event.shiftKey) return;
  event.preventDefault(); // otherwise the key would scroll the panel
  if (event.repeat || !ready) return;
  if (!isHeld(field)) down.clear(); // after the end of a jog, keys that are still down must be pressed again
  down.add(event.key);
  startJogging(field, "tip", keyVelocity);
});
const keyUp = (event) => {
  down.delete(event.key);
  if (down.size === 0 && isHeld(field)) release();
};
field.addEventListener("keyup", keyUp);
field.addEventListener("blur", () => { if (isHeld(field)) release(); showHint(); });
field.addEventListener("focus", showHint);

function showHint() {
  hint.textContent = document.activeElement !== field ? "Keys: click here, or focus this field with Tab"
    : ready ? "These keys move the tip while they are held" : "These keys are disabled now";
}
onStatus((status, stale) => { ready = mayJog(status, stale); showHint(); });
showHint();
