// Result of a run: the errors first, then its curves; everything else is folded. And the comparison of two runs.
import { dateTime, inPageUnits, make, request, timeOfDay } from "../page/station.js";
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

/** Return the duration of a run's motion, the sum over its cases; empty if unknown. */
export function durationOf(run) {
  const seconds = Object.values(run.outcomes).map((one) => one.duration);
  return seconds.length === 0 || seconds.includes(null) ? "" : `${readable(Number(seconds.reduce((sum, one) => sum + one, 0).toFixed(1)))} s`;
}

/** Return the axes in which the force of one of the `cases` is unknown, as a text. */
const unknownAxes = (cases) => [...new Set(cases.flatMap(([, one]) => [...one.force_unknown]))].sort().join(", ");

/** Return the stiffness of all palpated places whose value is known [N/m]. */
const known = (press) => press.stiffness.flat().filter((one) => one !== null);

/** Return the map of the stiffness of a palpation: a cell for each place, darker where the tissue is stiffer. */
export function stiffnessMap(press) {
  const [low, high] = [Math.min(...known(press)), Math.max(...known(press))];
  const place = (value, row, column) => {
    const share = value === null || high === low ? 0 : (value - low) / (high - low);
    const text = value === null ? "unknown" : `${value.toFixed(0)} N/m`;
    return make("td", { style: value === null ? "" : `background:rgb(0 114 178 / ${(0.12 + 0.78 * share).toFixed(2)});color:${share > 0.55 ? "#fff" : "inherit"}`, title: `row ${row + 1}, column ${column + 1}: ${text}` }, value === null ? "–" : value.toFixed(0));
  };
  return make("table", { className: "stiffness-map", "aria-label": "estimated stiffness of each place" }, make("caption", {}, "Stiffness [N/m], estimated"),
    ...press.stiffness.map((values, row) => make("tr", {}, ...values.map((value, column) => place(value, row, column)))));
}

/** Return a run's outcome with its shape, and its cause without addresses, which the numbers of the result contain: [outcome, cause]. */
export function outcomeAndCause(run) {
  return [`${SHAPES[run.label] ?? "○"} ${outcomeOf(run)}`, run.cause.replaceAll(/ \([^()]*:\/\/[^()]*\)/g, "")];
}

/** Return the outcome of a run and its cause in one text; a complete run has no cause, but perhaps a remark. */
export function ended(run) {
  const [outcome, cause] = outcomeAndCause(run);
  return cause === "" || run.label === "complete" ? outcome : cause.startsWith(run.label) ? `${SHAPES[run.label] ?? "○"} ${cause}` : `${outcome}: ${cause}`;
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
  const unknown = unknownAxes(cases);
  const [, first] = cases[0], measured = cases.map(([, one]) => one).filter((one) => one.measured_largest !== null);
  const byTracker = measured.length === 0 ? "" : ` The tracker error was at most ${range(measured.map((one) => one.measured_largest))} mm, RMS ${range(measured.map((one) => one.measured_rms))} mm.`;
  return make("div", {}, make("table", {}, make("tr", {}, ...head), ...rows),
    make("p", { className: "small dim" }, `The ${ERRORS[first.against]} in mm is the distance of ${TIPS[first.against]} from its desired position, from ${readable(first.counted_from)} s on${first.counted_from > 0 ? " (grey: not counted)" : ""}${forces ? `; force: the largest of the whole motion, filtered${unknown ? `; the components along ${unknown} are unknown and left out` : ""}` : ""}.${when}${byTracker}`));
}

/** Return charts with the curves of all `cases`: [[name, curve]]; `onPick(time)` is called with the time of a press. */
function pictures(cases, onPick = null) {
  const lines = (what) => cases.filter(([, one]) => one[what] !== null).map(([name, one]) => ({ name, ...one[what] }));
  const from = Math.min(...cases.map(([, one]) => one.counted_from));
  const marks = cases.flatMap(([, one]) => one.marks), unknown = unknownAxes(cases);
  const cursors = new Set();
  return make("div", {}, curve("Distance from the desired tip", "mm", lines("error"), { from, marks, cursors, onPick, colour: "var(--error)" }), curve(`Force at the tip${unknown ? ` without ${unknown}, unknown` : ""}`, "N", lines("force"), { marks, cursors, onPick, colour: "var(--force)" }),
    onPick && make("p", { className: "small dim" }, "○ largest value that counts. A click opens the replay at that time."));
}

/** Request the curves of a run by case. The first request takes some seconds. */
const curvesOf = (id) => request("GET", address(id, "curves"));

/** Return the card of a run; a press on its curves calls `onPick(time)`. */
export function card(run, onPick) {
  const drawing = make("div", {}, make("p", { className: "small dim" }, run.cases.length ? "loading curves …" : "Nothing was recorded."));
  if (run.cases.length) {
    curvesOf(run.id).then((curvesByCase) => {
      const cases = Object.entries(curvesByCase).map(([name, one]) => [name.replaceAll("_", " "), one]);
      drawing.replaceChildren(...(cases.length ? [pictures(cases, cases.length === 1 ? onPick : null)] : []));
    }).catch((error) => drawing.replaceChildren(make("p", { className: "small dim" }, `no curves: ${error.message}`)));
  }
  const main = run.headline, maps = Object.values(run.outcomes).flatMap((one) => (one.stiffness ? [stiffnessMap(one)] : []));
  const remark = run.label === "complete" && run.cause !== "" ? make("p", { className: "small mind" }, inPageUnits(run.cause)) : null;
  return make("div", { className: "result" }, make("p", { className: `ended ${run.label}` }, ended(run)), remark,
    main && make("p", { className: "headline" }, make("b", {}, main.number), ` ${main.sentence}`), ...maps, numbers(run), drawing);
}

