// Waypoints: places taught where the tip is, typed or from a file, in a table; drawn, and tried on the model before they start.
import { $, ask, latest, make, mayCommand, onStatus, Refused } from "./station.js";
import { inPageUnits, tidy } from "./units.js";
import { add, addRow, canUndo, change, edit, located, move, onPlaces, origin, remove, rows, spread, undo, wrong } from "./places.js";
import { fileOf, parsed, UNITS } from "./places_csv.js";
import { drawing } from "./places_drawing.js";

const AGAIN = 300; // ms without a change, before it is tried
const MM = 1e-3;
/** Joints nearer than this are those of the start [rad, m]. */
const NEAR = { rad: 0.01, m: 5e-4 };
const HEADS = ["time s", "x mm", "y mm", "z mm"];

/** As a cell has it: seconds in the first column, millimetres in the others. */
const written = (value, column) => (Number.isFinite(value) ? tidy(Number((column ? value / MM : value).toFixed(3))) : "");

const button = (text, title, act, named = {}) => {
  const one = make("button", { type: "button", title, ...named }, text);
  one.addEventListener("click", act);
  return one;
};

const bench = await ask("GET", "/api/bench");
let shown = null; // the table that is on the page

/**
 * A field of the form: {element, read() in SI, unable(), again(): try it anew}; the element tells of each change by an event `places`.
 * `rest()` are the motion's other fields and its controller; `goThere(title, pose, wish)` asks, then goes to a pose.
 */
