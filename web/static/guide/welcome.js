// First visit: one obvious thing to do, and three sentences about the page. Shown once per browser.
import { $, benchNote, blockReason, button, enable, ensureFresh, make, onStatus, sendCommand, setText } from "../page/station.js";
import { openTab } from "../page/tabs.js";
import { local } from "../page/storage.js";

const STEPS = [
  ["stop", "STOP, or Shift+Space, stops every axis at once, at any time."],
  ["state-box", "This part shows the state of the station and what you can do next."],
  ["strip", "During a run: distance of the tip from its desired position, force, deflection and time left."],
];

const box = make("section", { id: "welcome", "aria-label": "welcome" }), actions = make("div", { className: "acts" });
const demo = button("Run the demo (1 min)", runDemo, { className: "main" }), reason = make("span", { className: "small dim" });
const about = make("p", {}, "The demo drives the tip of the simulated robot along a circle while a load pulls at it.");
const bench = make("p", { className: "small", hidden: true });

async function runDemo() {
  openTab("start");
  if (await ensureFresh() && await sendCommand("POST", "/api/start", { experiment: "demo" })) close();
}

onStatus((status) => {
  // A real robot starts from its form, after a look at the bench. The demo needs a tracker, which a bench with known
  // devices may lack.
  demo.hidden = status !== null && (!status.simulated || ("stages" in status.devices && !("tracker" in status.devices)));
  about.hidden = demo.hidden;
  setText(bench, status === null ? "" : benchNote(status.devices));
  bench.hidden = bench.textContent === "";
  enable(demo, blockReason(status, false, ["READY"]));
  if (status?.state === "RUNNING" && demo.isConnected) close(); // the user has found a motion
  reason.textContent = demo.hidden || !demo.disabled ? "" : status === null ? "" : status.next;
});

function show(...children) {
  box.replaceChildren(...children);
  $("panel").insertBefore(box, $("tabs"));
}

function close() {
  local.set("welcomed", "yes");
  unmark();
  box.remove();
}

/** Show a step of the tour, by default the first one. It covers nothing, and Escape leaves it while nothing moves. */
export function tour(step = 0) {
  unmark();
  if (step === STEPS.length) { close(); return; }
  const [id, text] = STEPS[step];
  $(id).classList.add("pointed-at");
  actions.replaceChildren(button(step + 1 < STEPS.length ? "Next" : "Done", () => tour(step + 1), { className: "main" }), button("Skip", close));
  show(make("p", { role: "status" }, `${step + 1} of ${STEPS.length}: ${text}`), actions);
  actions.firstChild.focus();
}

function unmark() {
  for (const one of document.querySelectorAll(".pointed-at")) one.classList.remove("pointed-at");
}

document.addEventListener("keydown", (event) => {
  if (event.key !== "Escape" || event.defaultPrevented || document.querySelector("dialog[open]") !== null) return; // it closes a dialog
  if (box.isConnected) close(); // while something moves, Escape has been taken for STOP
});

if (local.get("welcomed") === null) {
  actions.append(demo, button("Show me around", () => tour()), button("Close", close));
  show(make("h2", {}, "Welcome"), about, bench, actions, reason);
}
