// Command palette (Ctrl+K): every action of the page by name, with the reason if it is not possible now.
import { $, blockReason, button, latest, make, onStatus, replaceChanged, request, sendCommand } from "../page/station.js";
import { changeOperator, home } from "../page/header.js";
import { openTab } from "../page/tabs.js";
import { toggleHelp } from "./help.js";
import { tour } from "./welcome.js";

const command = (method, path) => () => sendCommand(method, path, method === "POST" ? {} : undefined);
/** Return the function that gives the reason against a command of the operator; without `states` it is possible in all. */
const inStates = (...states) => (status) => blockReason(status, false, states.length > 0 ? states : null);
const onlyOperator = (wanted, text) => (status) => (status === null || status.operator.role === "viewer" ? blockReason(status) : status.operator.you === wanted ? "" : text);
const module = (path) => import(`../${path}.js`); // a tab that cannot be loaded does not affect the palette

/** Actions of the page: {title, words: further words that find it, run, against(status): why it is not possible now; absent: it is always possible}. */
const ACTIONS = [
  { title: "STOP every axis", run: () => window.STOP.press() },
  { title: "Take control", against: onlyOperator(false, "this page is operator"), run: changeOperator },
  { title: "Release control", against: onlyOperator(true, "this page is not operator"), run: changeOperator },
  { title: "Connect the devices", against: inStates("OFF"), run: command("POST", "/api/connect") },
  { title: "Home the stages", against: inStates("CONNECTED", "READY"), run: home },
  { title: "Zero the force sensors", against: inStates("READY"), run: command("POST", "/api/tare") },
  { title: "Reset", against: inStates("HOLD", "STOPPED", "FAULT"), run: command("POST", "/api/reset") },
  { title: "Run the last run again", against: (status) => inStates("READY")(status) || (status.run?.recorded ? "" : "nothing has run yet"),
    run: async () => (await module("run/run")).runAgain(latest().run.id) },
  { title: "Pause the queue", against: inStates(), run: command("POST", "/api/queue/pause") },
  { title: "Continue the queue", against: inStates(), run: command("POST", "/api/queue/resume") },
  { title: "Clear the queue", against: inStates(), run: command("DELETE", "/api/queue") },
  ...[["start", "Run", "motion experiment teach waypoints queue"], ["jog", "Jog", "move gamepad"], ["plots", "Plots", "curves"],
    ["runs", "History", "result export download csv matlab delete report replay"], ["devices", "Bench, Devices", "robot six motors"], ["calibrate", "Bench, Calibrate", ""], ["faults", "Bench, Faults", "log inject load"]]
    .map(([id, name, words]) => ({ title: `Open ${name}`, words, run: () => openTab(id) })),
  { title: "Compare two runs (tick them in History)", run: () => openTab("runs") },
  { title: "Help", run: toggleHelp },
  { title: "Show me around", run: tour },
];
let experiments = []; // actions that open a case of an experiment, or queue all its cases

/** Return why an action is not possible now; empty if it is possible. */
const reasonAgainst = ({ against }) => against?.(latest()) ?? "";

/** Return the actions of an experiment. */
function actionsOf(one) {
  const name = one.name.replaceAll("_", " "), open = async (caseName) => (await module("run/run")).openExperiment(one.name, caseName);
  const queue = { title: `Queue all cases of ${name}`, against: inStates(), run: async () => (await module("run/queue")).addToQueue({ experiment: one.name }) };
  return [{ title: `Experiment ${name}: ${one.title}`, run: () => open() },
    ...(one.cases.length < 2 ? [] : [queue, ...one.cases.map((each) => ({ title: `Case ${name}: ${each.words}`, words: each.name.replaceAll("_", " "), run: () => open(each.name) }))])];
}

/** Return the actions whose titles or further words contain every word of a query, or its beginning; titles come first. */
function found(query) {
  const wanted = query.toLowerCase().split(/\s+/).filter(Boolean);
  const within = (text) => { const words = ` ${text.toLowerCase().replaceAll(/[^a-z0-9]+/g, " ")}`; return wanted.every((word) => words.includes(` ${word}`)); };
  const all = [...ACTIONS, ...experiments], titled = all.filter((one) => within(one.title));
  return [...titled, ...all.filter((one) => !titled.includes(one) && within(`${one.title} ${one.words ?? ""}`))];
}

const field = make("input", { type: "text", placeholder: "what to do", maxLength: 100, role: "combobox", "aria-label": "action", "aria-expanded": "true", "aria-controls": "actions", autocomplete: "off" });
const list = make("ul", { id: "actions", role: "listbox", "aria-label": "actions" });
const dialog = make("dialog", { id: "palette", "aria-label": "actions" }, field, list);
document.querySelector("main").append(dialog);
let shown = [], chosen = 0, before = null; // listed actions, index of the chosen one, element that had the focus

/** Draw the listed actions, if their titles or the reasons against them have changed. */
function draw() {
  const rows = shown.map((action, number) => [action.title, reasonAgainst(action), number]);
  replaceChanged(list, [...rows, chosen], () => (rows.length === 0 ? [make("li", { role: "option", "aria-disabled": "true", className: "dim" }, "no action has these words")]
    : rows.map(([title, reason, number]) => make("li", { id: `action-${number}`, role: "option", "aria-selected": String(number === chosen),
      "aria-disabled": String(reason !== ""), onclick: () => carryOut(number) }, title, reason && make("span", { className: "small" }, ` ${reason}`)))));
}

function show() {
  shown = found(field.value);
  chosen = Math.max(0, Math.min(chosen, shown.length - 1));
  draw();
  field.setAttribute("aria-activedescendant", `action-${chosen}`);
  list.children[chosen]?.scrollIntoView({ block: "nearest" });
}

function close() {
  dialog.close();
  before?.focus();
}

function carryOut(number) {
  if (shown[number] === undefined || reasonAgainst(shown[number]) !== "") return;
  close();
  shown[number].run();
}

async function open() {
  if (dialog.open) { close(); return; }
  before = document.activeElement;
  field.value = "";
  chosen = 0;
  dialog.show(); // below the header, so that STOP stays free
  show();
  field.focus();
  const all = await request("GET", "/api/experiments?check=false").catch(() => []);
  experiments = all.filter((one) => one.error === "").flatMap(actionsOf);
  if (dialog.open) show();
}

field.addEventListener("input", () => { chosen = 0; show(); });
onStatus(() => { if (dialog.open) draw(); }); // a reason may appear or disappear while the list is open
dialog.addEventListener("keydown", (event) => {
  const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (step !== undefined) { chosen = (chosen + step + shown.length) % Math.max(1, shown.length); show(); }
  else if (event.key === "Enter") carryOut(chosen);
  else if (event.key === "Escape") close(); // while something moves, Escape has been taken for STOP
  else return;
  event.preventDefault();
});
document.addEventListener("keydown", (event) => {
  if (event.key.toLowerCase() !== "k" || !(event.ctrlKey || event.metaKey)) return;
  event.preventDefault();
  open();
});
$("tools").prepend(button("☰", open, { title: "All actions (Ctrl+K)", "aria-label": "all actions" }));
