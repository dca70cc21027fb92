// Command palette (Ctrl+K): every action of the page by name, with the reason if it is not possible now.
import { $, button, latest, make, mayCommand, request, sendCommand } from "../page/station.js";
import { home } from "../page/header.js";
import { stop } from "../page/stop.js";
import { openTab } from "../page/tabs.js";
import { toggleHelp } from "./help.js";

/** Actions of the page: {title, run, states (in which the action is possible; absent: in all)}. */
const ACTIONS = [
  { title: "STOP every axis", run: stop },
  { title: "Connect the devices", states: ["OFF"], run: () => sendCommand("POST", "/api/connect", {}) },
  { title: "Home the stages", states: ["CONNECTED", "READY"], run: home },
  { title: "Zero the force sensors", states: ["READY"], run: () => sendCommand("POST", "/api/tare", {}) },
  { title: "Reset", states: ["HOLD", "STOPPED", "FAULT"], run: () => sendCommand("POST", "/api/reset", {}) },
  { title: "Release control", states: [], operator: true, run: () => sendCommand("DELETE", "/api/operator") },
  ...[["start", "Run"], ["jog", "Jog"], ["plots", "Plots"], ["runs", "History"], ["devices", "Bench, Devices"], ["calibrate", "Bench, Calibrate"], ["faults", "Bench, Faults"]]
    .map(([id, name]) => ({ title: `Open ${name}`, run: () => openTab(id) })),
  { title: "Help", run: toggleHelp },
];
let experiments = []; // actions that open an experiment

/** Return why an action is not possible now; empty if it is possible. */
function reasonAgainst({ states, operator }) {
  const status = latest();
  if (operator) return status?.operator.you ? "" : "this page is not operator";
  if (states === undefined) return "";
  if (status === null) return "the station does not answer";
  return !states.includes(status.state) ? `not while ${status.state}` : mayCommand(status) ? "" : `'${status.operator.name}' is operator`;
}

/** Return whether all letters of `query` occur in `text` in this order. */
function matches(query, text) {
  let at = -1;
  return [...query.toLowerCase().replaceAll(" ", "")].every((letter) => (at = text.toLowerCase().indexOf(letter, at + 1)) >= 0);
}

const field = make("input", { type: "text", placeholder: "what to do", role: "combobox", "aria-label": "action", "aria-expanded": "true", "aria-controls": "actions", autocomplete: "off" });
const list = make("ul", { id: "actions", role: "listbox", "aria-label": "actions" });
const dialog = make("dialog", { id: "palette", "aria-label": "actions" }, field, list);
document.querySelector("main").append(dialog);
let shown = [], chosen = 0, before = null; // listed actions, index of the chosen one, element that had the focus

function show() {
  shown = [...ACTIONS, ...experiments].filter(({ title }) => matches(field.value, title));
  chosen = Math.max(0, Math.min(chosen, shown.length - 1));
  list.replaceChildren(...shown.map((action, number) => {
    const reason = reasonAgainst(action);
    const item = make("li", { id: `action-${number}`, role: "option", "aria-selected": String(number === chosen), "aria-disabled": String(reason !== "") },
      action.title, reason && make("span", { className: "small" }, ` ${reason}`));
    item.addEventListener("click", () => carryOut(number));
    return item;
  }));
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
  experiments = all.map((one) => ({ title: `Experiment ${one.name.replaceAll("_", " ")}: ${one.title}`, run: async () => (await import("../run/run.js")).openExperiment(one.name) }));
  if (dialog.open) show();
}

field.addEventListener("input", () => { chosen = 0; show(); });
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
$("tools").prepend(button("⌘", open, { title: "All actions (Ctrl+K)", "aria-label": "all actions" }));
