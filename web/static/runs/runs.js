// History: recorded runs by day with their errors; title, star, tags, notes, replay, report, export, comparison, deletion.
import { $, blockReason, button, confirm, dateTime, enable, latest, make, note, onStatus, request, sendCommand, Refused } from "../page/station.js";
import { head, isOpen, onPlace, onTab, openTab, showing } from "../page/tabs.js";
import { address, card, changedSettings, comparison, durationOf, ended, errorSummary, flat, folded, outcomeOf, readable, SHAPES, thumbnail } from "./result.js";
import { local } from "../page/storage.js";

const date = (seconds) => new Date(1000 * seconds);
const day = (seconds) => date(seconds).toLocaleDateString(undefined, { weekday: "long", year: "numeric", month: "long", day: "numeric" });
const time = (seconds) => date(seconds).toLocaleTimeString(undefined, { hour: "2-digit", minute: "2-digit", hourCycle: "h23" });
const when = (seconds) => `${day(seconds)}, ${time(seconds)}`;
const sizeText = (bytes) => (bytes > 1e6 ? `${(bytes / 1e6).toFixed(1)} MB` : `${Math.ceil(bytes / 1e3)} kB`);

/** Orders of the list: comparison of two runs in the first direction of the heading that is pressed. */
const distance = (run, which) => Math.max(-1, ...Object.values(run.outcomes).map((one) => one[which]));
const seconds = (run) => Object.values(run.outcomes).reduce((sum, one) => sum + (one.duration ?? 0), 0);
const ORDERS = {
  time: (a, b) => b.started - a.started,
  title: (a, b) => titleOf(a).localeCompare(titleOf(b)),
  length: (a, b) => seconds(b) - seconds(a),
  "largest [mm]": (a, b) => distance(b, "largest_distance") - distance(a, "largest_distance"),
  "RMS [mm]": (a, b) => distance(b, "rms_distance") - distance(a, "rms_distance"),
};
let order = "time", turned = false;
const titleOf = (run) => run.title || run.experiment || run.id;

const options = (all) => all.map(([value, text]) => make("option", { value }, text));
const search = make("input", { type: "text", maxLength: 200, placeholder: "search title, tag, cause or notes", "aria-label": "search", style: "flex:1" });
const label = make("select", { "aria-label": "which runs" }, ...options([["", "all"], ["starred", "★ starred"], ...Object.keys(SHAPES).map((one) => [one, outcomeOf({ label: one })]), ["deleted", "deleted"]]));
const compare = button("Compare two", () => compareRuns([...chosen]));

/** Show the comparison of two runs. */
async function compareRuns(ids) {
  const runs = await Promise.all(ids.map((id) => request("GET", `/api/runs/${encodeURIComponent(id)}`))).catch((error) => { note(error.message); return null; });
  if (runs === null) return overview();
  chosen.clear();
  showing("runs", ids.join("/"));
  content.replaceChildren(head("all runs", overview), comparison(runs));
}

const removeChosen = button("Delete…", () => remove(found.filter((run) => chosen.has(run.id))), { className: "danger" });
const selection = make("div", { className: "acts", style: "margin:0 0 8px" }, make("span", { className: "small dim" }), compare, removeChosen);
const list = make("div", { className: "cards" }), content = make("div");
const chosen = new Set();
$("runs").append(content);

let shown = "", found = [];
async function refresh() {
  if (!isOpen("runs") || !content.contains(list)) return;
  try {
    const deleted = label.value === "deleted", ending = label.value in SHAPES ? label.value : "";
    const all = await request("GET", `/api/runs?limit=200&deleted=${deleted}&label=${ending}&text=${encodeURIComponent(search.value)}`, undefined, 3000);
    found = all.filter((run) => label.value !== "starred" || run.starred).sort(ORDERS[order]);
    if (turned) found.reverse();
    if (shown === (shown = JSON.stringify([found, deleted, order, turned]))) return;
    for (const id of chosen) if (!found.some((run) => run.id === id)) chosen.delete(id);
    list.replaceChildren(...(found.length ? [headings()] : []), ...rows(deleted));
    if (found.length === 0) list.append(make("p", { className: "dim" }, search.value || label.value ? "No run matches." : "No run has been recorded yet: start one in the tab Run."));
    showSelection();
  } catch (error) {
    if (error instanceof Refused) note(error.message);
  }
}

