// Tabs with arrow keys, as in the WAI-ARIA practices; the tab Bench contains tabs. The page's address names the open tab
// and its detail, as in #history/RUN, so that Back and links work. Also parts that several tabs use.
import { $, button, make, request } from "./station.js";
import { local } from "./storage.js";

const tabs = [...document.querySelectorAll("[role=tab]")], names = tabs.map((tab) => tab.getAttribute("aria-controls"));
const listeners = {};

/** Call `listener(open)` when a tab is opened or closed. */
export const onTab = (id, listener) => { (listeners[id] ??= []).push(listener); };
/** Return whether a tab is visible, which includes that the tab around it is open. */
export const isOpen = (id) => $(id).closest("[hidden]") === null;

const word = (id) => $($(id).getAttribute("aria-labelledby")).textContent.toLowerCase(); // of a tab, in the address
const details = {}, shows = {}; // by tab: the detail that it shows instead of its overview, and the function that shows a detail
let current = "";

/** Return the tab and its detail in the page's address; if the address has no tab, the tab that was open last. */
function place() {
  const [tab, ...detail] = location.hash.slice(1).split("/"), stored = local.get("tab");
  const id = names.find((one) => word(one) === tab);
  if (id === undefined) return [names.includes(stored) ? stored : names[0], ""];
  try { return [id, detail.map(decodeURIComponent).join("/")]; } catch { return [id, ""]; }
}

/** Write the open tab and its detail into the address; `add`: as a new entry of the history, to which Back returns. */
function writeAddress(add) {
  const detail = details[current] ? `/${details[current].split("/").map(encodeURIComponent).join("/")}` : "", hash = `#${word(current)}${detail}`;
  if (hash !== location.hash) history[add && location.hash !== "" ? "pushState" : "replaceState"](null, "", hash);
}

/** Report the detail that a tab shows, for example the name of a run; empty: the tab shows its overview. */
export function showing(id, detail) {
  details[id] = detail;
  if (current === id) writeAddress(true);
}

/**
 * Call `show(detail)` when Back or a link leads to another detail of this tab. If the address names a detail of the tab
 * now, call it at once and return true.
 */
export function onPlace(id, show) {
  shows[id] = show;
  const [tab, detail] = place();
  if (tab !== id || detail === "") return false;
  details[id] = detail;
  show(detail);
  return true;
}

/** Open the tab of the address and show its detail. */
export function openPlace() {
  const [tab, detail] = place(), known = details[tab] ?? "";
  if (tab in shows) details[tab] = detail;
  openTab(tab, false);
  if (detail !== known) shows[tab]?.(detail);
}
window.addEventListener("popstate", openPlace);

/** Open a tab, and first the tab around it. */
export function openTab(id, add = true) {
  local.set("tab", id);
  current = id;
  if (id in shows || add) writeAddress(add);
  const before = names.filter(isOpen);
  for (let panel = $(id); panel !== null; panel = panel.parentElement.closest("[role=tabpanel]")) choose(panel);
  for (const name of names) {
    const open = isOpen(name);
    if (open !== before.includes(name)) for (const listener of listeners[name] ?? []) listener(open);
  }
}

function choose(panel) {
  for (const tab of siblings($(panel.getAttribute("aria-labelledby")))) {
    const other = $(tab.getAttribute("aria-controls")), chosen = other === panel;
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
    other.hidden = !chosen;
  }
}

const siblings = (tab) => [...tab.closest("[role=tablist]").querySelectorAll("[role=tab]:not([hidden])")];

for (const tab of tabs) {
  tab.addEventListener("click", () => openTab(tab.getAttribute("aria-controls")));
  tab.addEventListener("keydown", (event) => {
    const all = siblings(tab), step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    const to = event.key === "Home" ? 0 : event.key === "End" ? all.length - 1 : all.indexOf(tab) + step;
    if (Number.isNaN(to)) return;
    event.preventDefault();
    const next = all[(to + all.length) % all.length];
    next.focus();
    next.click();
  });
}
choose($("devices"));

/** Request `path` every `interval` [ms] while the tab `id` is open, and call `show(answer)`. */
export function poll(id, path, interval, show) {
  const refresh = async () => {
    if (!isOpen(id)) return;
    try { show(await request("GET", path, undefined, 1000)); } catch { return; } // the header reports that the station does not answer
  };
  setInterval(refresh, interval);
  onTab(id, refresh);
}

/** Return a button that opens what it names and describes; empty descriptions are omitted. */
export function card(title, descriptions, onclick, picture = null) {
  const lines = descriptions.filter((text) => text !== "").map((text) => make("span", {}, text));
  return make("button", { type: "button", className: "card", onclick }, picture, make("div", {}, make("b", {}, title), ...lines));
}

/** Return the head of a page within a tab: a button that returns to the list `overview`, and the page's title. */
export const head = (text, overview, title = "") =>
  make("div", { className: "acts", style: "margin:0 0 10px" }, button(`‹ ${text}`, overview), title && make("b", {}, title));
