// What was typed and not saved is kept in this browser, and is there again when one comes back.
import { make } from "./station.js";

/** Keep what is typed into `area` under a name: {element: says so, saved(): it is in the station now}. */
export function draft(area, name) {
  const key = `draft ${name}`, element = make("span", { className: "small mind", role: "status" });
  let stored = area.value;
  const show = () => {
    const open = area.value !== stored;
    element.textContent = open ? "not saved yet; kept in this browser" : "";
    if (open) localStorage.setItem(key, area.value); else localStorage.removeItem(key);
  };
  area.value = localStorage.getItem(key) ?? stored;
  area.addEventListener("input", show);
  show();
  return { element, saved: (text) => { stored = text; show(); } };
}
