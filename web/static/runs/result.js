// Result of a run: the errors first, then its curves; everything else is folded. And the comparison of two runs.
import { dateTime, make, request, timeOfDay } from "../page/station.js";
import { curve, sparkline } from "../page/chart.js";

export const SHAPES = { complete: "●", stopped: "■", interrupted: "▲", incomplete: "◆" };
/** Outcomes in words; a run that ends in HOLD or FAULT has the outcome "stopped" too. */
export const outcomeOf = (run) => (run.label === "stopped" ? "ended early" : run.label);
const ERRORS = { true: "true error", measured: "tracker error" };
const TIPS = { true: "the true tip of the virtual lab", measured: "the tip that the tracker measures" };
const MAX_LISTED_NUMBERS = 12; // longer lists are shown by their length

export const address = (run, what) => `/api/runs/${encodeURIComponent(run)}/${what}`;
export const readable = (value) => (typeof value === "number" ? String(Number(value.toPrecision(5))) : String(value ?? "–"));
const mm = (value) => (value < 10 ? value.toFixed(2) : value.toFixed(1));

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

/** Return which error the numbers of a run mean: the true one, which only a virtual lab knows, or the tracker's. */
export const errorOf = (run) => ERRORS[Object.values(run.outcomes)[0]?.against ?? "measured"];

/** Return the duration of a run's motion, the sum over its cases; empty if unknown. */
export function durationOf(run) {
  const seconds = Object.values(run.outcomes).map((one) => one.duration);
  return seconds.length === 0 || seconds.includes(null) ? "" : `${readable(Number(seconds.reduce((sum, one) => sum + one, 0).toFixed(1)))} s`;
}

/** Return from which time of the motion the errors of a run count; empty if they count from its start. */
export function countedFrom(run) {
  const from = Math.max(0, ...Object.values(run.outcomes).map((one) => one.counted_from));
  return from > 0 ? ` from ${readable(from)} s on` : "";
}

/** Return the outcome of a run and its cause without addresses, which the numbers of the result contain. */
export function ended(run) {
  const cause = run.cause.replaceAll(/ \([^()]*:\/\/[^()]*\)/g, "");
  return `${SHAPES[run.label] ?? "○"} ${cause === "" ? outcomeOf(run) : cause.startsWith(run.label) ? cause : `${outcomeOf(run)}: ${cause}`}`;
}

function numbers(run) {
  const cases = Object.entries(run.outcomes), many = cases.length > 1;
  if (cases.length === 0) return make("p", { className: "dim" }, "No errors of the tip: the motion did not start, had no path, or ended before the evaluated part.");
  const forces = cases.some(([, one]) => one.force !== null);
  const head = ["", "x", "y", "z", "distance [mm]", ...(forces ? ["force"] : [])].map((text) => make("th", { className: text === "" ? "" : "number" }, text));
  const row = (title, axes, distance, force) => make("tr", {}, cell(title, ""), ...axes.map((x) => cell(mm(x))), cell(make("b", {}, mm(distance))), forces ? cell(force) : null);
  const rows = cases.flatMap(([name, one]) => [
    ...(many ? [make("tr", {}, make("th", { colSpan: head.length }, name.replaceAll("_", " ")))] : []),
    row(`largest ${ERRORS[one.against]}`, one.largest, one.largest_distance, one.force === null ? "–" : `${one.force.toFixed(2)} N`),
    row(`RMS ${ERRORS[one.against]}`, one.rms, one.rms_distance, ""),
  ]);
  const at = cases.filter(([, one]) => one.largest_at !== null).map(([name, one]) => `${many ? `${name.replaceAll("_", " ")} ` : ""}${one.largest_at.toFixed(1)} s`);
  const when = at.length === 0 ? "" : ` Largest distance at ${at.join(", ")}.`;
  const [, first] = cases[0], measured = cases.map(([, one]) => one).filter((one) => one.measured_largest !== null);
  const byTracker = measured.length === 0 ? "" : ` The tracker error was at most ${range(measured.map((one) => one.measured_largest))} mm, RMS ${range(measured.map((one) => one.measured_rms))} mm.`;
  return make("div", {}, make("table", {}, make("tr", {}, ...head), ...rows),
    make("p", { className: "small dim" }, `The ${ERRORS[first.against]} in mm is the distance of ${TIPS[first.against]} from its desired position, from ${readable(first.counted_from)} s on${forces ? "; force: the largest, filtered" : ""}.${when}${byTracker}`));
}

