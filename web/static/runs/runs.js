// Runs: recorded runs and their errors, with notes, replay, report, download, and comparison of two runs.
import { $, button, confirm, make, mayCommand, note, onStatus, request, sendCommand, Refused } from "../page/station.js";
import { head, isOpen, onTab, openTab } from "../page/tabs.js";
import { address, card, comparison, errorSummary, flat, folded, readable, SHAPES } from "./result.js";

const when = (seconds) => new Date(1000 * seconds).toLocaleString();
const size = (bytes) => (bytes > 1e6 ? `${(bytes / 1e6).toFixed(1)} MB` : `${Math.ceil(bytes / 1e3)} kB`);

const search = make("input", { type: "text", placeholder: "name, cause or notes", "aria-label": "search", style: "flex:1 1 0" });
const label = make("select", { "aria-label": "how it ended" }, make("option", { value: "" }, "all"),
  ...Object.keys(SHAPES).map((one) => make("option", { value: one }, one)));
const compare = button("Compare two", async () => {
  const runs = await Promise.all([...chosen].map((id) => request("GET", `/api/runs/${encodeURIComponent(id)}`))).catch((error) => { note(error.message); return null; });
  if (runs !== null) content.replaceChildren(head("all runs", overview), comparison(runs));
}, { disabled: true });
const list = make("div", { className: "cards" }), content = make("div");
const chosen = new Set();
$("runs").append(content);

let shown = "";
async function refresh() {
  if (!isOpen("runs") || !content.contains(list)) return;
  try {
    const found = await request("GET", `/api/runs?limit=200&label=${label.value}&text=${encodeURIComponent(search.value)}`, undefined, 3000);
    if (JSON.stringify(found) === shown) return;
    shown = JSON.stringify(found);
    list.replaceChildren(...(found.length ? [HEAD] : []), ...found.map(row));
    if (found.length === 0) list.append(make("p", { className: "dim" }, search.value || label.value ? "No run matches." : "No run has been recorded yet."));
  } catch (error) {
    if (error instanceof Refused) note(error.message);
  }
}

const HEAD = make("div", { className: "run-head small dim" }, make("span", {}, "|error| [mm]"), make("span", {}, "largest"), make("span", {}, "RMS"));

function row(run) {
  const box = make("input", { type: "checkbox", checked: chosen.has(run.id), "aria-label": `choose ${run.id} to compare` });
  box.addEventListener("change", () => {
    if (box.checked) chosen.add(run.id); else chosen.delete(run.id);
    compare.disabled = chosen.size !== 2;
  });
  const [largest, rms] = errorSummary(run);
  const open = make("button", { type: "button", className: "card run", onclick: () => details(run.id) }, make("div", {},
    make("b", {}, run.title || run.experiment || run.id),
    make("span", {}, `${SHAPES[run.label] ?? "○"} ${run.label} · ${when(run.started)} · ${size(run.size)}`),
    run.notes === "" ? null : make("span", {}, `“${run.notes.split("\n")[0]}”`)),
  make("span", { className: "number", title: "largest distance of the tip from its desired position [mm]" }, largest),
  make("span", { className: "number", title: "root mean square of that distance [mm]" }, rms));
  return make("div", { style: "display:flex;gap:8px;align-items:center" }, box, open);
}

function overview() {
  shown = "";
  content.replaceChildren(make("div", { className: "acts", style: "margin:0 0 10px" }, search, label, compare), list);
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
    if (isUnsaved) localStorage.setItem(key, area.value); else localStorage.removeItem(key);
  };
  area.value = localStorage.getItem(key) ?? stored;
  area.addEventListener("input", show);
  show();
  return { element, saved: (text) => { stored = text; show(); } };
}

/** The button that deletes the shown run; null if no run is shown. */
let removal = null;
onStatus(() => { if (removal !== null) removal.disabled = !mayCommand(); });

/** Show the page of a run. */
async function details(id) {
  let run;
  try {
    run = await request("GET", `/api/runs/${encodeURIComponent(id)}`);
  } catch (error) {
    note(error.message);
    return;
  }
  const notes = make("textarea", { rows: 3, value: run.notes, "aria-label": "notes", style: "width:100%" });
  const unsaved = draft(notes, `notes ${id}`);
  const save = button("Save notes", async () => {
    const text = notes.value;
    if (await sendCommand("PUT", address(id, "notes"), { notes: text })) { unsaved.saved(text); note("notes are saved", true); }
  });
  removal = button("Delete…", async () => {
    if (!await confirm("Delete this run for good?", "Delete", make("p", {}, id), make("p", {}, `Recording, report and notes, ${size(run.size)}, are removed from the disk.`))) return;
    if (await sendCommand("DELETE", `/api/runs/${encodeURIComponent(id)}?confirm=${encodeURIComponent(id)}`)) { chosen.delete(id); overview(); }
  }, { disabled: !mayCommand() });
  const cases = run.cases.map((one) => make("a", { href: `${address(id, "recording")}?case=${encodeURIComponent(one)}`, download: "" }, `${one}.mcap`));
  const summary = { ...run.summary, started: when(run.started) };
  content.replaceChildren(
    head("all runs", overview, run.title || id),
    card(run),
    make("p", { className: "small dim" }, `${when(run.started)} · ${size(run.size)} · ${id}`),
    make("div", { className: "acts" }, button("Replay", () => page(id, "replay"), { className: "main" }), button("Report", () => page(id, "report")), ...cases),
    make("h3", {}, "Notes"), notes, make("div", { className: "acts" }, save, removal, unsaved.element),
    folded("All numbers", () => flat(summary).map(([key, value]) => make("tr", {}, make("td", { className: "any" }, key), make("td", { className: "any", style: "text-align:right" }, readable(value)))), "numbers"),
  );
}

/** Open the page of a run from another tab. */
export function showRun(id) {
  openTab("runs");
  details(id);
}

// ---- pages of a run, over the live scene; the header with STOP stays

function page(id, what) {
  const close = button("‹ live scene", () => cover.remove(), { className: "main" });
  const wait = make("span", { className: "dim" }, `${what} of ${id}; the first request takes some seconds …`);
  const frame = make("iframe", { src: address(id, what), title: `${what} of ${id}` });
  const cover = make("div", { id: "cover" }, make("div", { className: "acts" }, close, wait), frame);
  frame.addEventListener("load", () => { wait.textContent = `${what} of ${id}: this is not live`; });
  $("cover")?.remove();
  $("left").append(cover);
}

search.addEventListener("input", refresh);
label.addEventListener("change", refresh);
setInterval(refresh, 2000);
onTab("runs", refresh);
overview();