/** Return the headings of the columns, whose buttons sort the list; a second press turns the order. */
function headings() {
  const heading = (name) => button(`${name}${name === order ? (turned ? " ▲" : " ▼") : ""}`, () => {
    turned = name === order && !turned;
    order = name;
    refresh();
  }, { "aria-pressed": String(name === order), title: name.includes("mm") ? `sort by the ${name.split(" ")[0]} error` : `sort by ${name}` });
  const [time, title, length, ...errors] = Object.keys(ORDERS).map(heading);
  return make("div", { className: "run-head small" }, make("span", {}, time, title, length), ...errors);
}

/** Return the newest run before `run` that is like it: of the same experiment, or of the same kind of motion. */
function before(run, all) {
  const kind = (one) => one.experiment || one.title.split(/[,;]/)[0];
  return all.find((one) => one.started < run.started && kind(one) === kind(run)) ?? null;
}

/** Return the rows of all runs; in order of time each day has a heading. */
function rows(deleted) {
  let last = "";
  const byTime = [...found].sort(ORDERS.time);
  return found.flatMap((run) => {
    const heading = order === "time" && day(run.started) !== last ? [make("h3", { className: "day" }, last = day(run.started))] : [];
    return [...heading, deleted ? deletedRow(run) : row(run, before(run, byTime))];
  });
}

function showSelection() {
  selection.hidden = found.length === 0 || label.value === "deleted";
  selection.firstChild.textContent = chosen.size === 0 ? "Tick two runs to compare them" : `${chosen.size} chosen`;
  // The buttons are always visible: the first tick must not move the rows under the pointer.
  enable(compare, chosen.size === 2 ? "" : `Tick two runs; ${chosen.size} ticked now`);
  mayRemove();
}

function describe(run, older = null) {
  const clock = order === "time" ? time(run.started) : dateTime(date(run.started)), title = run.starred ? `★ ${titleOf(run)}` : titleOf(run);
  return make("div", {},
    make("b", { title }, title),
    make("span", {}, make("span", { className: `mark ${run.label}`, title: ended(run), ...(run.label === "complete" && { role: "img", "aria-label": "complete" }) }, run.label === "complete" ? SHAPES.complete : ended(run)), [clock, durationOf(run)].filter((text) => text !== "").map((text) => ` · ${text}`).join(""), older && make("span", {}, " · ", changedSettings(run, older))),
    run.tags.length === 0 ? null : make("span", {}, ...run.tags.map((tag) => make("i", { className: "tag" }, tag))),
    run.notes === "" ? null : make("span", {}, `“${run.notes.split("\n")[0]}”`));
}

function row(run, older) {
  const box = make("input", { type: "checkbox", checked: chosen.has(run.id), "aria-label": `choose ${titleOf(run)}, ${when(run.started)}` });
  box.addEventListener("change", () => {
    if (box.checked) chosen.add(run.id); else chosen.delete(run.id);
    showSelection();
  });
  const [most, rms] = errorSummary(run);
  const open = make("button", { type: "button", className: "card run", title: run.id, onclick: () => details(run.id) }, thumbnail(run), describe(run, older),
    make("span", { className: "number", title: "largest distance of the tip from its desired position [mm]" }, most),
    make("span", { className: "number", title: "root mean square of that distance [mm]" }, rms));
  return make("div", { className: "run-row" }, box, open);
}

const deletedRow = (run) => make("div", { className: "card run" }, describe(run), button("Restore", () => restore([run.id])));

async function restore(ids) {
  for (const id of ids) await sendCommand("POST", address(id, "restore"), {});
  refresh();
}

/** Ask, then delete runs; a note offers to undo it, and the list of deleted runs does so for a day. */
async function remove(runs) {
  const total = sizeText(runs.reduce((sum, run) => sum + run.size, 0));
  const names = runs.slice(0, 8).map((run) => make("li", {}, `${titleOf(run)}, ${when(run.started)}`));
  if (runs.length > 8) names.push(make("li", {}, `and ${runs.length - 8} more`));
  const title = runs.length === 1 ? "Delete this run?" : `Delete ${runs.length} runs?`;
  if (!await confirm(title, "Delete", make("ul", {}, ...names), make("p", {}, `Recording, report and notes (${total}) can be restored for a day: choose 'deleted' in the list.`))) return;
  const deleted = [];
  for (const { id } of runs) {
    if (await sendCommand("DELETE", `/api/runs/${encodeURIComponent(id)}?confirm=${encodeURIComponent(id)}`)) deleted.push(id);
  }
  if (deleted.length) note(deleted.length === 1 ? "the run is deleted" : `${deleted.length} runs are deleted`, true, button("Undo", () => restore(deleted)));
  for (const id of deleted) chosen.delete(id);
  overview();
}

