// Sizes of the page: width of the controls, which the browser stores; on small screens the folded scene and its menu.
import { $ } from "./station.js";
import { local } from "./storage.js";

const STEP_PX = 24, MIN_PX = 340, MIN_SCENE_PX = 320; // step of an arrow key; smallest widths of the controls and of the scene
const panel = $("panel"), divider = $("divider");

/** Set the width of the controls [px], within the page; null: the usual width. */
function setWidth(width) {
  if (width === null) {
    local.remove("panel");
    panel.style.removeProperty("--width");
  } else {
    const bounded = Math.round(Math.max(MIN_PX, Math.min(innerWidth - MIN_SCENE_PX, width)));
    local.set("panel", bounded);
    panel.style.setProperty("--width", `${bounded}px`);
  }
  describe();
}

function describe() {
  const width = Math.round(panel.getBoundingClientRect().width);
  for (const [name, value] of [["valuenow", width], ["valuemin", MIN_PX], ["valuemax", Math.max(MIN_PX, innerWidth - MIN_SCENE_PX)]]) {
    divider.setAttribute(`aria-${name}`, value);
  }
}

divider.addEventListener("pointerdown", (event) => {
  divider.setPointerCapture(event.pointerId);
  document.body.classList.add("resizing"); // the scene's frame must not receive the pointer
});
divider.addEventListener("pointermove", (event) => { if (divider.hasPointerCapture(event.pointerId)) setWidth(innerWidth - event.clientX); });
for (const type of ["pointerup", "pointercancel"]) divider.addEventListener(type, () => document.body.classList.remove("resizing"));
divider.addEventListener("dblclick", () => setWidth(null));
divider.addEventListener("keydown", (event) => {
  const step = { ArrowLeft: STEP_PX, ArrowRight: -STEP_PX }[event.key];
  if (step === undefined) return;
  event.preventDefault();
  setWidth(panel.getBoundingClientRect().width + step);
});
addEventListener("resize", describe);

const kept = Number(local.get("panel"));
if (kept > 0) setWidth(kept); else describe();

// ---- small screens: the scene can be folded, and its view options are in a menu

/** Whether the controls are below the scene, as on a phone. */
export const small = matchMedia("(max-width: 900px), (max-height: 600px)");
const low = matchMedia("(max-height: 600px)");

function fold(folded) {
  document.body.classList.toggle("folded", folded);
  $("fold-scene").textContent = folded ? "Show the scene" : "Hide the scene";
  $("fold-scene").setAttribute("aria-expanded", String(!folded));
}
$("fold-scene").addEventListener("click", () => fold(!document.body.classList.contains("folded")));

const fit = () => { $("switches").open = !small.matches; fold(low.matches); };
for (const query of [small, low]) query.addEventListener("change", fit);
fit();
