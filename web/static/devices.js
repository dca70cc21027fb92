// Devices: connect, home, tare, what each knows of itself, raw values, and whether every axis turns the right way.
import { $, ask, latest, make, mayCommand, note, onStatus, press } from "./station.js";
import { home } from "./acts.js";
import { isOpen, onTab } from "./tabs.js";
import { holdable, mayJog } from "./jog.js";
import { unit } from "./units.js";

const bench = await ask("GET", "/api/bench");

const acts = {
  connect: make("button", { type: "button" }, "Connect"),
  home: make("button", { type: "button" }, "Home…"),
  tare: make("button", { type: "button" }, "Zero the force sensors"),
};
const ALLOWED = { connect: ["OFF"], home: ["CONNECTED", "READY"], tare: ["READY"] };
acts.connect.addEventListener("click", () => press("POST", "/api/connect", {}));
acts.home.addEventListener("click", home);
acts.tare.addEventListener("click", async () => { if (await press("POST", "/api/tare", {})) note("the force sensors read zero from here on", true); });
const list = make("div", { className: "live" }), raw = make("table", { className: "live" }), joints = make("div", { className: "jog", style: "grid-template-columns:auto auto 1fr" });
$("devices").append(make("div", { className: "acts", style: "margin:0 0 8px" }, ...Object.values(acts)), list,
  make("h3", {}, "Does every axis turn the right way?"),
  make("p", { className: "small dim" }, "Hold a button for a second or two: the joint moves slowly in its positive direction. The tracker's motion is compared with the model's."),
  joints, make("h3", {}, "Raw values"), raw);

// ---- axis signs

/** Slow enough to let go in time, fast enough to be seen over the tracker's noise. */
const SPEED = { rad: 0.06, m: 0.002 }, LEAST = 0.8e-3; // [m] that the model's tip must have moved

function check(joint, place) {
  const button = make("button", { type: "button", className: "hold" }, `${joint.name.replaceAll("_", " ")} +`);
  const verdict = make("span", { className: "small dim" }, "not tried");
  let before = null; // where the check began; what was too short to tell is gone on with
  for (const press of ["pointerdown", "keydown"]) button.addEventListener(press, () => { before ??= latest(); });
  holdable(button, "joints", () => bench.joints.map((_, i) => (i === place ? SPEED[joint.unit] : 0)), async () => {
    await new Promise((resolve) => setTimeout(resolve, 400)); // the tracker is late
    const from = before, now = latest();
    if (from === null || now === null) return;
    if ([from, now].some((one) => one.tip_measured === null || one.tip_estimated === null)) {
      verdict.textContent = "the tip is not measured now: look at the tracker, then hold the button again";
      before = null;
      return;
    }
    const moved = (key) => now[key].map((x, i) => x - from[key][i]);
    const seen = moved("tip_measured"), expected = moved("tip_estimated");
    const dot = seen.reduce((sum, x, i) => sum + x * expected[i], 0), size = Math.hypot(...seen), model = Math.hypot(...expected);
    const [shown, scale] = unit(joint.unit);
    const far = `${((now.joints[joint.name] - from.joints[joint.name]) * scale).toFixed(1)} ${shown}: tip ${(1e3 * size).toFixed(1)} mm, model ${(1e3 * model).toFixed(1)} mm`;
    if (model >= LEAST) before = null;
    verdict.textContent = model < LEAST ? `${far}; hold longer, or bend the tubes first`
      : dot > 0.7 * size * model ? `✓ right way (${far})` : `✗ not as the model expects (${far}): check the sign of this axis, its wiring and the tracker's frame`;
  });
  onStatus((status, stale) => { button.disabled = !mayJog(status, stale); });
  joints.append(button, verdict, make("span"));
}
bench.joints.forEach(check);

// ---- lists

const shown = (value) => value !== null && typeof value === "object"
  ? Object.entries(value).map(([key, one]) => `${key} ${shown(one)}`).join(", ") : typeof value === "number" ? String(Number(value.toPrecision(6))) : String(value);

function device(one) {
  const light = make("i", { className: "light", "data-severity": one.condition === "connected" ? one.severity : Math.max(1, one.severity), style: "display:inline-block" });
  const rows = Object.entries(one.details).map(([key, value]) => make("tr", {}, make("td", {}, key.replaceAll("_", " ")), make("td", { className: "any" }, shown(value))));
  const details = make("details", { open: opened.has(one.name) }, make("summary", {}, "details"), make("table", {}, ...rows));
  details.addEventListener("toggle", () => { if (details.open) opened.add(one.name); else opened.delete(one.name); });
  return make("fieldset", {}, make("legend", {}, one.name), make("div", {}, light, " ", make("b", {}, one.condition), " ", one.text), details);
}
const opened = new Set();

async function refresh() {
  if (!isOpen("devices")) return;
  try {
    const all = await ask("GET", "/api/devices", undefined, 1000);
    list.replaceChildren(...all.devices.map(device));
    raw.replaceChildren(...Object.entries(all.raw).map(([name, value]) => make("tr", {}, make("td", { className: "any" }, name), make("td", { className: "number" }, value.toFixed(6)))));
  } catch {
    return; // the header says that nobody answers
  }
}
setInterval(refresh, 500);
onTab("devices", refresh);
onStatus((status, stale) => {
  for (const [name, button] of Object.entries(acts)) {
    button.disabled = stale || status === null || !ALLOWED[name].includes(status.state) || !mayCommand(status);
    button.title = button.disabled ? `possible while ${ALLOWED[name].join(" or ")}, for the operator` : "";
  }
});
