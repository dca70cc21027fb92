// Overlays of the scene: buttons of the views, a foldable legend, and the close-up of the tip.
import { $, button, client, enable, isSilent, make, onStatus, request, setText, silentReason, stream } from "../page/station.js";
import { cleared } from "../page/chart.js";
import { local } from "../page/storage.js";

const legend = await request("GET", "/api/scene/legend");

// ---- views and legend

const views = make("div", { id: "views", role: "toolbar", "aria-label": "views" }, ...legend.views.map((view) => button(view, () => setView(view))));

const row = ({ name, colour, shape }) => {
  const mark = make("i", { "data-shape": shape });
  mark.style.setProperty("--sign", colour);
  return make("li", {}, mark, name);
};
const legendBox = make("details", { id: "legend" }, make("summary", {}, "Legend"),
  make("ul", {}, ...legend.signs.map(row), ...legend.tubes.map((tube) => row({ ...tube, shape: "bar" })),
    make("li", { id: "magnified" }, `tubes drawn ×${legend.magnification}`)));
legendBox.open = (local.get("legend") ?? (innerWidth >= 1700 ? "open" : "folded")) === "open";
legendBox.addEventListener("toggle", () => local.set("legend", legendBox.open ? "open" : "folded"));

// ---- close-up of the tip: a parallel projection in millimetres, redrawn with each new message

/** World axes to the right and upward in the picture, as [axis, sign], as in the scene's views of these names. */
const PLANES = {
  side: { right: [2, 1], up: [0, -1] },
  front: { right: [1, 1], up: [0, -1] },
  above: { right: [2, 1], up: [1, 1] },
};
const RATE_HZ = 8, SILENT_AFTER_MS = 1500; // requested rate [Hz]; time without a message that counts as silence [ms]
const FIELDS_MM = [3, 6, 12, 25, 50, 100]; // selectable lengths of the picture's shorter side [mm]
const DEFAULT_FIELD_MM = 25;

let picture = null, receivedAt = -Infinity, frameRequested = false;
let lastPath = []; // last path of a motion; its plane and field stay until the next path
let grown = { motion: "", field: 0 }; // field that fitted the last path so far
let plane = null, field = null; // plane and field that the user has chosen; null: chosen to fit the path

const canvas = make("canvas", { role: "img", "aria-label": "the tip, enlarged" }), caption = make("p");
const planes = make("select", { "aria-label": "seen from", onchange: () => { plane = planes.value || null; show(); } }, make("option", { value: "" }, "auto"),
  ...Object.keys(PLANES).map((name) => make("option", { value: name }, name)));
const fold = button("▾", () => foldCloseUp(box.dataset.folded !== "true"));
const box = make("section", { id: "tip", "aria-label": "close-up of the tip" },
  make("header", {}, make("b", {}, "Tip"), planes, button("−", () => zoom(1), { "aria-label": "show more around the tip", "data-zoom": "" }),
    button("+", () => zoom(-1), { "aria-label": "enlarge the tip", "data-zoom": "" }), fold), canvas, caption);
const modelText = make("span", {}), calibrate = button("Calibrate", () => { location.hash = "calibrate/clearing"; });
const modelError = make("div", { id: "model-error", hidden: true }, modelText, calibrate);
$("view").append(box, views, legendBox, modelError);
foldCloseUp(innerWidth <= 600); // on a phone it would cover the robot's tip

function foldCloseUp(folded) {
  box.dataset.folded = folded;
  fold.textContent = folded ? "▸" : "▾";
  fold.setAttribute("aria-label", folded ? "show the close-up" : "fold the close-up");
  show();
}

/**
 * Return the smallest field that contains the last path, the tip and the force's arrow [mm]; before the first path, the
 * default field. It only grows during a motion, because a picture that follows a varying force would be restless.
 */
