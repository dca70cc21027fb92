// Unsaved text is kept in this browser and restored later.
import { make } from "./station.js";

/**
 * Keep the text of `area` under a name. Return {element: shows whether text is unsaved, saved(text): to be called when
 * the station has stored the text}.
 */
export function draft(area, name) {
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