function overview() {
  shown = "";
  showing("runs", "");
  content.replaceChildren(make("div", { className: "acts", style: "margin:0 0 8px" }, search, make("label", {}, "show ", label)), selection, list);
  showSelection();
  refresh();
}

/**
 * Keep the unsaved text of `area` in this browser under a name. Return {element: shows whether text is unsaved,
 * saved(text): to be called when the station has stored the text}.
 */
function draft(area, name) {
  const key = `draft ${name}`, element = make("span", { className: "small mind", role: "status" });
  let stored = area.value;
  const show = () => {
    const isUnsaved = area.value !== stored;
    element.textContent = isUnsaved ? "not saved yet; kept in this browser" : "";
    if (isUnsaved) local.set(key, area.value); else local.remove(key);
  };
  area.value = local.get(key) ?? stored;
  area.addEventListener("input", show);
  show();
  return { element, saved: (text) => { stored = text; show(); } };
}

/** The button that deletes the shown run; null if no run is shown. */
let removal = null;
function mayRemove() {
  enable(removeChosen, blockReason(latest()) || (chosen.size === 0 ? "Tick the runs to delete" : ""));
  if (removal !== null) enable(removal, blockReason(latest()));
}
onStatus(mayRemove);

/** Show the page of a run. */
async function details(id) {
  let run;
  try {
    run = await request("GET", `/api/runs/${encodeURIComponent(id)}`);
  } catch (error) {
    note(error.message);
    if (!content.hasChildNodes()) overview();
    return;
  }
  showing("runs", id);
  const notes = make("textarea", { rows: 3, value: run.notes, "aria-label": "notes", style: "width:100%" });
  const title = make("input", { type: "text", maxLength: 120, value: run.title, "aria-label": "title" });
  const tags = make("input", { type: "text", value: run.tags.join(", "), placeholder: "tags, separated by commas", "aria-label": "tags" });
  const unsaved = draft(notes, `notes ${id}`);
  const save = button("Save notes", async () => {
    const text = notes.value, listed = [...new Set(tags.value.split(",").map((tag) => tag.trim()).filter((tag) => tag !== ""))];
    if (await sendCommand("PUT", address(id, "notes"), { notes: text, title: title.value.trim(), tags: listed })) { unsaved.saved(text); note("notes are saved", true); }
  });
  const star = button(run.starred ? "★ starred" : "☆ star", async () => {
    if (await sendCommand("PUT", address(id, "notes"), { starred: !run.starred })) details(id);
  }, { "aria-pressed": String(run.starred) });
  removal = enable(button("Delete…", () => remove([run]), { className: "danger" }), blockReason(latest()));
  const summary = { ...run.summary, started: when(run.started) };
  content.replaceChildren(
    head("all runs", overview, titleOf(run)),
    card(run, (time) => page(id, "replay", time)),
    make("p", { className: "small dim" }, `${when(run.started)} · ${sizeText(run.size)} · `, make("span", { style: "white-space:nowrap" }, id)),
    make("div", { className: "acts" }, button("Replay", () => page(id, "replay"), { className: "main" }), button("Report", () => page(id, "report")),
      run.cases.length === 1 ? button("Run again", async () => (await import("../run/run.js")).runAgain(id), { title: "Start a run with the same settings" }) : null, star),
    ...downloads(run), ...run.videos.map((camera) => video(run, camera)),
    make("h3", {}, "Notes"), make("div", { className: "rows" }, make("label", {}, "title"), make("div", { className: "wide" }, title), make("label", {}, "tags"), make("div", { className: "wide" }, tags)), notes,
    make("div", { className: "acts" }, save, removal, unsaved.element),
    folded("All numbers", () => flat(summary).map(([key, value]) => make("tr", {}, make("td", { className: "any" }, key), make("td", { className: "any", style: "text-align:right" }, readable(value)))), "numbers"),
  );
}

/** Formats in which a recording can be downloaded, with their programs and about how many bytes a number takes. */
const FORMATS = { csv: ["CSV", 12], parquet: ["Parquet", 3], mat: ["MATLAB", 5] };
const RATES = [500, 250, 100, 50, 10];