/** Return charts with the curves of all `cases`: [[name, curve]]. */
function pictures(cases) {
  const lines = (what) => cases.filter(([, one]) => one[what] !== null).map(([name, one]) => ({ name, ...one[what] }));
  const from = Math.min(...cases.map(([, one]) => one.counted_from));
  const marks = cases.flatMap(([, one]) => one.marks);
  return make("div", {}, curve("Distance from the desired tip", "mm", lines("error"), from, marks), curve("Force at the tip", "N", lines("force"), 0, marks));
}

/** Request the curves of a run by case. The first request takes some seconds. */
const curvesOf = (id) => request("GET", address(id, "curves"));

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

/**
 * Return a small picture of a run's error over time. It is requested when it becomes visible, and stays empty until the
 * run's page has computed its curves, because computing them for a whole list would occupy a processor.
 */
export function thumbnail(run) {
  const box = make("span", { className: "thumbnail" });
  if (Object.keys(run.outcomes).length > 0) visible.observe(box);
  box.dataset.run = run.id;
  return box;
}

const visible = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    if (!isIntersecting) continue;
    visible.unobserve(target);
    request("GET", address(target.dataset.run, "curves?stored=true")).then((cases) => {
      const lines = Object.values(cases).flatMap((one) => (one.error === null ? [] : [one.error]));
      if (lines.length > 0) target.append(sparkline(lines));
    }).catch(() => {}); // the list is complete without the picture
  }
});

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

// ---- comparison of two runs: their numbers, their curves in one chart, and all other differences

const text = (value) => make("td", { className: "any", style: "text-align:right" }, value);
const signed = (value) => {
  const text = Math.abs(value).toFixed(2);
  return Number(text) === 0 ? text : `${value < 0 ? "−" : "+"}${text}`;
};

/** Return pairs of cases of two runs: cases with the same name, or the first case of each run if no names match. */
function pairs(a, b) {
  const [x, y] = [Object.keys(a), Object.keys(b)], both = x.filter((name) => y.includes(name)).map((name) => [name, name]);
  return both.length || !x.length || !y.length ? both : [[x[0], y[0]]];
}

function numbersOfTwo(runs) {
  const [a, b] = runs.map((run) => run.outcomes);
  const rows = pairs(a, b).flatMap(([nameA, nameB]) => {
    const [x, y] = [a[nameA], b[nameB]], named = nameA === nameB ? nameA : `${nameA}, ${nameB}`;
    const line = (title, p, q, digits = mm) => [title, p === null ? "–" : digits(p), q === null ? "–" : digits(q), p === null || q === null ? "" : signed(q - p)];
    return [
      ...(pairs(a, b).length > 1 ? [[named.replaceAll("_", " "), "", "", ""]] : []),
      line("largest distance", x.largest_distance, y.largest_distance),
      ...["x", "y", "z"].map((axis, i) => line(`largest in ${axis}`, x.largest[i], y.largest[i])),
      line("RMS distance", x.rms_distance, y.rms_distance),
      line("largest distance at [s]", x.largest_at, y.largest_at, readable),
      line("largest force", x.force, y.force, (force) => force.toFixed(2)),
      line("duration [s]", x.duration, y.duration, readable),
    ];
  });
  if (rows.length === 0) rows.push(["largest, RMS", ...runs.map((run) => errorSummary(run).join(", ")), ""]);
  return rows.map(([title, ...values]) => make("tr", {}, make("td", {}, title), ...values.map((value) => cell(value))));
}

