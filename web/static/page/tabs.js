// Tabs with arrow keys, as in the WAI-ARIA practices; the tab Bench has tabs itself. And parts that several tabs have.
import { $, button, make, request } from "./station.js";

const tabs = [...document.querySelectorAll("[role=tab]")], names = tabs.map((tab) => tab.getAttribute("aria-controls"));
const listeners = {};

/** Call `listener(open)` when a tab is opened or closed. */
export const onTab = (id, listener) => { (listeners[id] ??= []).push(listener); };
/** Return whether a tab is visible, which includes that the tab around it is open. */
export const isOpen = (id) => $(id).closest("[hidden]") === null;

/** Return the tab that was open last in this browser, or the first tab. */
export function lastTab() {
  const stored = localStorage.getItem("tab");
  return names.includes(stored) ? stored : names[0];
}

/** Open a tab, and first the tab around it. */
export function openTab(id) {
  localStorage.setItem("tab", id);
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
