// Faults: what is wrong and what to do, the log of commands, and fault injection in the virtual lab.
import { $, blockReason, button, enable, make, mayCommand, note, onStatus, pastNotes, replaceChanged, request, rigAnswer, sendCommand, timeOfDay } from "../page/station.js";
import { actionButton } from "../page/header.js";
import { form, refuse, row, schemas, variants } from "../page/form.js";
import { numberField } from "../page/number.js";
import { poll } from "../page/tabs.js";

const summary = make("div", { "aria-live": "polite" }), log = make("table"), messages = make("table");

const rig = await rigAnswer();
const kinds = await request("GET", "/api/faults");
const kind = make("select", { "aria-label": "fault" }, ...kinds.map((entry) => make("option", { value: entry.kind }, entry.kind.replaceAll("_", " "))));
const device = make("select", { "aria-label": "device" });
const value = numberField("size", null, { min: 0 }), sizeRow = row("size", value), effect = make("p", { className: "small dim" });
const durationInput = numberField("duration [s]", 2, { min: 0.01, placeholder: "unlimited" });
const inject = make("button", { type: "submit" }, "Inject"), clearFaults = button("Clear faults", () => sendCommand("DELETE", "/api/faults"));
const lab = make("form", {}, make("fieldset", {}, make("legend", {}, "Inject a fault into a simulated device"),
  effect, make("div", { className: "rows" }, ...row("fault", kind), ...row("device", device), ...sizeRow, ...row("for", durationInput, "s")),
  make("div", { className: "acts" }, inject, clearFaults)));

function choose() {
  const chosen = kinds.find((entry) => entry.kind === kind.value);
  device.replaceChildren(...chosen.devices.map((entry) => make("option", { value: entry }, rig.tubes.includes(entry) ? `force sensor, ${entry.replaceAll("_", " ")} tube` : entry === "robot" ? "force sensor under the robot" : entry.replaceAll("_", " "))));
  value.disabled = chosen.most === null;
  for (const cell of sizeRow) cell.hidden = value.disabled;
  value.required = chosen.most !== null;
  value.bounds.max = chosen.most ?? Infinity;
  value.value = chosen.most === null ? "" : Math.min(0.05, chosen.most);
  sizeRow.at(-1).textContent = chosen.most === null ? "" : `${chosen.unit}, at most ${chosen.most}`;
  effect.textContent = chosen.effect;
  durationInput.disabled = !chosen.lasts;
}
kind.addEventListener("change", choose);
choose();
lab.addEventListener("submit", async (event) => {
  event.preventDefault();
  const fault = { kind: kind.value, device: device.value };
  if (!value.disabled) fault.value = value.number;
  if (!durationInput.disabled && durationInput.number !== null) fault.duration = durationInput.number;
  if (await sendCommand("POST", "/api/faults", { faults: [fault] })) note(`injected: ${fault.kind.replaceAll("_", " ")}, ${fault.device}`, true);
});

// Simulated contact on the shaft. The controller assumes a load at the tip; the station detects and locates the contact.
const contact = form(variants(await schemas(), (await schemas()).ApplyLoad.properties.load).contact,
  { values: { magnitude: 0.3, place: 0.1, direction: [0, 1, 0] } });
const contactForm = make("form", {}, make("fieldset", {}, make("legend", {}, "Touch the simulated shaft"), contact.element,
  make("div", { className: "acts" }, make("button", { type: "submit" }, "Touch"),
    button("Remove contact", () => sendCommand("POST", "/api/load", { load: { kind: "none" } })))));
contactForm.addEventListener("submit", async (event) => {
  event.preventDefault();
  if (await sendCommand("POST", "/api/load", { load: contact.read() }, (text) => refuse(contactForm, text))) note("contact applied; the scene shows the estimated position in a moment", true);
});

lab.hidden = contactForm.hidden = !rig.virtual;
$("faults").append(make("h3", {}, "Now"), summary, lab, contactForm, make("h3", {}, "Messages of this page"), messages, make("h3", {}, "Log: commands and refusals"), log);

onStatus((status, stale) => {
  if (status === null) { replaceChanged(summary, null, () => [make("p", {}, "The station does not answer: it has ended, or its computer or the network is too busy. To stop now, use the emergency stop of the rig. Close other pages and programs on its computer.")]); return; }
  const deviceFaults = Object.entries(status.devices).filter(([, entry]) => entry.severity > 0 || entry.text !== "");
  for (const control of [inject, clearFaults, ...contactForm.querySelectorAll("button")]) enable(control, blockReason(status, stale));
  replaceChanged(summary, [status.state, status.message, status.next, status.warnings, deviceFaults, mayCommand(status)], () => [
    make("p", {}, make("b", { "data-state": status.state }, status.state), ` ${status.message}`),
    status.next === "" ? null : make("p", {}, "What to do: ", make("b", {}, status.next)),
    ...status.warnings.map((text) => make("p", { className: "mind" }, `▲ ${text}`)),
    ...deviceFaults.map(([name, entry]) => make("p", {}, make("i", { className: "light", "data-severity": entry.severity, style: "display:inline-block" }), ` ${name}: ${entry.text || entry.condition}`)),
    actionButton(status),
  ]);
});

/** Names of commands as on their buttons, in the log instead of their requests. */
const COMMANDS = {
  "POST /api/start": "Start", "POST /api/stop": "STOP", "POST /api/reset": "Reset", "POST /api/connect": "Connect",
  "POST /api/home": "Home", "POST /api/jog": "Jog", "POST /api/goto": "Go to a pose", "POST /api/tare": "Zero the force sensors",
  "POST /api/load": "Load", "POST /api/faults": "Inject a fault", "DELETE /api/faults": "Clear faults", "POST /api/mark": "Mark",
  "POST /api/operator": "Take control", "DELETE /api/operator": "Release control",
};
const commandName = (what) => what.replace(/^[A-Z]+ \/api\/\w+(?![\w/])/, (sent) => COMMANDS[sent] ?? sent);

const showMessages = () => replaceChanged(messages, pastNotes, () => (pastNotes.length === 0 ? [make("caption", { className: "dim" }, "none yet")]
  : pastNotes.map(({ time, text }) => make("tr", {}, make("td", { className: "time" }, timeOfDay(time)), make("td", { className: "any" }, text)))));
onStatus(showMessages);

poll("faults", "/api/log?count=60", 1000, (entries) => log.replaceChildren(
  make("tr", {}, ...["time", "who", "what", "outcome"].map((entry) => make("th", {}, entry))),
  ...entries.map((entry) => make("tr", {}, make("td", { className: "time" }, timeOfDay(new Date(entry.time))), make("td", { title: entry.where }, entry.who), make("td", { className: "any" }, make("code", { title: entry.what }, commandName(entry.what))), make("td", { className: "any" }, entry.outcome)))));
