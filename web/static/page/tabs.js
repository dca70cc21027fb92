// Tabs with arrow keys, as in the WAI-ARIA practices; and the parts that several tabs have.
import { $, button, make, request } from "./station.js";

const tabs = [...document.querySelectorAll("[role=tab]")];
const listeners = {};

/** Call `listener(open)` when a tab is opened or closed. */
export const onTab = (id, listener) => { (listeners[id] ??= []).push(listener); };
export const isOpen = (id) => !$(id).hidden;

/** Return the tab that was open before a reload, or the first tab. */
export function lastTab() {
  const stored = sessionStorage.getItem("tab"), names = tabs.map((tab) => tab.getAttribute("aria-controls"));
  return names.includes(stored) ? stored : names[0];
}

export function openTab(id) {
  sessionStorage.setItem("tab", id);
  for (const tab of tabs) {
    const panel = tab.getAttribute("aria-controls"), chosen = panel === id, was = isOpen(panel);
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
    $(panel).hidden = !chosen;
    if (was !== chosen) for (const listener of listeners[panel] ?? []) listener(chosen);
  }
}

for (const [number, tab] of tabs.entries()) {
  tab.addEventListener("click", () => openTab(tab.getAttribute("aria-controls")));
  tab.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    const to = event.key === "Home" ? 0 : event.key === "End" ? tabs.length - 1 : number + step;
    if (Number.isNaN(to)) return;
    event.preventDefault();
    const next = tabs[(to + tabs.length) % tabs.length];
    next.focus();
    next.click();
  });
}

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
