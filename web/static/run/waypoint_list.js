// The edited list of waypoints: rows of time and offset, their origin, undo, and the list as a CSV file.
import { schemas, variants } from "../page/form.js";
import { stored, tidy } from "../page/station.js";
import { session } from "../page/storage.js";

const KEY = "places";
const all = await schemas();
/** Largest number of waypoints of a motion, and size of a file that they never exceed [bytes]. */
const { maxItems: MAX_ROWS, "x-max-bytes": MAX_BYTES } = variants(all, all.Start.properties.trajectory).waypoints.properties.points;
const REMEDY = "Remove some, or divide the motion into several";

/** Return why a list cannot have this number of rows; empty if it can. */
const refusal = (count) => (count <= MAX_ROWS ? "" : `${count} waypoints are too many; at most ${MAX_ROWS} are possible. ${REMEDY}.`);

/**
 * `rows`: [time [s], x, y, z [m]]; `origin`: {tip [m], joints} at the start, or null. `origin` is set when a waypoint is
 * added at the robot's pose. For a loaded motion `origin.tip` is null until the robot is at the start.
 */
const kept = stored(KEY);
let list = kept === null || refusal(kept.rows.length) !== "" ? { rows: [], origin: null } : kept;
const history = [], listeners = [];

/** Call `listener()` after each change. */
export const onChange = (listener) => { listeners.push(listener); };
export const rows = () => list.rows;
export const origin = () => list.origin;
export const canUndo = () => history.length > 0;

function replaceList(next) {
  list = next;
  session.set(KEY, JSON.stringify(list));
  for (const listener of listeners) listener();
}

/** Change the list and keep the previous one for undo. Return why the change is refused; empty if the list has changed. */
export function change(next) {
  const reason = refusal(next.rows.length);
  if (reason !== "") return reason;
  history.push(list);
  replaceList({ ...list, ...next });
  return "";
}

/** Set the tip's position at the start [m], called when the robot is at the start. */
export function setStartTip(tip) {
  list = { ...list, origin: { ...list.origin, tip } };
  session.set(KEY, JSON.stringify(list));
}

export function undo() {
  if (history.length > 0) replaceList(history.pop());
}

const distance = (a, b) => Math.hypot(...a.map((part, i) => part - b[i]));
/** Shortest time between two waypoints [s]. */
const MIN_DURATION_S = 0.5;
const duration = (from, target, speed) => Math.max(MIN_DURATION_S, distance(from, target) / speed);
const tidyTime = (time) => Number(time.toFixed(2));

/** Add a waypoint at `tip` [m] with these `joints`, reached at `speed` [m/s]; return as `change` does. The first one sets the origin. */
export function add(tip, joints, speed) {
  const from = list.origin ?? { tip, joints }, position = tip.map((part, i) => Number((part - from.tip[i]).toFixed(6)));
  return change({ rows: [...list.rows, [timeOf(position, speed), ...position]], origin: from });
}

/** Add a row at the last waypoint's position, which the user then edits; return as `change` does. */
export function addRow(speed) {
  const position = list.rows.at(-1)?.slice(1) ?? [0, 0, 0];
  return change({ rows: [...list.rows, [timeOf(position, speed), ...position]] });
}

function timeOf(position, speed) {
  const last = list.rows.at(-1);
  if (last === undefined) return position.some((part) => part !== 0) ? tidyTime(duration([0, 0, 0], position, speed)) : 0;
  return tidyTime(last[0] + duration(last.slice(1), position, speed));
}

export const edit = (row, column, value) => change({ rows: list.rows.with(row, list.rows[row].with(column, value)) });
export const remove = (row) => change({ rows: list.rows.filter((_, i) => i !== row), origin: list.rows.length > 1 ? list.origin : null });

