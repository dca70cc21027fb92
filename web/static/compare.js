// Comparison of two runs: their numbers, their curves in one chart, and all other differences.
import { make } from "./station.js";
import { errorSummary, curvesOf, ended, flat, folded, mm, pictures, readable } from "./result.js";

const text = (value) => make("td", { className: "any", style: "text-align:right" }, value), number = (value) => make("td", { className: "number" }, value);

const signed = (value) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(2)}`;

/** Return pairs of cases of two runs: cases with the same name, or the first case of each run if no names match. */
function pairs(a, b) {
  const [x, y] = [Object.keys(a), Object.keys(b)], both = x.filter((name) => y.includes(name)).map((name) => [name, name]);
  return both.length || !x.length || !y.length ? both : [[x[0], y[0]]];
}

function numbers(runs) {
  const [a, b] = runs.map((run) => run.outcomes);
  const rows = pairs(a, b).flatMap(([nameA, nameB]) => {
    const [x, y] = [a[nameA], b[nameB]], named = nameA === nameB ? nameA : `${nameA}, ${nameB}`;
    const line = (title, p, q, digits = mm) => [title, p === null ? "–" : digits(p), q === null ? "–" : digits(q), p === null || q === null ? "" : signed(q - p)];
    return [
      ...(pairs(a, b).length > 1 ? [[named.replaceAll("_", " "), "", "", ""]] : []),
      line("largest distance", x.largest_distance, y.largest_distance),
      ...["x", "y", "z"].map((axis, i) => line(`largest in ${axis}`, x.largest[i], y.largest[i])),
      line("RMS distance", x.rms_distance, y.rms_distance),
      line("largest force", x.force, y.force, (force) => force.toFixed(2)),
    ];
  });
  if (rows.length === 0) rows.push(["largest, RMS", ...runs.map((run) => errorSummary(run).join(", ")), ""]);
  return rows.map(([title, ...values]) => make("tr", {}, make("td", {}, title), ...values.map(number)));
}

/** Return a table row for each entry in which the summaries of two runs differ. */
function differences(runs) {
  const [a, b] = runs.map((run) => new Map(flat({ ...run.summary, label: run.label })));
  return [...new Set([...a.keys(), ...b.keys()])].filter((key) => a.get(key) !== b.get(key)).map((key) => {
    const [x, y] = [a.get(key), b.get(key)], difference = typeof x === "number" && typeof y === "number" ? readable(y - x) : "≠";
    return make("tr", {}, make("td", { className: "any" }, key), text(readable(x)), text(readable(y)), text(difference));
  });
}

function overlaidCurves(runs) {
  const element = make("div", {}, make("p", { className: "small dim" }, "loading their curves …"));
  Promise.all(runs.map((run) => curvesOf(run.id))).then(([a, b]) => {
    const matched = pairs(a, b), choice = make("select", { "aria-label": "case" }, ...matched.map(([nameA]) => make("option", {}, nameA.replaceAll("_", " "))));
    const drawn = make("div");
    const draw = () => {
      const [nameA, nameB] = matched[Math.max(0, choice.selectedIndex)] ?? [];
      drawn.replaceChildren(nameA === undefined ? make("p", { className: "small dim" }, "There are no curves: one of the runs has no motion.")
        : pictures([[`1: ${runs[0].id}`, a[nameA]], [`2: ${runs[1].id}`, b[nameB]]]));
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
  const names = runs.map((run, i) => make("th", {}, `${i + 1}: ${run.title || run.experiment || run.id}`));
  const head = make("tr", {}, make("th", {}, "errors in mm, force in N"), ...names, make("th", { className: "number" }, "2 − 1"));
  const endings = make("tr", {}, make("td", {}, "ended"), ...runs.map((run) => text(ended(run))), make("td", {}, ""));
  return make("div", { className: "result" }, make("table", { id: "comparison" }, head, endings, ...numbers(runs)), overlaidCurves(runs),
    folded("All differences", () => differences(runs)));
}
