// Result of a run: the errors first, then its curves; everything else is folded.
import { request, make } from "./station.js";
import { curve } from "./curve.js";

export const SHAPES = { complete: "●", stopped: "■", interrupted: "▲", incomplete: "◆" };
const AGAINST = { true: "the true tip of the virtual lab", measured: "the tracker" };
const MAX_LISTED_NUMBERS = 12; // longer lists are shown by their length

export const when = (seconds) => new Date(1000 * seconds).toLocaleString();
export const size = (bytes) => (bytes > 1e6 ? `${(bytes / 1e6).toFixed(1)} MB` : `${Math.ceil(bytes / 1e3)} kB`);
export const address = (run, what) => `/api/runs/${encodeURIComponent(run)}/${what}`;
export const readable = (value) => (typeof value === "number" ? String(Number(value.toPrecision(5))) : String(value ?? "–"));
export const mm = (value) => (value < 10 ? value.toFixed(2) : value.toFixed(1));

const cell = (text, className = "number") => make("td", { className }, text);
const range = (values) => {
  const [low, high] = [mm(Math.min(...values)), mm(Math.max(...values))];
  return low === high ? high : `${low} … ${high}`;
};

/** Return the largest and the RMS distance from the desired tip [mm] over all cases, as texts; dashes without cases. */
export function errorSummary(run) {
  const cases = Object.values(run.outcomes);
  return cases.length === 0 ? ["–", "–"] : [range(cases.map((one) => one.largest_distance)), range(cases.map((one) => one.rms_distance))];
}

/** Return the outcome of a run and its cause. */
export const ended = (run) => `${SHAPES[run.label] ?? "○"} ${run.label}${run.cause === "" ? "" : `: ${run.cause}`}`;

function numbers(run) {
  const cases = Object.entries(run.outcomes), many = cases.length > 1;
  if (cases.length === 0) return make("p", { className: "dim" }, "No errors of the tip: the motion did not start, had no path, or ended before the evaluated part.");
  const forces = cases.some(([, one]) => one.force !== null);
  const head = ["", "x", "y", "z", "distance", ...(forces ? ["force"] : [])].map((text) => make("th", { className: text === "" ? "" : "number" }, text));
  const rows = cases.flatMap(([name, one]) => [
    ...(many ? [make("tr", {}, make("th", { colSpan: head.length }, name.replaceAll("_", " ")))] : []),
    make("tr", {}, cell("largest", ""), ...one.largest.map((x) => cell(mm(x))), make("td", { className: "number" }, make("b", {}, mm(one.largest_distance))),
      ...(forces ? [cell(one.force === null ? "–" : `${one.force.toFixed(2)} N`)] : [])),
    make("tr", {}, cell("RMS", ""), ...one.rms.map((x) => cell(mm(x))), make("td", { className: "number" }, make("b", {}, mm(one.rms_distance))),
      ...(forces ? [cell("")] : [])),
  ]);
  const [, first] = cases[0];
  return make("div", {}, make("table", {}, make("tr", {}, ...head), ...rows),
    make("p", { className: "small dim" }, `Errors in mm against ${AGAINST[first.against]}, from ${readable(first.counted_from)} s on${forces ? "; force: the largest, filtered" : ""}.`));
}

/** Return charts with the curves of all `cases`: [[name, curve]]. */
export function pictures(cases) {
  const lines = (what) => cases.filter(([, one]) => one[what] !== null).map(([name, one]) => ({ name, ...one[what] }));
  const from = Math.min(...cases.map(([, one]) => one.counted_from));
  return make("div", {}, curve("Distance from the desired tip", "mm", lines("error"), from), curve("Force at the tip", "N", lines("force")));
}

/** Request the curves of a run by case. The first request takes some seconds. */
export const curvesOf = (id) => request("GET", address(id, "curves"));

/** Return the card of a run. */
export function card(run) {
  const drawing = make("div", {}, make("p", { className: "small dim" }, run.cases.length ? "loading curves …" : "Nothing was recorded."));
  if (run.cases.length) {
    curvesOf(run.id).then((curvesByCase) => {
      const cases = Object.entries(curvesByCase).map(([name, one]) => [name.replaceAll("_", " "), one]);
      drawing.replaceChildren(...(cases.length ? [pictures(cases)] : []));
    }).catch((error) => drawing.replaceChildren(make("p", { className: "small dim" }, `no curves: ${error.message}`)));
  }
  return make("div", { className: "result" }, make("p", { className: `ended ${run.label}` }, ended(run)), numbers(run), drawing);
}

/** Flatten a nested summary: [[path, value]]; a long list becomes its length. */
export function flat(value, path = "") {
  if (Array.isArray(value) && value.every((one) => one === null || typeof one !== "object")) {
    return [[path, value.length > MAX_LISTED_NUMBERS ? `${value.length} numbers` : value.map(readable).join(", ")]];
  }
  if (value === null || typeof value !== "object") return [[path, value]];
  return Object.entries(value).flatMap(([key, one]) => flat(one, path === "" ? key : `${path} · ${key}`));
}

/** Return a folded table; its rows are created when it is opened. */
export function folded(title, rows, id = "") {
  const details = make("details", { id }, make("summary", {}, title));
  details.addEventListener("toggle", () => {
    if (details.open && details.children.length === 1) details.append(make("table", {}, ...rows()));
  });
  return details;
}
