// Runs: recorded runs and their errors, with notes, replay, report, download, and comparison of two runs.
import { $, request, confirm, make, mayCommand, note, onStatus, sendCommand, Refused } from "./station.js";
import { draft } from "./drafts.js";
import { isOpen, onTab, openTab } from "./tabs.js";
import { address, errorSummary, card, flat, folded, readable, SHAPES, size, when } from "./result.js";
import { comparison } from "./compare.js";

const search = make("input", { type: "text", placeholder: "name, cause or notes", "aria-label": "search", style: "flex:1 1 0" });
const label = make("select", { "aria-label": "how it ended" }, make("option", { value: "" }, "all"),
  ...Object.keys(SHAPES).map((one) => make("option", { value: one }, one)));
const compare = make("button", { type: "button", disabled: true }, "Compare two");
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
  const open = make("button", { type: "button", className: "card run" }, make("div", {},
    make("b", {}, run.title || run.experiment || run.id),
    make("span", {}, `${SHAPES[run.label] ?? "○"} ${run.label} · ${when(run.started)} · ${size(run.size)}`),
    run.notes === "" ? null : make("span", {}, `“${run.notes.split("\n")[0]}”`)),
  make("span", { className: "number", title: "largest distance of the tip from its desired position [mm]" }, largest),
  make("span", { className: "number", title: "root mean square of that distance [mm]" }, rms));
  open.addEventListener("click", () => details(run.id));
  return make("div", { style: "display:flex;gap:8px;align-items:center" }, box, open);
}

function overview() {
  shown = "";
  content.replaceChildren(make("div", { className: "acts", style: "margin:0 0 10px" }, search, label, compare), list);
  refresh();
}

const back = () => {
  const button = make("button", { type: "button" }, "‹ all runs");
  button.addEventListener("click", overview);
  return button;
};

/** The button that deletes the shown run; null if no run is shown. */
let removal = null;
onStatus(() => { if (removal !== null) removal.disabled = !mayCommand(); });

/** Show the page of a run. */
export async function details(id) {
  let run;
  try {
    run = await request("GET", `/api/runs/${encodeURIComponent(id)}`);
  } catch (error) {
    note(error.message);
    return;
  }
  const notes = make("textarea", { rows: 3, value: run.notes, "aria-label": "notes", style: "width:100%" });
  const save = make("button", { type: "button" }, "Save notes"), remove = make("button", { type: "button" }, "Delete…");
  const unsaved = draft(notes, `notes ${id}`);
  save.addEventListener("click", async () => {
    const text = notes.value;
    if (await sendCommand("PUT", address(id, "notes"), { notes: text })) { unsaved.saved(text); note("notes are saved", true); }
  });
  remove.addEventListener("click", async () => {
    if (!await confirm("Delete this run for good?", "Delete", make("p", {}, id), make("p", {}, `Recording, report and notes, ${size(run.size)}, are removed from the disk.`))) return;
    if (await sendCommand("DELETE", `/api/runs/${encodeURIComponent(id)}?confirm=${encodeURIComponent(id)}`)) { chosen.delete(id); overview(); }
  });
  removal = remove;
  remove.disabled = !mayCommand();
  const replay = make("button", { type: "button", className: "main" }, "Replay"), report = make("button", { type: "button" }, "Report");
  replay.addEventListener("click", () => page(id, "replay"));
  report.addEventListener("click", () => page(id, "report"));
  const cases = run.cases.map((one) => make("a", { href: `${address(id, "recording")}?case=${encodeURIComponent(one)}`, download: "" }, `${one}.mcap`));
  const summary = { ...run.summary, started: when(run.started) };
  content.replaceChildren(
    make("div", { className: "acts", style: "margin:0 0 10px" }, back(), make("b", {}, run.title || id)),
    card(run),
    make("p", { className: "small dim" }, `${when(run.started)} · ${size(run.size)} · ${id}`),
    make("div", { className: "acts" }, replay, report, ...cases), make("h3", {}, "Notes"), notes, make("div", { className: "acts" }, save, remove, unsaved.element),
    folded("All numbers", () => flat(summary).map(([key, value]) => make("tr", {}, make("td", { className: "any" }, key), make("td", { className: "any", style: "text-align:right" }, readable(value)))), "numbers"),
  );
}

/** Open the page of a run from another tab. */
export function showRun(id) {
  openTab("runs");
  details(id);
}

compare.addEventListener("click", async () => {
  const runs = await Promise.all([...chosen].map((id) => request("GET", `/api/runs/${encodeURIComponent(id)}`))).catch((error) => { note(error.message); return null; });
  if (runs !== null) content.replaceChildren(make("div", { className: "acts", style: "margin:0 0 10px" }, back()), comparison(runs));
});

// ---- pages of a run, over the live scene; the header with STOP stays

function page(id, what) {
  const close = make("button", { type: "button", className: "main" }, "‹ live scene");
  const wait = make("span", { className: "dim" }, `${what} of ${id}; the first request takes some seconds …`);
  const frame = make("iframe", { src: address(id, what), title: `${what} of ${id}` });
  const cover = make("div", { id: "cover" }, make("div", { className: "acts" }, close, wait), frame);
  frame.addEventListener("load", () => { wait.textContent = `${what} of ${id}: this is not live`; });
  close.addEventListener("click", () => cover.remove());
  $("cover")?.remove();
  $("left").append(cover);
}

search.addEventListener("input", refresh);
label.addEventListener("change", refresh);
setInterval(refresh, 2000);
onTab("runs", refresh);
overview();