export function waypoints(rest, goThere) {
  const body = make("tbody"), says = make("p", { className: "small", role: "status" }), picture = make("div");
  const speed = make("input", { type: "number", min: 0.1, max: 20, step: "any", value: 5, required: true, "aria-label": "speed from place to place" });
  const here = make("button", { type: "button", className: "main" }, "Add this place"), back = make("button", { type: "button" }, "Undo");
  const away = make("span", { className: "small mind" }), go = make("button", { type: "button" }, "Go to the start…");
  const there = make("p", { className: "acts", style: "margin:8px 0 0" }, away, go);
  const unit = make("select", { "aria-label": "unit of a file that names none" }, ...Object.keys(UNITS).map((one) => make("option", { value: one }, one)));
  const file = make("input", { type: "file", accept: ".csv,text/csv,text/plain", "aria-label": "CSV file of waypoints" });
  let tried = null, number = 0, timer = null;

  const metresPerSecond = () => Number(speed.value) * MM;
  const element = make("div", { className: "teach" },
    make("div", { className: "acts", style: "margin:0 0 8px" }, here, button("Add a row", "add a row, to be filled in", () => { addRow(metresPerSecond()); focus(rows().length - 1, 0); }), back),
    make("table", { className: "places", "aria-label": "waypoints, relative to the tip at the start" },
      make("thead", {}, make("tr", {}, make("th", {}, "#"), ...HEADS.map((head) => make("th", {}, head)), make("th"))), body),
    says, there, picture,
    make("div", { className: "acts" }, make("label", {}, "speed ", speed, " mm/s"), button("Times from speed", "times from the speed, for all places", () => { if (speed.reportValidity()) spread(metresPerSecond()); })),
    make("div", { className: "acts small" }, make("label", {}, "CSV ", file), make("label", {}, "in ", unit), button("Save as CSV", "save the table as a CSV file", download)));

  here.addEventListener("click", () => add(latest().tip_measured, latest().joints, metresPerSecond()));
  back.addEventListener("click", undo);
  go.addEventListener("click", () => goThere("Go to the start?", origin().joints, { joints: origin().joints }));
  file.addEventListener("change", async () => {
    if (file.files.length === 0) return;
    const found = parsed(await file.files[0].text(), unit.value);
    file.value = ""; // the same file may be taken again
    if (found.wrong) say(found.wrong, true); else change({ rows: found.rows, origin: null });
  });

  function say(text, mind) {
    says.textContent = text;
    says.classList.toggle("mind", mind);
  }

  function focus(row, column) { body.querySelectorAll("tr.place")[row]?.querySelectorAll("input, button")[column]?.focus(); }

  function line(values, i) {
    const cells = values.map((value, k) => {
      const input = make("input", { type: "number", step: "any", required: true, "aria-label": `place ${i + 1} ${HEADS[k]}` });
      input.value = written(value, k);
      input.addEventListener("change", () => edit(i, k, input.value === "" ? NaN : Number(input.value) * (k ? MM : 1)));
      return make("td", {}, input);
    });
    const shift = (by) => { move(i, by); focus(i + by, 4 + (by > 0 ? 1 : 0)); };
    const sign = (text, label, act) => button(text, label, act, { "aria-label": label });
    const up = sign("↑", `place ${i + 1} up`, () => shift(-1)), down = sign("↓", `place ${i + 1} down`, () => shift(1));
    up.disabled = i === 0;
    down.disabled = i === rows().length - 1;
    const drop = sign("×", `delete place ${i + 1}`, () => { remove(i); focus(Math.min(i, rows().length - 1), 6); });
    return make("tr", { className: "place" }, make("td", { className: "dim" }, String(i + 1)), ...cells, make("td", { className: "order" }, up, down, drop));
  }

  /** What the table says now; as long as there are as many rows they stay, and what has the focus keeps it. */
  function fill() {
    const old = [...body.querySelectorAll("tr.place")];
    if (old.length !== rows().length) body.replaceChildren(...rows().map(line));
    else old.forEach((row, i) => row.querySelectorAll("input").forEach((input, k) => { input.value = written(rows()[i][k], k); }));
    back.disabled = !canUndo();
    tried = null;
    mark();
    clearTimeout(timer);
    timer = setTimeout(tryIt, AGAIN);
    element.dispatchEvent(new Event("places"));
  }

  /** What is wrong with a row stands below it; the way is drawn. */
  function mark() {
    const fault = wrong(), bad = fault?.row ?? (tried?.possible === false ? tried.place : null), text = fault?.text ?? tried?.reason ?? "";
    for (const old of body.querySelectorAll(".why")) old.remove();
    body.querySelectorAll("tr.place").forEach((row, i) => {
      row.classList.toggle("bad", i === bad);
      row.setAttribute("aria-invalid", String(i === bad));
      if (i === bad) row.after(make("tr", { className: "why" }, make("td"), make("td", { colSpan: 5 }, `✗ ${inPageUnits(text)}${tried?.instead ? `; ${tried.instead}` : ""}`)));
    });
    if (rows().length === 0) say("No place yet: move the tip (tab Jog) and add it, add a row, or load a file. The first place is the start; all others count from it.", false);
    else if (fault !== null) say(`place ${fault.row + 1} is not complete`, true);
    else if (tried === null) say("being tried on the model …", false);
    else if (tried.possible) say(`✓ on the model the tip gets to ${rows().length === 1 ? "it" : `all ${rows().length}`} in ${tidy(rows().at(-1)[0])} s`, false);
    else say(bad === null ? inPageUnits(text) : `✗ the tip does not get to place ${bad + 1}`, true);
    const usable = rows().filter((row) => row.every(Number.isFinite)).map(([, ...place]) => place);
    picture.replaceChildren(...(usable.length === 0 ? [] : [drawing(usable, tried?.path ?? [], bad)]));
  }

  async function tryIt() {
    if (rows().length === 0 || wrong() !== null || !element.isConnected) return;
    const mine = ++number;
    let found = null;
    try {
      found = await ask("POST", "/api/try", { points: rows(), ...rest(), ...(origin() === null ? {} : { start: origin().joints }) });
    } catch (error) {
      found = { possible: false, place: null, reason: error instanceof Refused ? error.message : `it could not be tried: ${error.message}`, instead: "", path: [] };
    }
    if (mine !== number) return;
    tried = found;
    mark();
  }

  function download() {
    const link = make("a", { href: URL.createObjectURL(new Blob([fileOf(rows())], { type: "text/csv" })), download: "waypoints.csv" });
    link.click();
    URL.revokeObjectURL(link.href);
  }

  /** Whether the robot stands where the first place was added: that is where the motion would begin. */
  function compare(status) {
    const start = origin(), tip = status?.tip_measured ?? null, rests = status?.state === "READY";
    const near = start === null || status === null || bench.joints.every(({ name, unit: si }) => Math.abs(status.joints[name] - start.joints[name]) < NEAR[si]);
    if (start !== null && start.tip === null && near && rests && tip !== null) located(tip);
    const lost = origin() !== null && origin().tip === null;
    here.disabled = tip === null || lost || !rests;
    here.title = tip === null ? "the tip is not measured now" : lost ? "go to the start first: what is added counts from there" : rests ? "where the tip is measured now" : "while READY";
    there.hidden = near;
    go.disabled = !rests || !mayCommand(status);
    if (near) return;
    const off = lost || tip === null ? "The robot is" : `The tip is ${(Math.hypot(...tip.map((part, i) => part - origin().tip[i])) / MM).toFixed(1)} mm`;
    const text = `▲ ${off} away from the start; a motion that begins here has all its places shifted.`;
    if (away.textContent !== text) away.textContent = text;
  }

  shown = { fill, compare };
  fill();
  compare(latest());
  /** Why it cannot be started; empty when it can. */
  const unable = () => (rows().length === 0 ? "add a place first" : wrong() === null ? "" : `place ${wrong().row + 1} is not complete`);
  return { element, unable, read: rows, again: tryIt };
}

onPlaces(() => shown?.fill());
onStatus((status, stale) => { if (!$("start").hidden) shown?.compare(stale ? null : status); });
