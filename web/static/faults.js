// Faults: what is wrong and what to do, who did what, and, in the virtual lab, faults on purpose.
import { $, ask, make, mayCommand, note, onStatus, press } from "./station.js";
import { actButton } from "./acts.js";
import { form, schemas, variants } from "./form.js";
import { isOpen, onTab } from "./tabs.js";

const now = make("div", { "aria-live": "polite" }), log = make("table");

const bench = await ask("GET", "/api/bench");
const kinds = await ask("GET", "/api/faults");
const kind = make("select", { "aria-label": "fault" }, ...kinds.map((one) => make("option", { value: one.kind }, one.kind.replaceAll("_", " "))));
const device = make("select", { "aria-label": "device" });
const value = make("input", { type: "number", step: "any", min: 0, "aria-label": "size" }), valueUnit = make("span", { className: "unit" });
const lasts = make("input", { type: "number", step: "any", min: 0.01, value: 2, "aria-label": "duration [s]", placeholder: "for ever" });
const inject = make("button", { type: "submit" }, "Inject"), mend = make("button", { type: "button" }, "Clear faults");
const row = (label, control, unitText) => [make("label", {}, label), control, unitText instanceof Node ? unitText : make("span", { className: "unit" }, unitText)];
const sizeRow = row("size", value, valueUnit);
const lab = make("form", {}, make("fieldset", {}, make("legend", {}, "Let a simulated device fail"),
  make("div", { className: "rows" }, ...row("fault", kind, ""), ...row("device", device, ""), ...sizeRow, ...row("for", lasts, "s")),
  make("div", { className: "acts" }, inject, mend)));

function choose() {
  const chosen = kinds.find((one) => one.kind === kind.value);
  device.replaceChildren(...chosen.devices.map((one) => make("option", { value: one }, one.replaceAll("_", " "))));
  value.disabled = chosen.most === null;
  for (const cell of sizeRow) cell.hidden = value.disabled;
  value.required = chosen.most !== null;
  value.max = chosen.most ?? "";
  value.value = chosen.most === null ? "" : Math.min(0.05, chosen.most);
  valueUnit.textContent = chosen.most === null ? "" : `${chosen.unit}, at most ${chosen.most}`;
  lasts.disabled = !chosen.lasts;
}
kind.addEventListener("change", choose);
choose();
lab.addEventListener("submit", async (event) => {
  event.preventDefault();
  const fault = { kind: kind.value, device: device.value };
  if (!value.disabled) fault.value = Number(value.value);
  if (!lasts.disabled && lasts.value !== "") fault.duration = Number(lasts.value);
  if (await press("POST", "/api/faults", { faults: [fault] })) note(`injected: ${fault.kind.replaceAll("_", " ")}, ${fault.device}`, true);
});
mend.addEventListener("click", () => press("DELETE", "/api/faults"));

// A finger on the shaft: the controller takes every load for one at the tip, and the station says where it is not.
const contact = form(variants(await schemas(), (await schemas()).PullIn.properties.load).contact,
  { values: { magnitude: 0.3, place: 0.1, direction: [0, 1, 0] } });
const letGo = make("button", { type: "button" }, "Let go");
const finger = make("form", {}, make("fieldset", {}, make("legend", {}, "Touch the simulated shaft"), contact.element,
  make("div", { className: "acts" }, make("button", { type: "submit" }, "Touch"), letGo)));
finger.addEventListener("submit", async (event) => {
  event.preventDefault();
  if (await press("POST", "/api/pull", { load: contact.read() })) note("touched; a moment later the scene shows where it is felt", true);
});
letGo.addEventListener("click", () => press("POST", "/api/pull", { load: { kind: "none" } }));

lab.hidden = finger.hidden = !bench.virtual;
$("faults").append(make("h3", {}, "Now"), now, lab, finger, make("h3", {}, "Log: commands and refusals"), log);

onStatus((status, stale) => {
  if (status === null) { now.dataset.shown = ""; now.replaceChildren(make("p", {}, "The station does not answer. Use the emergency stop of the bench.")); return; }
  const troubles = Object.entries(status.devices).filter(([, one]) => one.severity > 0 || one.text !== "");
  const shown = JSON.stringify([status.state, status.says, status.next, status.warnings, troubles, mayCommand(status)]);
  for (const button of [inject, mend, ...finger.querySelectorAll("button")]) button.disabled = stale || !mayCommand(status);
  if (now.dataset.shown === shown) return;
  now.dataset.shown = shown;
  now.replaceChildren(...[
    make("p", {}, make("b", { "data-state": status.state }, status.state), ` ${status.says}`),
    status.next === "" ? null : make("p", {}, "What to do: ", make("b", {}, status.next)),
    ...status.warnings.map((text) => make("p", { className: "mind" }, `▲ ${text}`)),
    ...troubles.map(([name, one]) => make("p", {}, make("i", { className: "light", "data-severity": one.severity, style: "display:inline-block" }), ` ${name}: ${one.text || one.condition}`)),
    actButton(status),
  ].filter((one) => one !== null));
});

async function refresh() {
  if (!isOpen("faults")) return;
  try {
    const entries = await ask("GET", "/api/log?count=60", undefined, 1000);
    log.replaceChildren(make("tr", {}, ...["time", "who", "what", "outcome"].map((one) => make("th", {}, one))),
      ...entries.map((one) => make("tr", {}, make("td", { className: "time" }, new Date(one.time).toLocaleTimeString()), make("td", { title: one.where }, one.who), make("td", { className: "any" }, one.what), make("td", { className: "any" }, one.outcome))));
  } catch {
    return; // the header says that nobody answers
  }
}
setInterval(refresh, 1000);
onTab("faults", refresh);
