// Over the scene: views to choose from, and a legend that folds.
import { $, ask, make } from "./station.js";
import { look } from "./tip.js";

const KEPT = "legend";

const legend = await ask("GET", "/api/scene/legend");

const views = make("div", { id: "views", role: "toolbar", "aria-label": "where to look from" });
for (const view of legend.views) {
  const button = make("button", { type: "button" }, view);
  button.addEventListener("click", () => look(view));
  views.append(button);
}

const row = ({ name, colour, shape }) => {
  const sign = make("i", { "data-shape": shape });
  sign.style.setProperty("--sign", colour);
  return make("li", {}, sign, name);
};
const signs = make("details", { id: "legend" }, make("summary", {}, "Legend"),
  make("ul", {}, ...legend.signs.map(row), ...legend.tubes.map((tube) => row({ ...tube, shape: "bar" }))));
signs.open = (localStorage.getItem(KEPT) ?? (innerWidth >= 1700 ? "open" : "folded")) === "open";
signs.addEventListener("toggle", () => localStorage.setItem(KEPT, signs.open ? "open" : "folded"));

$("view").append(views, signs);
