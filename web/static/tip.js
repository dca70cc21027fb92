// Close-up of the tip over the scene: parallel projection in millimetres, redrawn with each new message.
import { $, request, client, make } from "./station.js";
import { draw, PLANES, bestPlane } from "./tip_drawing.js";

const RATE_HZ = 8, SILENT_AFTER_MS = 1500; // requested rate [Hz]; time without a message that counts as silence [ms]
const FIELDS_MM = [3, 6, 12, 25, 50, 100]; // selectable lengths of the picture's shorter side [mm]
const DEFAULT_FIELD_MM = 25;

let picture = null, receivedAt = -Infinity, socket = null, frameRequested = false;
let plane = null, field = null; // plane and field that the user has chosen; null: chosen to fit the path
const legend = await request("GET", "/api/scene/legend");

const canvas = make("canvas", { role: "img", "aria-label": "the tip, enlarged" }), caption = make("p");
const planes = make("select", { "aria-label": "seen from" }, make("option", { value: "" }, "auto"),
  ...Object.keys(PLANES).map((name) => make("option", { value: name }, name)));
const zoomIn = make("button", { type: "button", "aria-label": "enlarge the tip", "data-zoom": "" }, "+");
const zoomOut = make("button", { type: "button", "aria-label": "show more around the tip", "data-zoom": "" }, "−");
const fold = make("button", { type: "button", "aria-label": "fold the close-up" }, "▾");
const box = make("section", { id: "tip", "aria-label": "close-up of the tip" },
  make("header", {}, make("b", {}, "Tip"), planes, zoomOut, zoomIn, fold), canvas, caption);
$("view").append(box);

planes.addEventListener("change", () => { plane = planes.value || null; show(); });
zoomIn.addEventListener("click", () => zoom(-1));
zoomOut.addEventListener("click", () => zoom(1));
fold.addEventListener("click", () => {
  const folded = box.dataset.folded !== "true";
  box.dataset.folded = folded;
  fold.textContent = folded ? "▸" : "▾";
  fold.setAttribute("aria-label", folded ? "show the close-up" : "fold the close-up");
  show();
});

/** Return the smallest field that contains the path [mm]; without a path, the default field. */
function fittingField() {
  const path = picture?.path ?? [];
  if (path.length < 2) return DEFAULT_FIELD_MM;
  const axes = PLANES[plane ?? bestPlane(path)];
  const size = Math.max(...[axes.right, axes.up].map(([axis]) => span(path, axis)));
  return FIELDS_MM.find((one) => one > 1.2 * size) ?? DEFAULT_FIELD_MM;
}
const span = (points, axis) => Math.max(...points.map((p) => p[axis])) - Math.min(...points.map((p) => p[axis]));

function zoom(step) {
  const number = FIELDS_MM.indexOf(field ?? fittingField()) + step;
  field = FIELDS_MM[Math.max(0, Math.min(FIELDS_MM.length - 1, number))];
  show();
}

/** Move the camera of this page's scene to a view. */
export function setView(view) { if (socket?.readyState === WebSocket.OPEN) socket.send(view); }

function show() {
  if (frameRequested || document.hidden || box.dataset.folded === "true") return;
  frameRequested = true;
  requestAnimationFrame(() => {
    frameRequested = false;
    const silent = performance.now() - receivedAt > SILENT_AFTER_MS;
    const stale = silent || picture === null || picture.message !== "";
    caption.dataset.old = stale;
    caption.textContent = picture === null || silent ? "no data of the tip" : picture.message || describe(picture);
    if (picture === null) return;
    draw(canvas, picture, legend, PLANES[plane ?? bestPlane(picture.path)], field ?? fittingField(), silent || picture.age > 0.5);
  });
}

function describe({ measured, desired, contact, force }) {
  if (contact !== "" && force !== null) return `contact: ${contact}`;
  if (measured === null || desired === null) return "";
  return `measured tip ${Math.hypot(...measured.map((x, i) => x - desired[i])).toFixed(2)} mm from desired`;
}

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  socket = new WebSocket(`${scheme}://${location.host}/api/scene/tip?rate=${RATE_HZ}&client=${client}`);
  socket.addEventListener("message", (event) => {
    picture = JSON.parse(event.data);
    receivedAt = performance.now();
    show();
  });
  socket.addEventListener("close", () => setTimeout(connect, 1000));
}
connect();
setInterval(() => { if (performance.now() - receivedAt > SILENT_AFTER_MS) show(); }, 1000);
addEventListener("resize", show);
document.addEventListener("visibilitychange", show);
