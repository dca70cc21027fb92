// Queue of runs, above the motions of the tab Run: what runs next, why it waits, and its order.
import { blockReason, button, confirm, enable, latest, make, note, onStatus, request, sendCommand } from "../page/station.js";
import { refuse } from "../page/form.js";
import { numberField } from "../page/number.js";
import { isOpen, onTab } from "../page/tabs.js";

const POLL_INTERVAL_MS = 1000, MAX_REPEATS = 50; // as in web/api/queue.py
const SIGNS = { waiting: "○", running: "▶", done: "●", failed: "▲" };
const list = make("ol"), state = make("p", { className: "small", role: "status" });
const act = (method, path, text, label, body) => button(text, async () => { if (await sendCommand(method, path, body)) refresh(); }, { "aria-label": label });
const pause = act("POST", "/api/queue/pause", "Pause", "pause the queue", {}), resume = act("POST", "/api/queue/resume", "Continue", "continue the queue", {}), clear = button("Remove waiting runs…", async () => {
  if (await confirm("Remove all waiting runs?", "Remove", make("p", {}, "The run in progress continues.")) && await sendCommand("DELETE", "/api/queue")) refresh();
}, { "aria-label": "remove waiting runs from the queue" });
/** The queue, hidden while it is empty. */
export const box = make("fieldset", { id: "queue", hidden: true }, make("legend", {}, "Queue"), state, list, make("div", { className: "acts" }, pause, resume, clear));

/** Return the field for how often runs are added to the queue: {element, read()}; read() returns null for an invalid number. */
export function repetitions() {
  const input = numberField("repetitions in the queue", 1, { min: 1, max: MAX_REPEATS, whole: true, required: true });
  const element = make("label", { className: "small", title: "The noise of the sensors differs from run to run, as with another seed" }, "repeat ", input, " times");
  return { element, read: () => (input.reportValidity() ? input.number : null) };
}

/** Add the runs of a request at the end of the queue, as often as the field `repeat` contains. */
export async function addToQueue(body, repeat = null) {
  const times = repeat === null ? 1 : repeat.read();
  if (times === null || (startsAtOnce() && !await confirm("Start the queue?", "Start",
    make("p", {}, "Nothing runs and nothing waits, so the robot starts the first run at once: it first goes to the run's start pose. Check that the path is clear. STOP works at any time.")))) return;
  const queue = await sendCommand("POST", "/api/queue", { ...body, repeat: times }, repeat && ((text) => refuse(repeat.element.closest("form"), text)));
  if (queue === null) return;
  note(times === 1 ? "added to the queue" : `added to the queue ${times} times`, true);
  show(queue);
}

function row(entry) {
  const waits = entry.state === "waiting", move = `/api/queue/${entry.id}/move`;
  const todo = waits ? entry.by_hand : "";
  return make("li", { className: entry.state }, make("span", {}, `${SIGNS[entry.state]} ${entry.title}`,
    entry.reason === "" ? null : make("span", { className: "small mind" }, ` ${entry.reason}`), todo === "" ? null : make("span", { className: "small dim" }, ` ${todo}`)),
  waits ? act("POST", move, "↑", `${entry.title}: earlier`, { by: -1 }) : null, waits ? act("POST", move, "↓", `${entry.title}: later`, { by: 1 }) : null,
  entry.state === "running" ? null : act("DELETE", `/api/queue/${entry.id}`, "×", `${entry.title}: remove`));
}

/** Return whether the station would start a run that is added now. */
const startsAtOnce = () => latest()?.state === "READY" && !waits;

let shown = "", waits = false; // waits: a run of the queue waits or runs
function show(queue) {
  if (shown === (shown = JSON.stringify(queue))) return;
  const left = queue.entries.filter((entry) => entry.state === "waiting").length;
  waits = queue.entries.some((entry) => entry.state === "waiting" || entry.state === "running");
  box.hidden = queue.entries.length === 0;
  state.textContent = queue.paused === "" ? `${left} waiting` : `paused: ${queue.paused}`;
  pause.hidden = queue.paused !== "";
  resume.hidden = queue.paused === "" || left === 0;
  list.replaceChildren(...queue.entries.map(row));
}

async function refresh() {
  if (!isOpen("start")) return;
  try { show(await request("GET", "/api/queue", undefined, 3000)); } catch { return; } // the header reports that the station does not answer
}
setInterval(refresh, POLL_INTERVAL_MS);
onTab("start", refresh);
onStatus((status, stale) => { for (const control of box.querySelectorAll("button")) enable(control, blockReason(status, stale)); });
refresh();
