// Table of waypoints: added at the tip, typed, or loaded from a file; drawn, and checked on the model before the start.
import { $, blockReason, button, enable, inPageUnits, latest, make, onStatus, request, rigAnswer, setText, tidy, Refused } from "../page/station.js";
import { step, svg } from "../page/chart.js";
import { add, addRow, canUndo, change, csvOf, edit, firstError, move, onChange, origin, readCsv, remove, rows, setStartTip, setTimes, undo, UNITS } from "./waypoint_list.js";
import { numberField } from "../page/number.js";

const CHECK_DELAY_MS = 300; // time without a change after which the path is checked [ms]
const PAGE_ROWS = 100; // rows of the table that are shown at once, because thousands of rows would block the page
const MM = 1e-3, DECIMALS = 3; // of seconds and millimetres in the table
/** The robot counts as at the start pose if each joint is at most this far from its start position [rad, m]. */
const NEAR_START = { rad: 0.01, m: 5e-4 };
const COLUMN_TITLES = ["time s", "x mm", "y mm", "z mm"];

/** Format a value for a cell: seconds in the first column, millimetres in the others. */
const cellText = (value, column) => (Number.isFinite(value) ? tidy(Number((column ? value / MM : value).toFixed(DECIMALS))) : "");

const rig = await rigAnswer();
let table = null; // the table shown on the page
let checking = new AbortController(); // ends the check of an outdated path, which may take the station seconds

/** Speed between waypoints until the user chooses another one [m/s]. */
const USUAL_SPEED = 5 * MM;

/** Add a waypoint at the measured tip, as the button of the table does; return what was done, or why not. */
export const addHere = () => add(latest().tip_measured, latest().joints, USUAL_SPEED) || `waypoint ${rows().length} is added`;

/**
 * Return a form field: {element, read() in SI, blockedReason(), recheck()}. The element sends an event `places` at each
 * change. `rest()` returns the motion's other fields and its controller. `goThere(title, pose, body)` moves the robot to a
 * pose after the user's confirmation.
 */
