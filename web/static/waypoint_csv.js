// Waypoints as a CSV file, one per line: time [s], x, y, z relative to the tip at the start, in millimetres or metres.
import { tidy } from "./units.js";

export const UNITS = { mm: 1e-3, m: 1 };
const NAMES = ["time", "x", "y", "z"];

/** Return {rows} in SI, or {wrong}: the error of the first invalid line; `unit` is the unit of positions in a file that names no unit. */
export function parseCsv(text, unit) {
  const rows = [], scale = UNITS[unitOf(text) ?? unit];
  for (const [number, line] of text.split("\n").map((one) => one.trim()).entries()) {
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
