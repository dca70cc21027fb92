"use strict";
// Plays the cases in the page: reads frames, advances the time, shows the scene and the numbers.

const BALLS = [0.0022, 0.0018, 0.0016, 0.0020]; // radii in m
const ARROW = 0.1; // m for 1 N
const UNKNOWN = -32768;
const TAIL = 8; // seconds of the traces that are shown
const data = JSON.parse(document.getElementById("data").textContent);
const { tube_colours: TUBES, tip_colours: COLOURS, force_colour: FORCE } = data;
const TIPS = ["desired tip", "measured tip (tracker)", "estimated tip (model)", "true tip (simulated)"].map((name, k) => ({ name, colour: COLOURS[k] }));
const id = (name) => document.getElementById(name);
const plain = (text) => String(text).replace(/[&<>"']/g, (sign) => `&#${sign.charCodeAt(0)};`);
const css = (colour) => `rgb(${colour.map((v) => Math.round(255 * v)).join(" ")})`;

function bytes(text) {
  return Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
}

/** A case with its frames as numbers. */
class Case {
  constructor(source) {
    Object.assign(this, source);
    this.positionsRow = 1 + this.tubes.length + 3 * this.points + 12;
    this.othersRow = 4 + this.joints.length;
    this.whole = new Int16Array(bytes(source.packed_positions));
    this.rest = new Float32Array(bytes(source.packed_others));
    this.times = Array.from({ length: this.frames }, (_, k) => this.rest[k * this.othersRow]);
    this.tipAt = 1 + this.tubes.length + 3 * this.points;
  }

  /** Return `count` numbers from index `first` on, interpolated at a fractional frame; null if one is unknown. */
  positions(frame, first, count) {
    const k = Math.floor(frame), part = frame - k, next = Math.min(k + 1, this.frames - 1), row = this.positionsRow;
    const values = [];
    for (let i = first; i < first + count; i++) {
      const [a, b] = [this.whole[k * row + i], this.whole[next * row + i]];
      if (a === UNKNOWN || b === UNKNOWN) return null;
      values.push(this.scale * (a + part * (b - a)));
    }
    return values;
  }

  others(frame, first, count) {
    const k = Math.floor(frame), part = frame - k, next = Math.min(k + 1, this.frames - 1), row = this.othersRow;
    return Array.from({ length: count }, (_, i) => {
      const [a, b] = [this.rest[k * row + first + i], this.rest[next * row + first + i]];
      return a + part * (b - a);
    });
  }

  tip(frame, number) { return this.positions(frame, this.tipAt + 3 * number, 3); }

  /** Return desired minus true tip, or minus measured tip without ground truth [mm]; null if one is unknown. */
  error(frame) {
    const [desired, is] = [this.tip(frame, 0), this.tip(frame, this.truth ? 3 : 1)];
    return desired && is ? add(desired, is, -1).map((v) => 1000 * v) : null;
  }

  /** Points of a tube from its end behind the plate to its far end; null without a shape. */
  tube(frame, number) {
    const line = this.positions(frame, 0, this.tipAt);
    if (!line) return null;
    const [length, start] = [line[0], line[1 + number]], first = 1 + this.tubes.length;
    const end = Math.min(start + this.tubes[number].length, length);
    const forward = this.plate.rotation.map((row) => row[2]);
    const at = (arc) => {
      if (arc < 0) return add(this.plate.position, forward, arc);
      const position = (arc / length) * (this.points - 1), k = Math.min(Math.floor(position), this.points - 2);
      const [a, b] = [k, k + 1].map((n) => line.slice(first + 3 * n, first + 3 * n + 3));
      return add(a, add(b, a, -1), position - k);
    };
    const pieces = 40;
    return Array.from({ length: pieces + 1 }, (_, k) => at(start + ((end - start) * k) / pieces));
  }
}

const cases = data.cases.map((source) => new Case(source));
let shown = cases[0], frame = 0, playing = false, last = 0, scene = null, still = null;

try {
  scene = new Scene(id("scene"), () => show());
} catch (error) {
  id("problem").textContent = error.message;
  id("problem").hidden = false;
}

function choose(number) {
  shown = cases[number];
  id("time").max = shown.frames - 1;
  frame = Math.min(frame, shown.frames - 1);
  const tubes = shown.tubes.map((tube, k) => [`${tube.name} tube`, TUBES[k % TUBES.length]]);
  const tips = TIPS.filter((_, k) => shown.tip(0, k)).map((tip) => [tip.name, tip.colour]);
  id("legend").innerHTML = [...tubes, ...tips, ["force, 10 mm for 0.1 N", FORCE]]
    .map(([name, colour]) => `<div><i style="background:${css(colour)}"></i>${plain(name)}</div>`).join("")
    + "<div>plate 60 mm, its grid 10 mm</div>";
  if (scene) prepare();
  errors();
  show();
}

/** Prepare the constant parts of a case: the plate and the traces. */
function prepare() {
  const { position, rotation } = shown.plate;
  const column = (k) => rotation.map((row) => row[k]);
  const at = (x, y) => add(add(position, column(0), x), column(1), y);
  const grid = [];
  for (let k = -3; k <= 3; k++) {
    grid.push([at(0.01 * k, -0.03), at(0.01 * k, 0.03)], [at(-0.03, 0.01 * k), at(0.03, 0.01 * k)]);
  }
  still = { grid: scene.lines(grid), traces: [] };
  TIPS.forEach((tip, number) => {
    const pairs = [], moments = [];
    for (let k = 0; k + 1 < shown.frames; k++) {
      const [a, b] = [shown.tip(k, number), shown.tip(k + 1, number)];
      if (a && b && number !== 2) { pairs.push([a, b]); moments.push(shown.times[k + 1]); }
    }
    still.traces.push(scene.lines(pairs, moments));
  });
  const tip = shown.tip(0, 1);
  scene.target = add(position, add(tip, position, -1), 0.55);
  // On a canvas that is higher than wide the camera is further away, so that the tip is visible.
  const narrow = Math.max(1, (1.4 * scene.canvas.clientHeight) / Math.max(scene.canvas.clientWidth, 1));
  scene.distance = 2.0 * narrow * Math.hypot(...add(tip, position, -1));
}

function show() {
  const time = shown.others(frame, 0, 1)[0];
  id("time").value = Math.round(frame);
  id("time").setAttribute("aria-valuetext", `${time.toFixed(2)} s`);
  id("clock").textContent = `${time.toFixed(2)} of ${shown.times.at(-1).toFixed(1)} s`;
  numbers();
  cursor();
  for (const one of pictures) one.show();
  if (!scene) return;
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  scene.startFrame(dark ? [0.09, 0.105, 0.12] : [0.957, 0.965, 0.973]);
  scene.drawLines(still.grid, dark ? [0.4, 0.45, 0.5] : [0.62, 0.66, 0.7], 1);
  const force = shown.others(frame, 1, 3), strength = Math.hypot(...force);
  let complete = true;
  for (let k = shown.tubes.length - 1; k >= 0; k--) {
    const points = shown.tube(frame, k);
    complete &&= points !== null;
    if (points) scene.draw(tubeSurface(points, shown.tubes[k].radius), TUBES[k % TUBES.length]);
  }
  TIPS.forEach((tip, number) => {
    scene.drawLines(still.traces[number], tip.colour, number === 1 ? 1.5 : 2.5, [time - TAIL, time]);
    const position = shown.tip(frame, number);
    if (position) scene.draw(ballSurface(position, BALLS[number]), tip.colour);
  });
  const tip = shown.tip(frame, shown.truth ? 3 : 1);
  if (strength > 0.005) {
    const head = add(tip, force, ARROW), along = unit(force), neck = add(head, along, -Math.min(0.008, ARROW * strength));
    scene.draw(tubeSurface([tip, neck], 0.0009), FORCE);
    scene.draw(coneSurface(neck, head, 0.0028), FORCE);
  }
  id("problem").hidden = complete;
  if (!complete) id("problem").textContent = "The model has no solution at this time: the tubes are not drawn.";
}

function numbers() {
  const row = (name, unit, values, digits) =>
    `<tr><th>${plain(name)}</th>${[0, 1, 2].map((k) => `<td>${values && k < values.length ? values[k].toFixed(digits) : ""}</td>`).join("")}<td>${unit}</td></tr>`;
  const mm = (values) => values && values.map((v) => 1000 * v);
  const names = ["desired", "measured", "estimated", "true"];
  const tips = names.map((name, k) => [name, shown.tip(frame, k)]).filter(([, tip]) => tip);
  const joints = shown.others(frame, 4, shown.joints.length);
  id("numbers").innerHTML = "<thead><tr><td></td><td>x</td><td>y</td><td>z</td><td></td></tr></thead><tbody>"
    + tips.map(([name, tip]) => row(`tip, ${name}`, "mm", mm(tip), 2)).join("")
    + (shown.desired ? row(shown.truth ? "true error" : "tracker error", "mm", shown.error(frame), 2) : "")
    + row("force", "N", shown.others(frame, 1, 3), 3)
    + shown.joints.map(([name, unit], k) => row(name.replaceAll("_", " "), unit === "rad" ? "deg" : "mm",
      [joints[k] * (unit === "rad" ? 180 / Math.PI : 1000)], 2)).join("") + "</tbody>";
}

// ---- pictures of the cameras at the cursor, with the tubes and the tips of the recording over them

/** A camera's video that follows the cursor. */
class Picture {
  constructor(source) {
    Object.assign(this, source);
    this.figure = document.createElement("figure");
    this.caption = document.createElement("figcaption");
    if (source.problem) {
      this.caption.textContent = `camera ${source.name}: ${source.problem}`;
      this.figure.append(this.caption);
      return;
    }
    this.video = Object.assign(document.createElement("video"), { muted: true, playsInline: true, preload: "auto" });
    this.video.src = URL.createObjectURL(new Blob([bytes(source.mp4)], { type: "video/mp4" }));
    const button = Object.assign(document.createElement("button"), { type: "button", title: "enlarge or reduce" });
    button.setAttribute("aria-label", `picture of camera ${source.name}: enlarge or reduce`);
    button.innerHTML = `<svg viewBox="-0.5 -0.5 ${source.width} ${source.height}" aria-hidden="true"></svg>`;
    this.drawing = button.firstChild;
    button.prepend(this.video);
    button.addEventListener("click", () => this.figure.classList.toggle("large"));
    this.figure.append(button, this.caption);
    this.video.addEventListener("seeked", () => this.show());
    this.video.addEventListener("loadeddata", () => this.show());
  }

  /** Show the frame at the cursor; while the player plays, the video runs and only its time is corrected. */
  show() {
    if (!this.video || this.video.readyState === 0) return;
    const time = shown.others(frame, 0, 1)[0], wanted = Math.min(Math.max(time - this.start, 0), this.video.duration);
    const outside = time < this.start - 1 / this.rate || time > this.start + this.video.duration + 1 / this.rate;
    this.video.style.visibility = outside ? "hidden" : "visible";
    const speed = Number(id("speed").value), runs = playing && speed <= 2 && !outside;
    if (runs && this.video.paused) { this.video.playbackRate = speed; this.video.play().catch(() => {}); }
    if (runs && this.video.playbackRate !== speed) this.video.playbackRate = speed;
    if (!runs && !this.video.paused) this.video.pause();
    // A quarter of a frame later than the frame's time, because a browser may round to the frame before.
    if (!this.video.seeking && Math.abs(this.video.currentTime - wanted - 0.25 / this.rate) > (runs ? 1 : 0.5) / this.rate) this.video.currentTime = wanted + 0.25 / this.rate;
    this.caption.textContent = `camera ${this.name}${this.simulated ? ", simulated" : ""}${outside ? ": no picture at this time" : ""}`;
    this.draw(outside);
  }

  draw(outside) {
    if (!this.view || outside) { this.drawing.innerHTML = ""; return; }
    const style = (colour) => `fill="none" stroke="${css(colour)}" stroke-width="2" vector-effect="non-scaling-stroke"`;
    const line = (points, colour) => `<polyline points="${points.map((p) => this.pixel(p)).filter(Boolean).map((p) => p.map((v) => v.toFixed(1)).join()).join(" ")}" ${style(colour)}/>`;
    const ball = (position, colour) => {
      const at = position && this.pixel(position);
      return at ? `<circle cx="${at[0].toFixed(1)}" cy="${at[1].toFixed(1)}" r="${this.width / 80}" ${style(colour)}/>` : "";
    };
    const tubes = shown.tubes.map((_, k) => [shown.tube(frame, k), TUBES[k % TUBES.length]]).filter(([points]) => points).map(([points, colour]) => line(points, colour)).reverse();
    this.drawing.innerHTML = [...tubes, ball(shown.tip(frame, 1), TIPS[1].colour), shown.desired ? ball(shown.tip(frame, 0), TIPS[0].colour) : ""].join("");
  }

  /** Column and row of a point by OpenCV's model of a lens; null behind the camera. */
  pixel(point) {
    const { matrix, distortion: [k1, k2, p1, p2, k3], rotation, position } = this.view;
    const [a, b, c] = rotation.map((row) => row.reduce((sum, value, k) => sum + value * (point[k] - position[k]), 0));
    if (c < 1e-3) return null;
    const x = a / c, y = b / c, square = x * x + y * y, radial = 1 + square * (k1 + square * (k2 + square * k3));
    return [matrix[0][0] * (x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)) + matrix[0][2],
      matrix[1][1] * (y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y) + matrix[1][2]];
  }
}

const pictures = data.videos.map((source) => new Picture(source));
id("cameras").append(...pictures.map((one) => one.figure));

let background = null;

/** Draw the magnitude of the error over the whole time. */
function errors() {
  const canvas = id("errors"), ratio = devicePixelRatio || 1;
  canvas.width = canvas.clientWidth * ratio;
  canvas.height = canvas.clientHeight * ratio;
  const pen = canvas.getContext("2d", { willReadFrequently: true }), { width: w, height: h } = canvas;
  const lengths = Array.from({ length: shown.frames }, (_, k) => {
    const error = shown.error(k);
    return error ? Math.hypot(...error) : NaN;
  });
  const largest = Math.max(...lengths.filter(Number.isFinite), 1e-6);
  pen.clearRect(0, 0, w, h);
  pen.fillStyle = getComputedStyle(document.body).color;
  pen.font = `${11 * ratio}px sans-serif`;
  if (shown.desired) {
    pen.fillText(`|E| ${shown.truth ? "true" : "measured"}, up to ${largest.toFixed(2)} mm`, 4 * ratio, 11 * ratio);
    pen.strokeStyle = css(TIPS[shown.truth ? 3 : 1].colour);
    pen.lineWidth = 1.2 * ratio;
    pen.beginPath();
    lengths.forEach((length, k) => {
      const [x, y] = [(w * k) / Math.max(shown.frames - 1, 1), h - 2 - (h - 16 * ratio) * (length / largest)];
      if (Number.isFinite(length)) pen.lineTo(x, y); else pen.moveTo(x, h);
    });
    pen.stroke();
  }
  background = pen.getImageData(0, 0, w, h);
}

function cursor() {
  const pen = id("errors").getContext("2d"), { width: w, height: h } = id("errors");
  pen.putImageData(background, 0, 0);
  pen.fillStyle = "#0072b2";
  pen.fillRect((w * frame) / Math.max(shown.frames - 1, 1) - 1, 0, 2, h);
}

function play(on) {
  playing = on;
  if (on && frame >= shown.frames - 1) go(0);
  id("play").textContent = on ? "Pause" : "Play";
  last = performance.now();
  if (on) requestAnimationFrame(tick); else show();
}

function tick(now) {
  if (!playing) return;
  const step = (shown.times.at(-1) - shown.times[0]) / Math.max(shown.frames - 1, 1);
  frame = Math.min(frame + (Number(id("speed").value) * (now - last)) / 1000 / step, shown.frames - 1);
  last = now;
  show();
  if (frame >= shown.frames - 1) play(false); else requestAnimationFrame(tick);
}

function go(to) {
  frame = Math.max(0, Math.min(shown.frames - 1, to));
  show();
}

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || event.target.tagName === "SELECT") return;
  const second = Math.max(1, Math.round((shown.frames - 1) / (shown.times.at(-1) - shown.times[0] || 1)));
  const step = event.shiftKey ? second : 1;
  const actions = {
    " ": () => play(!playing), ArrowLeft: () => go(Math.round(frame) - step), ArrowRight: () => go(Math.round(frame) + step),
    Home: () => go(0), End: () => go(shown.frames - 1),
  };
  if (!actions[event.key]) return;
  event.preventDefault();
  actions[event.key]();
});
id("play").addEventListener("click", () => play(!playing));
id("play").addEventListener("keyup", (event) => { if (event.key === " ") event.preventDefault(); });
id("time").addEventListener("input", () => go(Number(id("time").value)));
id("case").addEventListener("change", () => choose(id("case").selectedIndex));
addEventListener("resize", () => { errors(); show(); });
id("case").innerHTML = cases.map(() => "<option></option>").join("");
cases.forEach((one, k) => { id("case").options[k].textContent = one.name; });
id("choice").hidden = cases.length < 2;
id("origin").textContent = data.simulated ? "simulated bench" : "bench";
choose(0);
const asked = Number(/^#t=([\d.]+)$/.exec(location.hash)?.[1] ?? NaN); // the page of a run opens the replay at a time [s]
if (asked >= 0) go(Math.max(0, shown.times.findIndex((time) => time >= asked)));
play(!(asked >= 0) && !matchMedia("(prefers-reduced-motion: reduce)").matches);
