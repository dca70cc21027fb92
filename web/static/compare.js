// Two runs side by side: their numbers, their curves over each other, and what else is different.
import { make } from "./station.js";
import { atOneLook, curvesOf, ended, flat, folded, mm, pictures, readable } from "./result.js";

const text = (value) => make("td", { className: "any", style: "text-align:right" }, value), number = (value) => make("td", { className: "number" }, value);

const signed = (value) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(2)}`;

/** Which cases belong together: those of the same name, else the first of either. */
function pairs(a, b) {
  const [x, y] = [Object.keys(a), Object.keys(b)], both = x.filter((name) => y.includes(name)).map((name) => [name, name]);
  return both.length || !x.length || !y.length ? both : [[x[0], y[0]]];
}

function numbers(runs) {
  const [a, b] = runs.map((run) => run.outcomes);
  const rows = pairs(a, b).flatMap(([one, other]) => {
    const [x, y] = [a[one], b[other]], named = one === other ? one : `${one}, ${other}`;
    const line = (title, p, q, digits = mm) => [title, p === null ? "–" : digits(p), q === null ? "–" : digits(q), p === null || q === null ? "" : signed(q - p)];
    return [
      ...(pairs(a, b).length > 1 ? [[named.replaceAll("_", " "), "", "", ""]] : []),
      line("largest distance", x.largest_distance, y.largest_distance),
      ...["x", "y", "z"].map((axis, i) => line(`largest in ${axis}`, x.largest[i], y.largest[i])),
      line("RMS distance", x.rms_distance, y.rms_distance),
      line("largest force", x.force, y.force, (force) => force.toFixed(2)),
    ];
  });
  if (rows.length === 0) rows.push(["largest, RMS", ...runs.map((run) => atOneLook(run).join(", ")), ""]);
  return rows.map(([title, ...values]) => make("tr", {}, make("td", {}, title), ...values.map(number)));
}

/** All that the summaries say and that is not the same. */
function differences(runs) {
  const [a, b] = runs.map((run) => new Map(flat({ ...run.summary, label: run.label })));
  return [...new Set([...a.keys(), ...b.keys()])].filter((key) => a.get(key) !== b.get(key)).map((key) => {
    const [x, y] = [a.get(key), b.get(key)], apart = typeof x === "number" && typeof y === "number" ? readable(y - x) : "≠";
    return make("tr", {}, make("td", { className: "any" }, key), text(readable(x)), text(readable(y)), text(apart));
  });
}

function overEachOther(runs) {
  const place = make("div", {}, make("p", { className: "small dim" }, "drawing their curves …"));
  Promise.all(runs.map((run) => curvesOf(run.id))).then(([a, b]) => {
    const found = pairs(a, b), choice = make("select", { "aria-label": "case" }, ...found.map(([one]) => make("option", {}, one.replaceAll("_", " "))));
    const drawn = make("div");
    const draw = () => {
      const [one, other] = found[Math.max(0, choice.selectedIndex)] ?? [];
      drawn.replaceChildren(one === undefined ? make("p", { className: "small dim" }, "There is nothing to draw: one of them has no motion.")
        : pictures([[`1: ${runs[0].id}`, a[one]], [`2: ${runs[1].id}`, b[other]]]));
    };
    choice.addEventListener("change", draw);
    choice.hidden = found.length < 2;
    place.replaceChildren(choice, drawn);
    draw();
  }).catch((error) => place.replaceChildren(make("p", { className: "small dim" }, `no curves: ${error.message}`)));
  return place;
}

/** The older one first. */
export function comparison(chosen) {
  const runs = [...chosen].sort((a, b) => a.started - b.started);
  const names = runs.map((run, i) => make("th", {}, `${i + 1}: ${run.title || run.experiment || run.id}`));
  const head = make("tr", {}, make("th", {}, "errors in mm, force in N"), ...names, make("th", { className: "number" }, "2 − 1"));
  const how = make("tr", {}, make("td", {}, "ended"), ...runs.map((run) => text(ended(run))), make("td", {}, ""));
  return make("div", { className: "result" }, make("table", { id: "comparison" }, head, how, ...numbers(runs)), overEachOther(runs),
    folded("Everything that is different", () => differences(runs)));
}