/** Swap a waypoint with its neighbour; the times keep their order. */
export function move(row, by) {
  const target = row + by;
  if (target < 0 || target >= list.rows.length) return;
  const positions = list.rows.map(([, ...position]) => position);
  [positions[row], positions[target]] = [positions[target], positions[row]];
  change({ rows: list.rows.map(([time], i) => [time, ...positions[i]]) });
}

/** Set the times for a mean `speed` between waypoints [m/s]. */
export function setTimes(speed) {
  let time = 0, before = [0, 0, 0];
  change({ rows: list.rows.map(([, ...position], i) => {
    if (i > 0 || position.some((part) => part !== 0)) time += duration(before, position, speed);
    before = position;
    return [tidyTime(time), ...position];
  }) });
}

/** Return the first invalid row and its error: {row, text}; null if all rows are valid. */
export function firstError() {
  for (const [i, [time, ...position]] of list.rows.entries()) {
    if (![time, ...position].every(Number.isFinite)) return { row: i, text: "a number is missing" };
    const before = list.rows[i - 1]?.[0] ?? 0;
    if (i === 0 && time <= 0 && position.some((part) => part !== 0)) return { row: i, text: "the motion from the start to this waypoint needs a time above 0 s" };
    if (i === 0 ? time < 0 : time <= before) return { row: i, text: `time ${time} s must be later than the ${i === 0 ? "start, 0" : `previous row's ${before}`} s` };
  }
  return null;
}

// ---- waypoints as a CSV file, one per line: time [s], x, y, z relative to the tip at the start, in millimetres or metres

export const UNITS = { mm: 1e-3, m: 1 };
const NAMES = ["time", "x", "y", "z"];

/**
 * Return {rows} of a file in SI, or {wrong}: why the file is refused, with its first invalid line. `unit` is the unit of
 * positions in a file that names none. Its size is checked before it is read, and its rows are counted before parsing.
 */
export async function readCsv(file, unit) {
  if (file.size > MAX_BYTES) return { wrong: `The file has ${file.size} bytes; at most ${MAX_BYTES} are possible, enough for ${MAX_ROWS} waypoints. ${REMEDY}.` };
  const text = await file.text(), lines = text.split("\n").map((line) => line.trim());
  const wrong = refusal(lines.filter((line) => /^[-+.\d]/.test(line)).length); // every row starts with a number
  if (wrong !== "") return { wrong };
  const rows = [], scale = UNITS[unitOf(text) ?? unit];
  for (const [number, line] of lines.entries()) {
    if (line === "" || line.startsWith("#") || (rows.length === 0 && /^\W*(time|t)\b/i.test(line))) continue;
    const cells = line.split(/\s*[,;\t]\s*|\s+/).filter((cell) => cell !== ""), values = cells.map(Number);
    const bad = values.findIndex((value) => !Number.isFinite(value));
    if (bad >= 0) return { wrong: `line ${number + 1}: '${cells[bad].slice(0, 20)}' is not a number; a line is time, x, y, z` };
    if (values.length !== NAMES.length) return { wrong: `line ${number + 1}: ${values.length} numbers; a line is time [s], x, y, z` };
    rows.push(values.map((value, i) => (i === 0 ? value : value * scale)));
  }
  return rows.length ? { rows } : { wrong: "the file has no waypoint: a line is time [s], x, y, z" };
}

/** Return the unit in a file's first line ("time [s], x [mm], ..." or "x_mm"), or null. */
const unitOf = (text) => /^\W*(?:time|t)\b.*?[\s,[(_]x[\s,[(_]*(mm|m)\b/i.exec(text.split("\n").find((line) => line.trim() !== "" && !line.startsWith("#")) ?? "")?.[1].toLowerCase() ?? null;

/** Return the CSV text of `rows` (SI). */
export const csvOf = (rows) => ["time [s], x [mm], y [mm], z [mm]",
  ...rows.map(([time, ...position]) => [time, ...position.map((part) => part / UNITS.mm)].map(tidy).join(", "))].join("\n") + "\n";
