// STOP is sent by the button, or by keys wherever the focus is, and is repeated until the station acknowledges it.
import { $, abortPolls, dataAge, latest, make, note, pollStatus, request, Refused, SILENT_AFTER_S } from "./station.js";

const RETRY_MS = 700, TIMEOUT_MS = 3000; // interval between two STOPs, and time limit for an answer [ms]
const MOVING = ["RUNNING", "HOMING"];
let unacknowledged = null; // the STOP that the station has not acknowledged yet

/** Stop every axis. A press while an earlier STOP is unacknowledged sends another one at once. */
export function stop() {
  unacknowledged ??= { tries: 0, startedAt: performance.now(), retryTimer: 0 };
  send(unacknowledged);
}

async function send(attempt) {
  clearTimeout(attempt.retryTimer);
  attempt.retryTimer = setTimeout(() => { reportUnacknowledged(attempt); send(attempt); }, RETRY_MS);
  attempt.tries += 1;
  abortPolls();
  try {
    const { confirmed, note: answer } = await request("POST", "/api/stop", {}, TIMEOUT_MS);
    if (attempt !== unacknowledged) return; // an earlier answer was reported already
    const late = attempt.tries === 1 ? "" : `acknowledged after ${seconds(attempt)} s and ${attempt.tries} tries`;
    const text = [late, answer].filter((part) => part !== "").join("; ");
    if (confirmed && text !== "") note(`STOP was accepted: ${text}`, true); // a success is never shown as an alarm
    finish(attempt, confirmed ? "" : `STOP is not confirmed: ${text}. Use the emergency stop of the rig if anything moves.`);
  } catch (error) {
    if (error instanceof Refused && error.status < 500) finish(attempt, `STOP was refused: ${error.message}. Use the emergency stop of the rig.`);
    else reportUnacknowledged(attempt);
  }
}

const seconds = (attempt) => ((performance.now() - attempt.startedAt) / 1000).toFixed(1);

function reportUnacknowledged(attempt) {
  if (attempt !== unacknowledged) return;
  alarm(`STOP is not acknowledged: sent ${attempt.tries === 1 ? "once" : `${attempt.tries} times in ${seconds(attempt)} s`}, and it is repeated until the station acknowledges it. Use the emergency stop of the rig.`, "Give up");
}

function finish(attempt, text) {
  if (attempt !== unacknowledged) return;
  clearTimeout(attempt.retryTimer);
  unacknowledged = null;
  alarm(text);
  pollStatus();
}

const alarmText = make("span"), alarmButton = make("button", { type: "button" });
alarmButton.addEventListener("click", () => { if (unacknowledged === null) alarm(""); else finish(unacknowledged, "The page no longer repeats STOP; it was never acknowledged. Use the emergency stop of the rig."); });
$("alarm").append(alarmText, alarmButton);

/** Show an alarm below the header; an empty text removes it. */
export function alarm(text, button = "Close") {
  alarmText.textContent = text;
  alarmButton.textContent = button;
  $("alarm").hidden = text === "";
}

// STOP is sent when the pointer goes down, not when it is lifted. A click without a pointer comes from the keyboard.
$("stop").addEventListener("pointerdown", stop);
$("stop").addEventListener("click", (event) => { if (event.detail === 0) stop(); });

/** Stop by Shift+Space (in a text box only while something moves), or by Escape where it has no other effect. */
function pressed(event) {
  const status = latest(), old = status === null || dataAge() > SILENT_AFTER_S, moves = old || MOVING.includes(status.state);
  const typing = event.target.closest?.("textarea, input:not([type=checkbox], [type=range])") != null;
  const space = event.code === "Space" && event.shiftKey && (moves || !typing);
  const escape = event.key === "Escape" && moves && !$("question").open && event.target.closest?.("select") == null;
  if (!space && !escape) return;
  event.preventDefault();
  event.stopPropagation();
  if (event.repeat) return;
  stop();
  if (!escape || !old) return;
  for (const dialog of document.querySelectorAll("dialog[open]")) dialog.close();
  note("Escape has sent STOP, because the page has no current data about the robot.");
}
document.addEventListener("keydown", pressed, true);
// The page receives no key events of its frames (scene, report, replay), so each frame gets a listener. All frames are
// pages of this station.
document.addEventListener("load", (event) => {
  if (event.target.contentDocument) event.target.contentWindow.addEventListener("keydown", pressed, true);
}, true);