const waiting = new Map(), seen = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) if (isIntersecting) { seen.unobserve(target); waiting.get(target)?.(); waiting.delete(target); }
});
/** Call `show()` when `element` becomes visible, because requests for a whole list would occupy the station. */
function whenVisible(element, show) {
  waiting.set(element, show);
  seen.observe(element);
}

/** Return a small picture of a run's error over time; it stays empty until the run's page has computed its curves. */
export function thumbnail(run) {
  const box = make("span", { className: "thumbnail" });
  if (Object.keys(run.outcomes).length > 0) whenVisible(box, () => request("GET", address(run.id, "curves?stored=true")).then((cases) => {
    const lines = Object.values(cases).flatMap((one) => (one.error === null ? [] : [one.error]));
    if (lines.length > 0) box.append(sparkline(lines));
  }).catch(() => {})); // the list is complete without the picture
  return box;
}

const recordedSettings = new Map(); // by run
const settingsOf = (run) => recordedSettings.get(run.id) ?? recordedSettings.set(run.id, request("GET", address(run.id, `settings?case=${encodeURIComponent(run.cases[0] ?? "")}`))).get(run.id);

/** Return a text with the settings in which a run differs from `older`, a similar run before it. */
export function changedSettings(run, older) {
  const box = make("span", { className: "changed" });
  if (run.cases.length > 0 && older.cases.length > 0) whenVisible(box, () => Promise.all([older, run].map(settingsOf)).then((both) => {
    const changes = changed(both.map(({ settings: { start, ...one } }) => one)).map(([key, before, now]) => `${key.split(" · ").at(-1).replaceAll("_", " ")} ${before === undefined ? "" : `${readable(before)} → `}${readable(now)}`);
    box.textContent = changes.length === 0 ? "same settings as before" : `${changes.slice(0, 2).join(", ")}${changes.length > 2 ? ` and ${changes.length - 2} more` : ""}`;
    box.title = `settings that differ from the run at ${timeOfDay(new Date(1000 * older.started))} (SI units): ${changes.join(", ") || "none"}`;
  }).catch(() => {}));
  return box;
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

/** Return the entries in which two objects differ: [[path, value in the first, value in the second]]. */
function changed(objects) {
  const [a, b] = objects.map((one) => new Map(flat(one)));
  return [...new Set([...a.keys(), ...b.keys()])].filter((key) => a.get(key) !== b.get(key)).map((key) => [key, a.get(key), b.get(key)]);
}

/** Return a table row for each entry in which two objects differ. */
function differences(objects) {
  return changed(objects).map(([key, x, y]) => {
    const difference = typeof x === "number" && typeof y === "number" ? readable(y - x) : "≠";
    return make("tr", {}, make("td", { className: "any", title: key }, key.replaceAll("_", " ")), text(readable(x)), text(readable(y)), text(difference));
  });
}

/** Return a table of the settings in which the first cases of two runs differ. */
function differentSettings(runs) {
  const rows = make("tbody"), element = make("div", {}, make("h3", {}, "Settings that differ (SI units)"), make("table", { className: "settings" }, rows));
  const say = (message) => rows.replaceChildren(make("tr", {}, make("td", { className: "dim" }, message)));
  say("loading …");
  Promise.all(runs.map((run) => request("GET", `${address(run.id, "settings")}?case=${encodeURIComponent(run.cases[0] ?? "")}`))).then((recorded) => {
    const found = differences(recorded.map(({ settings: { format, ...settings }, ...names }) => ({ ...names, ...settings })));
    if (found.length === 0) say("none: both runs have the same settings"); else rows.replaceChildren(make("tr", {}, ...["setting", "1", "2", "2 − 1"].map((one, i) => make("th", { className: i === 0 ? "" : "number" }, one))), ...found);
  }).catch((error) => say(`no settings: ${error.message}`));
  return element;
}

/** Return a line with downloads of the curves of two cases as a figure for a paper. */
function figureLinks(runs, nameA, nameB) {
  const link = (format) => make("a", { download: "", href: `${address(runs[0].id, "figure")}?${new URLSearchParams({ case: nameA, other: runs[1].id, other_case: nameB, format })}` }, format.toUpperCase());
  return make("p", { className: "small figure-links" }, "Download both curves as a figure for a journal's column (88 mm): ", link("pdf"), ", ", link("svg"));
}

function overlaidCurves(runs) {
  const element = make("div", {}, make("p", { className: "small dim" }, "loading their curves …"));
  Promise.all(runs.map((run) => curvesOf(run.id))).then(([a, b]) => {
    const matched = pairs(a, b), choice = make("select", { "aria-label": "case" }, ...matched.map(([nameA]) => make("option", {}, nameA.replaceAll("_", " "))));
    const drawn = make("div");
    const draw = () => {
      const [nameA, nameB] = matched[Math.max(0, choice.selectedIndex)] ?? [];
      drawn.replaceChildren(...(nameA === undefined ? [make("p", { className: "small dim" }, `No curves to compare: ${heading(runs, Object.keys(a).length === 0 ? 0 : 1)} has no recorded motion.`)]
        : [pictures([[heading(runs, 0), a[nameA]], [heading(runs, 1), b[nameB]]]), figureLinks(runs, nameA, nameB)]));
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
