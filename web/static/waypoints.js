// Waypoints typed or from a CSV file: the same text and the same unit in both, relative to the start tip.
import { make } from "./station.js";
import { tidy } from "./units.js";

/** Millimetres in one of each. */
const UNITS = { mm: 1e-3, m: 1 };
const NAMES = ["time", "x", "y", "z"];

/** Rows of numbers, or what is wrong with the first line that is not four of them. */
function parsed(text) {
  const rows = [];
  for (const [number, line] of text.split("\n").map((one) => one.trim()).entries()) {
    if (line === "" || line.startsWith("#") || (rows.length === 0 && /^\W*(time|t)\b/i.test(line))) continue;
    const cells = line.split(/\s*[,;\t]\s*|\s+/).filter((cell) => cell !== ""), values = cells.map(Number);
    const bad = values.findIndex((value) => !Number.isFinite(value));
    if (bad >= 0) return { wrong: `line ${number + 1}: '${cells[bad].slice(0, 20)}' is no number; a line is time, x, y, z` };
    if (values.length !== NAMES.length) return { wrong: `line ${number + 1}: ${values.length} numbers; a line is time [s], x, y, z` };
    const before = rows.at(-1)?.[0] ?? 0;
    if (rows.length ? values[0] <= before : values[0] <= 0 && values.slice(1).some((value) => value !== 0))
      return { wrong: `line ${number + 1}: time ${values[0]} s does not come after ${before} s` };
    rows.push(values);
  }
  return rows.length ? { rows } : { wrong: "no waypoint yet: a line is time [s], x, y, z" };
}

/** The unit that a file's first line names ("time [s], x [mm], ..." or "x_mm"), or null. */
const named = (text) => /^\W*(?:time|t)\b.*?[\s,[(_]x[\s,[(_]*(mm|m)\b/i.exec(text.split("\n").find((line) => line.trim() !== "" && !line.startsWith("#")) ?? "")?.[1].toLowerCase() ?? null;

/** A field for the grid: elements, and how to read it in SI. */
export function waypoints(label, value, text) {
  const area = make("textarea", { rows: 5, required: true, spellcheck: false, "aria-label": `${label}: time, x, y, z` });
  const chosen = make("select", { "aria-label": "unit of x, y, z" }, ...Object.keys(UNITS).map((one) => make("option", { value: one }, one)));
  const file = make("input", { type: "file", accept: ".csv,text/csv,text/plain", "aria-label": "CSV file of waypoints" });
  const says = make("div", { className: "small dim", role: "status" });
  area.value = (value ?? []).map((row) => row.map((x, i) => tidy(i ? x / UNITS.mm : x)).join(", ")).join("\n");
  area.style.width = "100%";
  const look = () => {
    const { rows, wrong } = parsed(area.value);
    area.setCustomValidity(wrong ?? "");
    const far = rows && Math.max(...rows.map(([, ...place]) => Math.hypot(...place))) * UNITS[chosen.value];
    says.textContent = wrong ?? `${rows.length} point${rows.length === 1 ? "" : "s"} in ${tidy(rows.at(-1)[0])} s, up to ${tidy(Number((1e3 * far).toPrecision(4)))} mm from the start tip`;
    says.classList.toggle("mind", wrong !== undefined);
  };
  area.addEventListener("input", look);
  chosen.addEventListener("change", look);
  file.addEventListener("change", async () => {
    if (file.files.length === 0) return;
    area.value = (await file.files[0].text()).trim();
    const unit = named(area.value);
    if (unit !== null) chosen.value = unit;
    look();
  });
  look();
  const read = () => parsed(area.value).rows.map(([time, ...place]) => [time, ...place.map((x) => x * UNITS[chosen.value])]);
  const all = make("div", { className: "all" },
    make("label", { title: text }, `${label}: a line each, time [s], x, y, z in `, chosen, " relative to the tip at the start"), area, says,
    make("label", { className: "small dim" }, "or a CSV file, the same lines in the same unit: ", file));
  return { elements: [all], read };
}