function fittingField() {
  if (picture === null || picture.path.length < 2) return grown.field || DEFAULT_FIELD_MM;
  const axes = PLANES[plane ?? bestPlane(lastPath)], motion = JSON.stringify([lastPath[0], lastPath.at(-1), lastPath.length, plane]);
  if (motion !== grown.motion) grown = { motion, field: 0 };
  const fitting = FIELDS_MM.find((one) => one >= grown.field && fits(axes, one)) ?? FIELDS_MM.find((one) => one > 1.2 * pathSize(axes));
  return grown.field = Math.max(grown.field, fitting ?? DEFAULT_FIELD_MM);
}

const pathSize = (axes) => Math.max(...[axes.right, axes.up].map(([axis]) => span(lastPath, axis)));

/** Return whether the path, the tip and the arrow are inside the picture above its ruler, with room for their marks. */
function fits({ right, up }, field) {
  const { clientWidth: width, clientHeight: height } = canvas, scale = Math.min(width, height) / field;
  const points = [...lastPath, picture.measured, picture.estimated, arrowEnd(field)].filter((point) => point !== null);
  const half = [width / 2, (height - RULER_HEIGHT) / 2];
  return [right, up].every(([axis], i) => points.every((point) => scale * Math.abs(point[axis] - middle(lastPath, axis)) <= half[i] - MARK_PX));
}

/** Return where the force's arrow ends [mm]; null without an arrow. */
function arrowEnd(field) {
  const { force, place } = picture;
  if (force === null || place === null) return null;
  const size = Math.hypot(...force), length = LONGEST_ARROW * field * Math.min(1, size / FULL_FORCE);
  return size === 0 ? place : place.map((x, i) => x + (length * force[i]) / size);
}

function zoom(step) {
  const number = FIELDS_MM.indexOf(field ?? fittingField()) + step;
  field = FIELDS_MM[Math.max(0, Math.min(FIELDS_MM.length - 1, number))];
  show();
}

function show() {
  if (frameRequested || document.hidden || box.dataset.folded === "true") return;
  frameRequested = true;
  requestAnimationFrame(() => {
    frameRequested = false;
    const silent = performance.now() - receivedAt > SILENT_AFTER_MS;
    const stale = silent || picture === null || picture.message !== "";
    caption.dataset.old = stale;
    caption.textContent = picture === null || silent ? "no data about the tip" : picture.message || describe(picture);
    if (picture === null) return;
    if (picture.path.length >= 2) lastPath = picture.path;
    draw(PLANES[plane ?? bestPlane(lastPath)], field ?? fittingField(), silent || picture.age > 0.5);
  });
}

function describe({ measured, desired, contact, force }) {
  if (contact !== "" && force !== null) return `contact: ${contact}`;
  if (measured === null || desired === null) return "";
  return `tracker error ${Math.hypot(...measured.map((x, i) => x - desired[i])).toFixed(2)} mm`;
}

/** Show the distance between the model's tip and the measured tip while the scene draws the model's end. */
function showModelError() {
  modelError.hidden = picture === null || picture.model_end.length === 0;
  enable(calibrate, silentReason());
  if (!modelError.hidden) setText(modelText, `model ${isSilent() ? "–" : picture.model_error.toFixed(1)} mm from tracker: not calibrated`);
}

/** Move the camera of this page's scene to a view. */
const setView = stream(`scene/tip?rate=${RATE_HZ}&client=${client}`, (message) => {
  picture = message;
  receivedAt = performance.now();
  showModelError();
  show();
});
setInterval(() => { if (performance.now() - receivedAt > SILENT_AFTER_MS) show(); }, 1000);
onStatus(showModelError);
addEventListener("resize", show);
document.addEventListener("visibilitychange", show);

// ---- drawing of the close-up: millimetre grid, tubes, path, trace, tips, force, scale

const AXES = ["x", "y", "z"];
const GRID = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50]; // possible distances of the grid's lines [mm]
const LONGEST_ARROW = 0.42; // length of the arrow from FULL_FORCE on, as a fraction of the picture's shorter side
const MARK_PX = 8; // radius of the marks of the tips [px]
const RULER_HEIGHT = 24; // height of the strip with the scale and the axes [px]
const FULL_FORCE = 0.5; // force at which the arrow has its largest length [N]

