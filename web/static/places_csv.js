// Places as a CSV file: a line each, time [s], x, y, z relative to the start tip, in millimetres or metres.
import { tidy } from "./units.js";

export const UNITS = { mm: 1e-3, m: 1 };
const NAMES = ["time", "x", "y", "z"];

/** Rows of numbers in SI, or what is wrong with the first line that is not four of them; `unit` is that of a file that names none. */
export function parsed(text, unit) {
  const rows = [], scale = UNITS[named(text) ?? unit];
  for (const [number, line] of text.split("\n").map((one) => one.trim()).entries()) {
    if (line === "" || line.startsWith("#") || (rows.length === 0 && /^\W*(time|t)\b/i.test(line))) continue;
    const cells = line.split(/\s*[,;\t]\s*|\s+/).filter((cell) => cell !== ""), values = cells.map(Number);
    const bad = values.findIndex((value) => !Number.isFinite(value));
    if (bad >= 0) return { wrong: `line ${number + 1}: '${cells[bad].slice(0, 20)}' is no number; a line is time, x, y, z` };
    if (values.length !== NAMES.length) return { wrong: `line ${number + 1}: ${values.length} numbers; a line is time [s], x, y, z` };
    rows.push(values.map((value, i) => (i === 0 ? value : value * scale)));
  }
  return rows.length ? { rows } : { wrong: "no waypoint in it: a line is time [s], x, y, z" };
}

/** The unit that a file's first line names ("time [s], x [mm], ..." or "x_mm"), or null. */
const named = (text) => /^\W*(?:time|t)\b.*?[\s,[(_]x[\s,[(_]*(mm|m)\b/i.exec(text.split("\n").find((line) => line.trim() !== "" && !line.startsWith("#")) ?? "")?.[1].toLowerCase() ?? null;

/** The file of these rows. */
export const fileOf = (rows) => ["time [s], x [mm], y [mm], z [mm]",
  ...rows.map(([time, ...place]) => [time, ...place.map((part) => part / UNITS.mm)].map(tidy).join(", "))].join("\n") + "\n";
