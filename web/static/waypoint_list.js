// The edited list of waypoints: rows of time and offset, their origin, and undo.
const KEY = "places";

/**
 * `rows`: [time [s], x, y, z [m]]; `origin`: {tip [m], joints} at the start, or null. `origin` is set when a waypoint is
 * added at the robot's pose. For a loaded motion `origin.tip` is null until the robot is at the start.
 */
let list = stored() ?? { rows: [], origin: null };
const history = [], listeners = [];

function stored() {
  try { return JSON.parse(sessionStorage.getItem(KEY)); } catch { return null; }
}

/** Call `listener()` after each change. */
export const onChange = (listener) => { listeners.push(listener); };
export const rows = () => list.rows;
export const origin = () => list.origin;
export const canUndo = () => history.length > 0;

function replaceList(next) {
  list = next;
  sessionStorage.setItem(KEY, JSON.stringify(list));
  for (const listener of listeners) listener();
}

/** Change the list and keep the previous one for undo. */
export function change(next) {
  history.push(list);
  replaceList({ ...list, ...next });
}

/** Set the tip's position at the start [m], called when the robot is at the start. */
export function setStartTip(tip) {
  list = { ...list, origin: { ...list.origin, tip } };
  sessionStorage.setItem(KEY, JSON.stringify(list));
}

export function undo() {
  if (history.length > 0) replaceList(history.pop());
}

const distance = (a, b) => Math.hypot(...a.map((part, i) => part - b[i]));
/** Shortest time between two waypoints [s]. */
const MIN_DURATION_S = 0.5;
const duration = (from, target, speed) => Math.max(MIN_DURATION_S, distance(from, target) / speed);
const tidyTime = (time) => Number(time.toFixed(2));

/** Add a waypoint at `tip` [m] with these `joints`, reached at `speed` [m/s]. The first waypoint sets the origin. */
export function add(tip, joints, speed) {
  const from = list.origin ?? { tip, joints }, position = tip.map((part, i) => Number((part - from.tip[i]).toFixed(6)));
  change({ rows: [...list.rows, [timeOf(position, speed), ...position]], origin: from });
}

/** Add a row at the last waypoint's position, which the user then edits. */
export function addRow(speed) {
  const position = list.rows.at(-1)?.slice(1) ?? [0, 0, 0];
  change({ rows: [...list.rows, [timeOf(position, speed), ...position]] });
}

function timeOf(position, speed) {
  const last = list.rows.at(-1);
  if (last === undefined) return position.some((part) => part !== 0) ? tidyTime(duration([0, 0, 0], position, speed)) : 0;
  return tidyTime(last[0] + duration(last.slice(1), position, speed));
}

export const edit = (row, column, value) => change({ rows: list.rows.map((one, i) => (i === row ? one.with(column, value) : one)) });
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
    if (i === 0 ? time < 0 : time <= before) return { row: i, text: `time ${time} s is not after ${before} s` };
  }
  return null;
}
