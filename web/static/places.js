// The places that the tip is to go through, as they are being made: rows of time and offsets, where they count from, and undo.
const KEY = "places";

/**
 * `rows`: [time [s], x, y, z [m]]; `origin`: {tip [m], joints} of the start, once a place was added where the robot stood,
 * or null; its tip is null until the robot stands where a saved motion begins.
 */
let now = kept() ?? { rows: [], origin: null };
const past = [], listeners = [];

function kept() {
  try { return JSON.parse(sessionStorage.getItem(KEY)); } catch { return null; }
}

/** Call `listener()` whenever something has changed. */
export const onPlaces = (listener) => { listeners.push(listener); };
export const rows = () => now.rows;
export const origin = () => now.origin;
export const canUndo = () => past.length > 0;

function become(next) {
  now = next;
  sessionStorage.setItem(KEY, JSON.stringify(now));
  for (const listener of listeners) listener();
}

/** Something else from now on; what was is kept for undo. */
export function change(next) {
  past.push(now);
  become({ ...now, ...next });
}

/** The robot stands at the start: so that is where its tip is [m]. */
export function located(tip) {
  now = { ...now, origin: { ...now.origin, tip } };
  sessionStorage.setItem(KEY, JSON.stringify(now));
}

export function undo() {
  if (past.length > 0) become(past.pop());
}

const distance = (a, b) => Math.hypot(...a.map((part, i) => part - b[i]));
/** No way takes less [s]. */
const SHORTEST = 0.5;
const took = (from, to, speed) => Math.max(SHORTEST, distance(from, to) / speed);
const tidyTime = (time) => Number(time.toFixed(2));

/** The tip stands at `tip` [m] with these `joints`: another place, gone to at `speed` [m/s]. The first one is where all begins. */
export function add(tip, joints, speed) {
  const from = now.origin ?? { tip, joints }, place = tip.map((part, i) => Number((part - from.tip[i]).toFixed(6)));
  change({ rows: [...now.rows, [next(place, speed), ...place]], origin: from });
}

/** One more row, at the last place, to be filled in. */
export function addRow(speed) {
  const place = now.rows.at(-1)?.slice(1) ?? [0, 0, 0];
  change({ rows: [...now.rows, [next(place, speed), ...place]] });
}

function next(place, speed) {
  const last = now.rows.at(-1);
  if (last === undefined) return place.some((part) => part !== 0) ? tidyTime(took([0, 0, 0], place, speed)) : 0;
  return tidyTime(last[0] + took(last.slice(1), place, speed));
}

export const edit = (row, column, value) => change({ rows: now.rows.map((one, i) => (i === row ? one.with(column, value) : one)) });
export const remove = (row) => change({ rows: now.rows.filter((_, i) => i !== row), origin: now.rows.length > 1 ? now.origin : null });

/** A place goes before or after its neighbour; the times stay in their order. */
export function move(row, by) {
  const to = row + by;
  if (to < 0 || to >= now.rows.length) return;
  const places = now.rows.map(([, ...place]) => place);
  [places[row], places[to]] = [places[to], places[row]];
  change({ rows: now.rows.map(([time], i) => [time, ...places[i]]) });
}

/** Times with which the tip goes from place to place at a mean `speed` [m/s]. */
export function spread(speed) {
  let time = 0, before = [0, 0, 0];
  change({ rows: now.rows.map(([, ...place], i) => {
    if (i > 0 || place.some((part) => part !== 0)) time += took(before, place, speed);
    before = place;
    return [tidyTime(time), ...place];
  }) });
}

/** What is wrong with the first row that cannot be: {row, text}; null when nothing is. */
export function wrong() {
  for (const [i, [time, ...place]] of now.rows.entries()) {
    if (![time, ...place].every(Number.isFinite)) return { row: i, text: "a number is missing" };
    const before = now.rows[i - 1]?.[0] ?? 0;
    if (i === 0 && time <= 0 && place.some((part) => part !== 0)) return { row: i, text: "a time above 0 s is needed for the way there from the start" };
    if (i === 0 ? time < 0 : time <= before) return { row: i, text: `time ${time} s does not come after ${before} s` };
  }
  return null;
}