export function waypoints(rest, goThere) {
  const body = make("tbody"), message = make("p", { className: "small", role: "status" }), picture = make("div");
  const speed = numberField("speed between waypoints", USUAL_SPEED / MM, { min: 0.1, max: 20, required: true });
  const addButton = button("Add waypoint here", () => added(add(latest().tip_measured, latest().joints, metresPerSecond())), { className: "main", title: "at the measured position of the tip" }), undoButton = button("Undo", undo);
  const offsetWarning = make("span", { className: "small mind" });
  const goButton = button("Go to the start…", () => goThere("Go to the start?", origin().joints, { joints: origin().joints }));
  const startBox = make("p", { className: "acts", style: "margin:8px 0 0" }, offsetWarning, goButton);
  const unit = make("select", { "aria-label": "unit of a file without units" }, ...Object.keys(UNITS).map((item) => make("option", { value: item }, item)));
  const file = make("input", { type: "file", accept: ".csv,text/csv,text/plain", "aria-label": "CSV file of waypoints" });
  const shownRows = make("span", { "aria-live": "polite" });
  const turn = (text, by) => button(text, () => { showRow((first + by * PAGE_ROWS + pagesEnd()) % pagesEnd()); }, { "aria-label": `${text} ${PAGE_ROWS} waypoints` });
  const pager = make("div", { className: "acts small" }, turn("previous", -1), shownRows, turn("next", 1));
  let checkResult = null, timer = null, first = 0; // `first`: index of the first shown row
  let refused = ""; // why the last file or row was refused, shown until the table changes

  const metresPerSecond = () => speed.number * MM;
  const element = make("div", { className: "teach" },
    make("div", { className: "acts", style: "margin:0 0 8px" }, addButton, button("Add a row", () => { if (added(addRow(metresPerSecond()))) focus(rows().length - 1, 0); }, { title: "add a row to fill in" }), undoButton),
    make("table", { className: "places", "aria-label": "waypoints, relative to the tip at the start" },
      make("thead", {}, make("tr", {}, make("th", {}, "#"), ...COLUMN_TITLES.map((head) => make("th", {}, head.replace(/^[xyz]/, "Δ$&"))), make("th"))), body),
    pager, message, startBox, picture,
    make("div", { className: "acts" }, make("label", {}, "speed ", speed, " mm/s"), button("Times from speed", () => { if (speed.reportValidity()) setTimes(metresPerSecond()); }, { title: "compute the times of all waypoints from the speed" })),
    make("div", { className: "acts small" }, make("label", {}, "CSV ", file), make("label", {}, "in ", unit), button("Save as CSV", download, { title: "save the table as a CSV file" })));

  file.addEventListener("change", async () => {
    if (file.files.length === 0) return;
    const result = await readCsv(file.files[0], unit.value);
    file.value = ""; // needed so that the user can load the same file again
    if (result.wrong) { refuse(result.wrong); return; }
    first = 0;
    change({ rows: result.rows, origin: null });
  });

  function refuse(reason) { refused = reason; showCheck(); }

  /** Show the row that was added, or the `reason` why it was not; return whether it was added. */
  function added(reason) {
    if (reason === "") showRow(rows().length - 1); else refuse(reason);
    return reason === "";
  }

  /** Return the index after the last row of the last page. */
  const pagesEnd = () => PAGE_ROWS * Math.max(1, Math.ceil(rows().length / PAGE_ROWS));

  /** Show the page of the table that contains a row. */
  function showRow(row) {
    first = row - row % PAGE_ROWS;
    fillPage();
    showCheck();
  }

  function showMessage(text, isWarning) {
    message.textContent = text;
    message.classList.toggle("mind", isWarning);
  }

  function focus(row, column) {
    showRow(Math.max(0, row));
    body.querySelectorAll("tr.place")[row - first]?.querySelectorAll("input, button")[column]?.focus();
  }

  function line(values, i) {
    const cells = values.map((value, k) => {
      const input = numberField(`waypoint ${i + 1} ${COLUMN_TITLES[k]}`, null, { required: true });
      input.value = cellText(value, k);
      input.addEventListener("change", () => edit(i, k, (input.number === null ? NaN : Number(input.number.toFixed(DECIMALS))) * (k ? MM : 1)));
      return make("td", {}, input);
    });
    const shift = (by) => { move(i, by); focus(i + by, 4 + (by > 0 ? 1 : 0)); };
    const smallButton = (text, label, onclick, reason = "") => enable(button(text, onclick, { title: label, "aria-label": label }), reason);
    return make("tr", { className: "place" }, make("td", { className: "dim" }, String(i + 1)), ...cells, make("td", { className: "order" },
      smallButton("↑", `waypoint ${i + 1} up`, () => shift(-1), i === 0 ? "This waypoint is the first" : ""), smallButton("↓", `waypoint ${i + 1} down`, () => shift(1), i === rows().length - 1 ? "This waypoint is the last" : ""),
      smallButton("×", `delete waypoint ${i + 1}`, () => { remove(i); focus(Math.min(i, rows().length - 1), 6); })));
  }

  /** Fill the page of the table. If it shows the same rows as before, their elements are kept, so that the focus stays. */
  function fillPage() {
    first = Math.min(first, pagesEnd() - PAGE_ROWS);
    const total = rows().length, shown = rows().slice(first, first + PAGE_ROWS), page = `${first} ${total}`;
    if (body.dataset.page !== page) body.replaceChildren(...shown.map((values, i) => line(values, first + i)));
    else body.querySelectorAll("tr.place").forEach((row, i) => row.querySelectorAll("input").forEach((input, k) => {
      if (Number.isFinite(shown[i][k]) || !Number.isNaN(input.number)) input.value = cellText(shown[i][k], k); // a refused text stays
    }));
    body.dataset.page = page;
    pager.hidden = total <= PAGE_ROWS;
    setText(shownRows, `waypoints ${first + 1} to ${first + shown.length} of ${total}`);
  }

  /** Update the table after a change of the list. */
  function fill() {
    fillPage();
    enable(undoButton, canUndo() ? "" : "Nothing to undo");
    checkResult = null;
    refused = "";
    showBadRow();
    checking.abort();
    clearTimeout(timer);
    timer = setTimeout(checkPath, CHECK_DELAY_MS);
    element.dispatchEvent(new Event("places"));
  }

  /** Return the index of the first row with an error; null if there is none. */
  const badRow = () => firstError()?.row ?? (checkResult?.possible === false ? checkResult.place : null);

  /** Show the first row with an error, unless the user is writing in another row. */
  function showBadRow() {
    if (badRow() === null || body.contains(document.activeElement)) showCheck(); else showRow(badRow());
  }

  /** Show the error of a row below this row, and draw the path. */
  function showCheck() {
    const fault = firstError(), bad = badRow(), text = fault?.text ?? checkResult?.reason ?? "";
    for (const oldReason of body.querySelectorAll(".why")) oldReason.remove();
    body.querySelectorAll("tr.place").forEach((row, i) => {
      const isBad = first + i === bad;
      row.classList.toggle("bad", isBad);
      row.setAttribute("aria-invalid", String(isBad));
      if (isBad) row.after(make("tr", { className: "why" }, make("td"), make("td", { colSpan: 5 }, `✗ ${inPageUnits(text)}${checkResult?.instead ? `; ${checkResult.instead}` : ""}`)));
    });
    if (refused !== "") showMessage(refused, true);
    else if (rows().length === 0) showMessage("No waypoint yet: move the tip (tab Jog) and add its position, add a row, or load a file. The first waypoint is the start; all others are relative to it.", false);
    else if (fault !== null) showMessage(`waypoint ${fault.row + 1} is incomplete`, true);
    else if (checkResult === null) showMessage("checking on the model …", false);
    else if (checkResult.possible) showMessage(`✓ according to the model, the tip reaches ${rows().length === 1 ? "it" : `all ${rows().length}, the last one`} at ${tidy(rows().at(-1)[0])} s; the rest of the duration below is a pause`, false);
    else showMessage(bad === null ? inPageUnits(text) : `✗ the tip does not reach waypoint ${bad + 1}`, true);
    const usable = rows().filter((row) => row.every(Number.isFinite)).map(([, ...position]) => position);
    picture.replaceChildren(...(usable.length === 0 ? [] : [drawing(usable, checkResult?.path ?? [], bad)]));
  }

  async function checkPath() {
    checking.abort();
    if (rows().length === 0 || firstError() !== null || !element.isConnected) return;
    const { signal } = checking = new AbortController();
    let result = null;
    try {
      result = await request("POST", "/api/waypoints/check", { points: rows(), ...rest(), ...(origin() === null ? {} : { start: origin().joints }) }, undefined, signal);
    } catch (error) {
      result = { possible: false, place: null, reason: error instanceof Refused ? error.message : `the path could not be checked: ${error.message}`, instead: "", path: [] };
    }
    if (signal.aborted) return;
    checkResult = result;
    showBadRow();
  }

  function download() {
    const link = make("a", { href: URL.createObjectURL(new Blob([csvOf(rows())], { type: "text/csv" })), download: "waypoints.csv" });
    link.click();
    URL.revokeObjectURL(link.href);
  }

  /** Warn if the robot is away from the start pose: waypoints are relative to the tip at the start of the motion. */
  function compareWithStart(status) {
    const start = origin(), tip = status?.tip_measured ?? null, isReady = status?.state === "READY";
    const atStart = start === null || status === null || rig.joints.every(({ name, unit: si }) => Math.abs(status.joints[name] - start.joints[name]) < NEAR_START[si]);
    if (start !== null && start.tip === null && atStart && isReady && tip !== null) setStartTip(tip);
    const startUnknown = origin() !== null && origin().tip === null;
    enable(addButton, status === null ? "The station does not answer" : !isReady ? `Possible while READY, not while ${status.state}` : tip === null ? "The tip is not measured now" : startUnknown ? "Go to the start first: waypoints are relative to it" : "");
    startBox.hidden = atStart;
    enable(goButton, blockReason(status, false, ["READY"]));
    if (atStart) return;
    const far = startUnknown || tip === null ? "" : `${(Math.hypot(...tip.map((part, i) => part - origin().tip[i])) / MM).toFixed(1)} mm`;
    setText(offsetWarning, far === "" ? "▲ The robot is not at the start of this list. A motion from here shifts the whole path."
      : `▲ The tip is ${far} from the start of this list. A motion from here shifts the whole path by ${far}.`);
  }

  table = { fill, compare: compareWithStart };
  fill();
  compareWithStart(latest());
  /** Return why the motion cannot start; empty if the motion can start. */
  const blockedReason = () => (rows().length === 0 ? "add a waypoint first" : firstError() === null ? "" : `waypoint ${firstError().row + 1} is incomplete`);
  return { element, blockedReason, read: rows, recheck: checkPath };
}

