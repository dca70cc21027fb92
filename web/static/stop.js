// STOP: sent at the press and again until the station acknowledges it; the button, and keys wherever the focus is.
import { $, ask, latest, look, make, makeWay, Refused } from "./station.js";

const AGAIN = 700, PATIENCE = 3000; // ms
const MOVING = ["RUNNING", "HOMING"];
let open = null; // the STOP that nobody has acknowledged yet

/** Have every axis stopped. A press while an earlier one is not acknowledged sends at once. */
export function stop() {
  open ??= { tries: 0, begun: performance.now(), again: 0 };
  send(open);
}

async function send(mine) {
  clearTimeout(mine.again);
  mine.again = setTimeout(() => { tellOpen(mine); send(mine); }, AGAIN);
  mine.tries += 1;
  makeWay();
  try {
    const { note } = await ask("POST", "/api/stop", {}, PATIENCE);
    const late = mine.tries === 1 ? "" : `acknowledged after ${seconds(mine)} s and ${mine.tries} tries`;
    const text = [late, note].filter((part) => part !== "").join("; ");
    end(mine, text === "" ? "" : `STOP was taken: ${text}`);
  } catch (error) {
    if (error instanceof Refused && error.status < 500) end(mine, `STOP was refused: ${error.message}. Use the emergency stop of the bench.`);
    else tellOpen(mine);
  }
}

const seconds = (mine) => ((performance.now() - mine.begun) / 1000).toFixed(1);

function tellOpen(mine) {
  if (mine !== open) return;
  alarm(`STOP is not acknowledged: sent ${mine.tries === 1 ? "once" : `${mine.tries} times in ${seconds(mine)} s`}, and again until it is. Use the emergency stop of the bench.`, "Give up");
}

function end(mine, text) {
  if (mine !== open) return;
  clearTimeout(mine.again);
  open = null;
  alarm(text);
  look();
}

const said = make("span"), away = make("button", { type: "button" });
away.addEventListener("click", () => { if (open === null) alarm(""); else end(open, "STOP was given up and never acknowledged. Use the emergency stop of the bench."); });
$("alarm").append(said, away);

/** Say something that nobody must miss; empty takes it away. */
export function alarm(text, button = "Close") {
  said.textContent = text;
  away.textContent = button;
  $("alarm").hidden = text === "";
}

// At the first touch, not when the finger is lifted; a click without a pointer is the keyboard's.
$("stop").addEventListener("pointerdown", stop);
$("stop").addEventListener("click", (event) => { if (event.detail === 0) stop(); });

/** Shift+Space always, but in a text box a space while nothing moves; Escape where it has nothing else to end. */
function pressed(event) {
  const status = latest(), moves = status === null || MOVING.includes(status.state);
  const typing = event.target.closest?.("textarea, input:not([type=checkbox], [type=range])") != null;
  const space = event.code === "Space" && event.shiftKey && (moves || !typing);
  const escape = event.key === "Escape" && moves && !$("question").open && event.target.closest?.("select") == null;
  if (!space && !escape) return;
  event.preventDefault();
  event.stopPropagation();
  if (!event.repeat) stop();
}
document.addEventListener("keydown", pressed, true);
// Frames have keys of their own: the scene, a report, a replay. All of them are this station's.
document.addEventListener("load", (event) => {
  if (event.target.contentDocument) event.target.contentWindow.addEventListener("keydown", pressed, true);
}, true);
