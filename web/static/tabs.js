// Tabs with arrow keys, as in the WAI-ARIA practices.
import { $ } from "./station.js";

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