/** Return a line with the downloads of each case of a run; none if nothing was recorded. */
const downloads = (run) => run.cases.map((one) => {
  const whole = make("a", { href: `${address(run.id, "recording")}?case=${encodeURIComponent(one)}`, download: "" }, `${one}.mcap`);
  const choice = make("details", { className: "download" }, make("summary", {}, "Download as CSV, Parquet or MATLAB …"));
  choice.addEventListener("toggle", async () => {
    if (!choice.open || choice.children.length > 1) return;
    try { choice.append(downloadForm(run, one, await request("GET", `${address(run.id, "channels")}?case=${encodeURIComponent(one)}`))); } catch (error) { note(error.message); }
  });
  return make("div", { className: "small" }, make("p", {}, run.cases.length > 1 ? `${one.replaceAll("_", " ")}: ` : "Recording: ", whole), choice);
});

/** Return the choice of format, rate and numbers of a download, with its size before the press. */
function downloadForm(run, name, { fields, ticks }) {
  const format = make("select", { "aria-label": "format" }, ...options(Object.entries(FORMATS).map(([one, [program]]) => [one, program])));
  const rate = make("select", { "aria-label": "rows a second" }, ...options(RATES.map((one) => [one, `${one} rows/s`])));
  const boxes = Object.entries(fields).map(([field, { columns, meaning }]) => ({ field, columns, box: make("input", { type: "checkbox", checked: true, value: field }), meaning }));
  const size = make("span", { className: "dim", role: "status" }), link = make("a", { className: "button main", download: "", onclick: () => note("The station writes the file. The download starts when the file is complete.", true) }, "Download");
  const show = () => {
    const chosen = boxes.filter(({ box }) => box.checked), count = chosen.reduce((sum, one) => sum + one.columns, 0), rows = Math.ceil((ticks * rate.value) / RATES[0]);
    const [, bytes] = FORMATS[format.value];
    size.textContent = `${count + 1} columns, ${rows} rows, about ${sizeText(bytes * rows * (count + 1))}`;
    const query = new URLSearchParams({ format: format.value, case: name, rate: rate.value });
    if (chosen.length < boxes.length) query.set("fields", chosen.map(({ field }) => field).join(","));
    link.href = `${address(run.id, "export")}?${query}`;
    link.hidden = count === 0;
  };
  const set = (wanted) => { for (const one of boxes) one.box.checked = wanted(one.field); show(); };
  const form = make("div", {}, make("div", { className: "acts" }, format, rate, link, size),
    make("div", { className: "acts" }, button("All numbers", () => set(() => true)), button("Tip, force and joints", () => set((field) => USUAL.includes(field)), { title: USUAL.join(", ").replaceAll("_", " ") }), button("None", () => set(() => false))),
    make("div", { className: "fields" }, ...boxes.map(({ field, box, meaning }) => make("label", { title: meaning }, box, field.replaceAll("_", " ")))), make("p", { className: "dim" }, "SI units; the first column is the time since the start of the motion."));
  form.addEventListener("change", show);
  show();
  return form;
}
const USUAL = ["time", "joints", "tip_measured", "tip_desired", "tip_true", "tip_estimated", "force", "force_true"];

/** Return a folded video of a camera; it is requested when it is unfolded. */
function video(run, camera) {
  const source = `${address(run.id, "video")}?camera=${encodeURIComponent(camera)}`;
  const folding = make("details", { className: "video" }, make("summary", {}, `Video of camera ${camera}`));
  folding.addEventListener("toggle", () => {
    if (!folding.open || folding.children.length > 1) return;
    folding.append(make("video", { controls: true, muted: true, src: source, "aria-label": `video of camera ${camera}` }), make("a", { href: source, download: "" }, `${camera}.mp4`));
  });
  return folding;
}

/** Open the page of a run from another tab. */
export function showRun(id) {
  openTab("runs");
  details(id);
}

// ---- pages of a run, over the live scene; the header with STOP stays

function page(id, what, time = null) {
  const close = button("‹ live scene", () => cover.remove(), { className: "main" });
  const wait = make("span", { className: "dim" }, `${what} of ${id}; the first request takes some seconds …`);
  const frame = make("iframe", { src: `${address(id, what)}${time === null ? "" : `#t=${time.toFixed(2)}`}`, title: `${what} of ${id}` });
  const cover = make("div", { id: "cover" }, make("div", { className: "acts" }, close, wait), frame);
  frame.addEventListener("load", () => { wait.textContent = `${what} of ${id}: this is not live`; });
  $("cover")?.remove();
  $("left").append(cover);
}

search.addEventListener("input", refresh);
label.addEventListener("change", refresh);
setInterval(refresh, 2000);
onTab("runs", refresh);
const isShown = onPlace("runs", (place) => {
  const ids = place.split("/");
  if (place === "") overview(); else if (ids.length > 1) compareRuns(ids.slice(0, 2)); else details(place);
});
if (!isShown) overview();
