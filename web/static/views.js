// Controls that are shown over the scene: buttons for the views, and a foldable legend.
import { $, request, make } from "./station.js";
import { setView } from "./tip.js";

const STORAGE_KEY = "legend";

const legend = await request("GET", "/api/scene/legend");

const views = make("div", { id: "views", role: "toolbar", "aria-label": "views" });
for (const view of legend.views) {
  const button = make("button", { type: "button" }, view);
  button.addEventListener("click", () => setView(view));
  views.append(button);
}

const row = ({ name, colour, shape }) => {
  const mark = make("i", { "data-shape": shape });
  mark.style.setProperty("--sign", colour);
  return make("li", {}, mark, name);
};
const legendBox = make("details", { id: "legend" }, make("summary", {}, "Legend"),
  make("ul", {}, ...legend.signs.map(row), ...legend.tubes.map((tube) => row({ ...tube, shape: "bar" }))));
legendBox.open = (localStorage.getItem(STORAGE_KEY) ?? (innerWidth >= 1700 ? "open" : "folded")) === "open";
legendBox.addEventListener("toggle", () => localStorage.setItem(STORAGE_KEY, legendBox.open ? "open" : "folded"));

$("view").append(views, legendBox);
