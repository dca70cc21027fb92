// Arrow keys and Page Up, Page Down move the tip while a field of its own has the focus. Part of the tab Jog.
import { make, onStatus } from "./station.js";
import { hold, isHeld, mayJog, release } from "./jog.js";
import { bounded, hands, velocity } from "./pad.js";

/** What each key asks of x, y and z, as seen from the side. */
const WISHES = {
  ArrowRight: [0, 0, 1], ArrowLeft: [0, 0, -1], ArrowDown: [1, 0, 0], ArrowUp: [-1, 0, 0], PageUp: [0, 1, 0], PageDown: [0, -1, 0],
};
const HELP = [["→", "←", "z, along the tubes"], ["↓", "↑", "x, down on the screen"], ["PgUp", "PgDn", "y, away from who looks from the side"]];

const says = make("b"), field = make("div", { className: "keys", tabIndex: 0, role: "application", "aria-label": "move the tip by keys: arrows, Page Up and Page Down" },
  says, make("div", { className: "key-help small" }, ...HELP.flatMap(([plus, minus, words]) => [
    make("span", {}, make("kbd", {}, plus), " ", make("kbd", {}, minus)), make("span", { className: "dim" }, words)])));
hands.append(field);

const down = new Set();
let ready = false;

const asked = () => velocity(bounded([...down].reduce((sum, key) => sum.map((part, i) => part + WISHES[key][i]), [0, 0, 0])));

field.addEventListener("keydown", (event) => {
  if (!(event.key in WISHES) || event.ctrlKey || event.altKey || event.metaKey || event.shiftKey) return;
  event.preventDefault(); // the panel would scroll
  if (event.repeat || !ready) return;
  if (!isHeld(field)) down.clear(); // however it ended: what is still down from before has to be pressed anew
  down.add(event.key);
  hold(field, "tip", asked);
});
const up = (event) => {
  down.delete(event.key);
  if (down.size === 0 && isHeld(field)) release();
};
field.addEventListener("keyup", up);
field.addEventListener("blur", () => { if (isHeld(field)) release(); tell(); });
field.addEventListener("focus", tell);

function tell() {
  says.textContent = document.activeElement !== field ? "Keys: click here, or come here with Tab"
    : ready ? "These keys move the tip while they are held" : "These keys move nothing now";
}
onStatus((status, stale) => { ready = mayJog(status, stale); tell(); });
tell();
