// A close-up of the tip beside the scene: parallel projection, millimetres, drawn when something new has come.
import { $, ask, client, make } from "./station.js";
import { draw, PLANES, plane_of } from "./tip_drawing.js";

const RATE = 8, SILENT = 1500; // Hz, ms
const FIELDS = [3, 6, 12, 25, 50, 100]; // what the shorter side shows [mm]
const USUAL = 25;

let picture = null, heard = -Infinity, socket = null, asked = false;
let plane = null, field = null; // chosen by the person; null: by the path
const legend = await ask("GET", "/api/scene/legend");

const canvas = make("canvas", { role: "img", "aria-label": "the tip, enlarged" }), says = make("p");
const planes = make("select", { "aria-label": "seen from" }, make("option", { value: "" }, "auto"),
  ...Object.keys(PLANES).map((name) => make("option", { value: name }, name)));
const near = make("button", { type: "button", "aria-label": "enlarge the tip", "data-zoom": "" }, "+");
const far = make("button", { type: "button", "aria-label": "show more around the tip", "data-zoom": "" }, "−");
const fold = make("button", { type: "button", "aria-label": "fold the close-up" }, "▾");
const box = make("section", { id: "tip", "aria-label": "close-up of the tip" },
  make("header", {}, make("b", {}, "Tip"), planes, far, near, fold), canvas, says);
$("view").append(box);

planes.addEventListener("change", () => { plane = planes.value || null; show(); });
near.addEventListener("click", () => zoom(-1));
far.addEventListener("click", () => zoom(1));
fold.addEventListener("click", () => {
  const folded = box.dataset.folded !== "true";
  box.dataset.folded = folded;
  fold.textContent = folded ? "▸" : "▾";
  fold.setAttribute("aria-label", folded ? "show the close-up" : "fold the close-up");
  show();
});

/** The smallest field that holds the path, where there is one. */
function fitting() {
  const path = picture?.path ?? [];
  if (path.length < 2) return USUAL;
  const axes = PLANES[plane ?? plane_of(path)];
  const size = Math.max(...[axes.right, axes.up].map(([axis]) => span(path, axis)));
  return FIELDS.find((one) => one > 1.2 * size) ?? USUAL;
}
const span = (points, axis) => Math.max(...points.map((p) => p[axis])) - Math.min(...points.map((p) => p[axis]));

function zoom(step) {
  const number = FIELDS.indexOf(field ?? fitting()) + step;
  field = FIELDS[Math.max(0, Math.min(FIELDS.length - 1, number))];
  show();
}

/** Move the camera of this page's scene to a view. */
export function look(view) { if (socket?.readyState === WebSocket.OPEN) socket.send(view); }

function show() {
  if (asked || document.hidden || box.dataset.folded === "true") return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    const silent = performance.now() - heard > SILENT;
    const old = silent || picture === null || picture.says !== "";
    says.dataset.old = old;
    says.textContent = picture === null || silent ? "nothing is heard of the tip" : picture.says || off(picture);
    if (picture === null) return;
    draw(canvas, picture, legend, PLANES[plane ?? plane_of(picture.path)], field ?? fitting(), silent || picture.age > 0.5);
  });
}

function off({ measured, desired, contact, force }) {
  if (contact !== "" && force !== null) return `contact: ${contact}`;
  if (measured === null || desired === null) return "";
  return `measured tip ${Math.hypot(...measured.map((x, i) => x - desired[i])).toFixed(2)} mm from desired`;
}

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  socket = new WebSocket(`${scheme}://${location.host}/api/scene/tip?rate=${RATE}&client=${client}`);
  socket.addEventListener("message", (event) => {
    picture = JSON.parse(event.data);
    heard = performance.now();
    show();
  });
  socket.addEventListener("close", () => setTimeout(connect, 1000));
}
connect();
setInterval(() => { if (performance.now() - heard > SILENT) show(); }, 1000);
addEventListener("resize", show);
document.addEventListener("visibilitychange", show);
