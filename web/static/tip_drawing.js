// Draws the surroundings of the tip on a canvas: millimetre grid, tubes, path, trace, tips, force, scale.

/** World axes to the right and upward in the picture, as [axis, sign], as in the scene's views of these names. */
export const PLANES = {
  side: { right: [2, 1], up: [0, -1] },
  front: { right: [1, 1], up: [0, -1] },
  above: { right: [2, 1], up: [1, 1] },
};
const AXES = ["x", "y", "z"];
const GRID = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50]; // possible distances of the grid's lines [mm]
const LONGEST_ARROW = 0.42; // length of the arrow from FULL_FORCE on, as a fraction of the picture's shorter side
const FULL_FORCE = 0.5; // force at which the arrow has its largest length [N]

/** Return the plane in which the path covers the largest area. */
export function bestPlane(path) {
  if (path.length < 2) return "side";
  const span = [0, 1, 2].map((axis) => 1e-3 + Math.max(...path.map((p) => p[axis])) - Math.min(...path.map((p) => p[axis])));
  const area = ({ right, up }) => span[right[0]] * span[up[0]];
  return Object.keys(PLANES).reduce((best, name) => (area(PLANES[name]) > 1.01 * area(PLANES[best]) ? name : best));
}

const middle = (points, axis) => (Math.max(...points.map((p) => p[axis])) + Math.min(...points.map((p) => p[axis]))) / 2;
const spans = (points, axis) => Math.max(...points.map((p) => p[axis])) - Math.min(...points.map((p) => p[axis]));

/** Return the centre of the picture: the middle of the path if the path fits, otherwise the tip. */
function pictureCentre(picture, plane, field) {
  const { path } = picture, axes = [plane.right[0], plane.up[0]];
  const tip = picture.estimated ?? picture.measured ?? picture.tubes[0]?.at(-1) ?? [0, 0, 0];
  if (path.length < 2 || axes.some((axis) => spans(path, axis) > field)) return tip;
  return AXES.map((_, axis) => middle(path, axis));
}

/** Draw one picture. `field` is the length of the shorter side [mm]; `stale` means that no value is current. */
export function draw(canvas, picture, legend, plane, field, stale) {
  const ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
  if (w === 0 || h === 0) return;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
  }
  const pen = canvas.getContext("2d"), style = getComputedStyle(canvas);
  const colours = { text: style.getPropertyValue("--text"), dim: style.getPropertyValue("--dim"), grid: style.getPropertyValue("--grid"), back: style.getPropertyValue("--back") };
  const sign = (name) => legend.signs.find((one) => one.name.startsWith(name)).colour;
  const scale = Math.min(w, h) / field, origin = pictureCentre(picture, plane, field);
  const part = ([axis, rightSign], point) => rightSign * (point[axis] - origin[axis]);
  const at = (point) => [w / 2 + scale * part(plane.right, point), h / 2 - scale * part(plane.up, point)];

  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
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
  trace();
  arrow();
  tips();
  pen.globalAlpha = 1;
  ruler();

  function paper() {
    pen.strokeStyle = colours.grid;
    pen.lineWidth = 1;
    pen.beginPath();
    for (const [along, size] of [[plane.right, w], [plane.up, h]]) {
      const here = origin[along[0]], reach = size / 2 / scale;
      for (let n = Math.ceil((here - reach) / step); n * step <= here + reach; n++) {
        const offset = along[1] * (n * step - here) * scale;
        if (along === plane.right) { pen.moveTo(w / 2 + offset, 0); pen.lineTo(w / 2 + offset, h); } else { pen.moveTo(0, h / 2 - offset); pen.lineTo(w, h / 2 - offset); }
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
    pen.fillText(`${size.toFixed(2)} N`, Math.min(x + u + 8, w - 42), Math.min(y + v + 4, h - 26));
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

  /** Draw the scale (a multiple of the grid's step) and the directions of the axes. */
  function ruler() {
    const count = [5, 2, 1].find((n) => n * step * scale < 0.4 * w) ?? 1, length = count * step * scale, y = h - 9;
    stroke([[10, y - 4], [10, y], [10 + length, y], [10 + length, y - 4]], colours.text, 1.5, "butt");
    pen.fillStyle = colours.text;
    pen.fillText(`${Number((count * step).toFixed(1))} mm`, 16 + length, y + 2);
    const [[across, rightSign], [upward, upSign]] = [plane.right, plane.up];
    const axesText = `${AXES[across]} ${rightSign > 0 ? "→" : "←"}  ${AXES[upward]} ${upSign > 0 ? "↑" : "↓"}`;
    pen.fillStyle = colours.dim;
    pen.fillText(axesText, w - 8 - pen.measureText(axesText).width, 16);
  }
}