/** Return number, title and start of a compared run; two runs with one title differ in their starts, often in the time of day alone. */
function heading(runs, index) {
  const run = runs[index], [day, otherDay] = [run, runs[1 - index]].map((one) => new Date(1000 * one.started).toDateString());
  const start = new Date(1000 * run.started);
  return `${index + 1}: ${run.title || run.experiment || run.id}, ${day === otherDay ? timeOfDay(start) : dateTime(start)}`;
}

/** Return a table row for each entry in which two objects differ. */
function differences(objects) {
  const [a, b] = objects.map((one) => new Map(flat(one)));
  return [...new Set([...a.keys(), ...b.keys()])].filter((key) => a.get(key) !== b.get(key)).map((key) => {
    const [x, y] = [a.get(key), b.get(key)], difference = typeof x === "number" && typeof y === "number" ? readable(y - x) : "≠";
    return make("tr", {}, make("td", { className: "any", title: key }, key.replaceAll("_", " ")), text(readable(x)), text(readable(y)), text(difference));
  });
}

/** Return a table of the settings in which the first cases of two runs differ. */
function differentSettings(runs) {
  const rows = make("tbody"), element = make("div", {}, make("h3", {}, "Settings that differ (SI units)"), make("table", { className: "settings" }, rows));
  const say = (message) => rows.replaceChildren(make("tr", {}, make("td", { className: "dim" }, message)));
  say("loading …");
  Promise.all(runs.map((run) => request("GET", `${address(run.id, "settings")}?case=${encodeURIComponent(run.cases[0] ?? "")}`))).then((recorded) => {
    const found = differences(recorded.map(({ settings, ...names }) => ({ ...names, ...settings })));
    if (found.length === 0) say("none: both runs have the same settings"); else rows.replaceChildren(make("tr", {}, ...["setting", "1", "2", "2 − 1"].map((one, i) => make("th", { className: i === 0 ? "" : "number" }, one))), ...found);
  }).catch((error) => say(`no settings: ${error.message}`));
  return element;
}

function overlaidCurves(runs) {
  const element = make("div", {}, make("p", { className: "small dim" }, "loading their curves …"));
  Promise.all(runs.map((run) => curvesOf(run.id))).then(([a, b]) => {
    const matched = pairs(a, b), choice = make("select", { "aria-label": "case" }, ...matched.map(([nameA]) => make("option", {}, nameA.replaceAll("_", " "))));
    const drawn = make("div");
    const draw = () => {
      const [nameA, nameB] = matched[Math.max(0, choice.selectedIndex)] ?? [];
      drawn.replaceChildren(nameA === undefined ? make("p", { className: "small dim" }, `No curves to compare: ${heading(runs, Object.keys(a).length === 0 ? 0 : 1)} has no recorded motion.`)
        : pictures([[heading(runs, 0), a[nameA]], [heading(runs, 1), b[nameB]]]));
    };
    choice.addEventListener("change", draw);
    choice.hidden = matched.length < 2;
    element.replaceChildren(choice, drawn);
    draw();
  }).catch((error) => element.replaceChildren(make("p", { className: "small dim" }, `no curves: ${error.message}`)));
  return element;
}

/** Return the comparison of two runs, the older one first. */
export function comparison(chosen) {
  const runs = [...chosen].sort((a, b) => a.started - b.started);
  const names = runs.map((_, i) => make("th", { className: "number" }, heading(runs, i)));
  const head = make("tr", {}, make("th", {}, "errors in mm, force in N"), ...names, make("th", { className: "number" }, "2 − 1"));
  const endings = make("tr", {}, make("td", {}, "ended"), ...runs.map((run) => text(ended(run))), make("td", {}, ""));
  return make("div", { className: "result" }, make("table", { id: "comparison" }, head, endings, ...numbersOfTwo(runs)), overlaidCurves(runs),
    differentSettings(runs), folded("All differences of the results", () => differences(runs.map((run) => ({ ...run.summary, label: outcomeOf(run), started: dateTime(new Date(1000 * run.started)) })))));
}