/** Return the plane in which the path covers the largest area. */
function bestPlane(path) {
  if (path.length < 2) return "side";
  const area = ({ right, up }) => (1e-3 + span(path, right[0])) * (1e-3 + span(path, up[0]));
  return Object.keys(PLANES).reduce((best, name) => (area(PLANES[name]) > 1.01 * area(PLANES[best]) ? name : best));
}

const middle = (points, axis) => (Math.max(...points.map((p) => p[axis])) + Math.min(...points.map((p) => p[axis]))) / 2;
const span = (points, axis) => Math.max(...points.map((p) => p[axis])) - Math.min(...points.map((p) => p[axis]));

/** Return the centre of the picture: the middle of the path if the path fits, otherwise the tip. */
function pictureCentre(plane, field) {
  const { path } = picture, axes = [plane.right[0], plane.up[0]];
  const tip = picture.tubes[0]?.at(-1) ?? picture.estimated ?? picture.measured ?? [0, 0, 0];
  if (path.length < 2 || axes.some((axis) => span(path, axis) > field)) return tip;
  return AXES.map((_, axis) => middle(path, axis));
}

/** Draw one picture. `field` is the length of the shorter side [mm]; `stale` means that no value is current. */
function draw(plane, field, stale) {
  const area = cleared(canvas);
  if (area === null) return;
  const { pen, width: w, height: h } = area, style = getComputedStyle(canvas);
  const colours = Object.fromEntries(["text", "dim", "grid", "back"].map((name) => [name, style.getPropertyValue(`--${name}`)]));
  const sign = (name) => legend.signs.find((one) => one.name.startsWith(name)).colour;
  const scale = Math.min(w, h) / field, origin = pictureCentre(plane, field);
  const middleHeight = (h - RULER_HEIGHT) / 2; // of the part above the ruler
  const part = ([axis, rightSign], point) => rightSign * (point[axis] - origin[axis]);
  const at = (point) => [w / 2 + scale * part(plane.right, point), middleHeight - scale * part(plane.up, point)];

  pen.globalAlpha = 1;
  pen.fillStyle = colours.back;
  pen.fillRect(0, 0, w, h);
  pen.lineCap = pen.lineJoin = "round";
  pen.font = "11.5px system-ui, sans-serif";
  const step = GRID.find((one) => one * scale >= 18) ?? 50;
  paper();
  pen.globalAlpha = stale ? 0.3 : 1;
  // The innermost tube is drawn first, so that a wider tube hides it.
  picture.tubes.forEach((line, k) => stroke(line.map(at), legend.tubes[k].colour, 1e3 * legend.tubes[k].diameter * scale, "butt"));
  stroke(picture.path.map(at), sign("reference"), 2);
  pen.setLineDash([6, 5]);
  stroke(picture.model_end.map(at), sign("estimated"), 2);
  pen.setLineDash([]);
  trace();
  arrow();
  tips();
  pen.globalAlpha = 1;
  ruler();

  function paper() {
    pen.strokeStyle = colours.grid;
    pen.lineWidth = 1;
    pen.beginPath();
    for (const [along, size] of [[plane.right, w], [plane.up, h + RULER_HEIGHT]]) {
      const here = origin[along[0]], reach = size / 2 / scale;
      for (let n = Math.ceil((here - reach) / step); n * step <= here + reach; n++) {
        const offset = along[1] * (n * step - here) * scale;
        if (along === plane.right) { pen.moveTo(w / 2 + offset, 0); pen.lineTo(w / 2 + offset, h); } else { pen.moveTo(0, middleHeight - offset); pen.lineTo(w, middleHeight - offset); }
      }
    }
    pen.stroke();
  }

  function stroke(points, colour, width, cap = "round") {
    if (points.length < 2) return;
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.lineCap = cap;
    pen.beginPath();
    points.forEach(([x, y], k) => (k === 0 ? pen.moveTo(x, y) : pen.lineTo(x, y)));
    pen.stroke();
    pen.lineCap = "round";
  }

  function trace() {
    const points = picture.trace.map(at), parts = 8, size = Math.ceil(points.length / parts), full = pen.globalAlpha;
    for (let k = 0; k < parts; k++) {
      pen.globalAlpha = full * (0.2 + (0.8 * (k + 1)) / parts);
      stroke(points.slice(k * size, (k + 1) * size + 1), sign("measured"), 2);
    }
    pen.globalAlpha = full;
  }

  function arrow() {
    if (picture.force === null || picture.place === null) return;
    const size = Math.hypot(...picture.force);
    const length = (LONGEST_ARROW * Math.min(w, h) * Math.min(1, size / FULL_FORCE)) / size;
    const [x, y] = at(picture.place), [[axis, rightSign], [other, upSign]] = [plane.right, plane.up];
    const [u, v] = [length * rightSign * picture.force[axis], -length * upSign * picture.force[other]], long = Math.hypot(u, v);
    pen.fillStyle = sign("force");
    if (long > 4) {
      const [a, b] = [u / long, v / long];
      stroke([[x, y], [x + u - 6 * a, y + v - 6 * b]], sign("force"), 3);
      pen.beginPath();
      pen.moveTo(x + u, y + v);
      pen.lineTo(x + u - 10 * a - 5 * b, y + v - 10 * b + 5 * a);
      pen.lineTo(x + u - 10 * a + 5 * b, y + v - 10 * b - 5 * a);
      pen.fill();
    }
    pen.fillStyle = colours.text;
    const [right, down] = long > 16 ? [u + 8, v + 4] : [16, 24]; // the text of a short arrow stays clear of the tip's marks
    pen.fillText(`${size.toFixed(2)} N`, Math.min(x + right, w - 42), Math.min(y + down, h - RULER_HEIGHT - 6));
  }

  function tips() {
    const { desired, estimated, measured } = picture;
    if (desired !== null) {
      const full = pen.globalAlpha, [x, y] = at(desired);
      disc(x, y, 8);
      pen.globalAlpha = 0.3 * full;
      pen.fillStyle = pen.strokeStyle = sign("desired");
      pen.fill();
      pen.globalAlpha = full;
      pen.lineWidth = 2;
      pen.stroke();
    }
    if (estimated !== null) {
      const [x, y] = at(estimated);
      pen.strokeStyle = sign("estimated");
      pen.lineWidth = 2.5;
      pen.strokeRect(x - 5, y - 5, 10, 10);
    }
    if (measured !== null) {
      disc(...at(measured), 4);
      pen.fillStyle = sign("measured");
      pen.fill();
      pen.strokeStyle = colours.back;
      pen.lineWidth = 1;
      pen.stroke();
    }
  }

  function disc(x, y, radius) {
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
  }

  /** Draw the scale (a multiple of the grid's step) and the directions of the axes on a strip that nothing crosses. */
  function ruler() {
    pen.fillStyle = colours.back;
    pen.fillRect(0, h - RULER_HEIGHT, w, RULER_HEIGHT);
    const count = [5, 2, 1].find((n) => n * step * scale < 0.4 * w) ?? 1, length = count * step * scale, y = h - 9;
    stroke([[10, y - 4], [10, y], [10 + length, y], [10 + length, y - 4]], colours.text, 1.5, "butt");
    pen.fillStyle = colours.text;
    const lengthText = `${Number((count * step).toFixed(1))} mm`;
    pen.fillText(lengthText, 16 + length, y + 2);
    const [[across, rightSign], [upward, upSign]] = [plane.right, plane.up];
    const axesText = `${AXES[across]} ${rightSign > 0 ? "→" : "←"}  ${AXES[upward]} ${upSign > 0 ? "↑" : "↓"}`;
    pen.fillStyle = colours.dim;
    const left = w - 8 - pen.measureText(axesText).width;
    if (left > 24 + length + pen.measureText(lengthText).width) pen.fillText(axesText, left, y + 2); // a small picture has no room for it
  }
}