onChange(() => table?.fill());
onStatus((status, stale) => { if (!$("start").hidden) table?.compare(stale ? null : status); });

// ---- drawing of the path, from the side and from above, in one scale

const SIZE = 196, GAP = 12, MARGIN = 20;
/** Views of the drawing: [name, axis to the right, its sign, axis upward, its sign, text]. */
const VIEWS = [["side", 2, 1, 0, -1, "z → x ↓"], ["above", 2, 1, 1, 1, "z → y ↑"]];
/** Largest number of waypoints that are drawn. Of a longer list every n-th, the last and the unreachable one are drawn. */
const MAX_DRAWN = 300;
/** Smallest extent that is drawn [m], so that a short path appears short. */
const MIN_EXTENT_M = 0.004;

/**
 * Draw `positions` (offsets of the waypoints from the start [m]) and the `path` through the waypoints. `bad` is the index
 * of an unreachable waypoint, or null.
 */
function drawing(positions, path, bad) {
  const every = Math.ceil(positions.length / MAX_DRAWN), apart = 6 + 6 * String(positions.length).length;
  const drawn = [...positions.entries()].filter(([k]) => k % every === 0 || k === positions.length - 1 || k === bad);
  const guess = [[0, 0, 0], ...drawn.map(([, position]) => position)], all = [...guess, ...path];
  const low = [0, 1, 2].map((axis) => Math.min(...all.map((one) => one[axis]))), high = [0, 1, 2].map((axis) => Math.max(...all.map((one) => one[axis])));
  const scale = (SIZE - 2 * MARGIN) / Math.max(MIN_EXTENT_M, ...low.map((least, axis) => high[axis] - least));
  const whole = svg("svg", { viewBox: `0 0 ${2 * SIZE + GAP} ${SIZE}`, role: "img", "aria-label": `path through ${positions.length} waypoints, from the side and from above`, class: "way" });
  for (const [i, [name, across, sign, up, sense, axesText]] of VIEWS.entries()) {
    const middle = (axis) => (low[axis] + high[axis]) / 2;
    const at = (position) => [SIZE / 2 + sign * scale * (position[across] - middle(across)), SIZE / 2 - sense * scale * (position[up] - middle(up))];
    const part = svg("g", { transform: `translate(${i * (SIZE + GAP)} 0)` }, svg("rect", { x: 0.5, y: 0.5, width: SIZE - 1, height: SIZE - 1, rx: 6 }));
    part.append(svg("polyline", { points: (path.length > 1 ? path : guess).map((one) => at(one).map((x) => x.toFixed(1)).join(",")).join(" "), class: path.length > 1 ? "" : "guess" }));
    const [x0, y0] = at([0, 0, 0]);
    part.append(svg("path", { d: `M${x0 - 5} ${y0}h10M${x0} ${y0 - 5}v10`, class: "start" }));
    const labelled = positions[bad] === undefined ? [] : [at(positions[bad])];
    for (const [k, position] of drawn) {
      const [x, y] = at(position);
      part.append(svg("circle", { cx: x, cy: y, r: k === bad ? 5 : 3, class: k === bad ? "bad" : "" }));
      // The numbers of waypoints must not overlap. The unreachable waypoint always has its number.
      if (k !== bad && labelled.some(([u, v]) => Math.hypot(x - u, y - v) < apart)) continue;
      labelled.push([x, y]);
      part.append(svg("text", { x: x + 6, y: y - 5, class: k === bad ? "bad" : "" }, k + 1));
    }
    const bar = step((SIZE - 2 * MARGIN) / scale, 3);
    part.append(svg("text", { x: 7, y: 14 }, `${name}: ${axesText}`), svg("path", { d: `M7 ${SIZE - 12}v4h${bar * scale}v-4`, class: "start" }),
      svg("text", { x: 12 + bar * scale, y: SIZE - 6 }, `${Number((1e3 * bar).toPrecision(3))} mm`));
    whole.append(part);
  }
  return whole;
}
