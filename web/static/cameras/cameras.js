// Cameras: live pictures with the model drawn over them, and snapshots. A picture is requested only while it is visible.
import { $, button, enable, make, note, request, sendCommand, setText } from "../page/station.js";
import { row } from "../page/form.js";
import { numberField } from "../page/number.js";
import { isOpen, onTab } from "../page/tabs.js";
import { svg } from "../page/chart.js";

const STATE_INTERVAL_MS = 500, OVERLAY_INTERVAL_MS = 150, RETRY_MS = 1500, SILENT_MS = 5000, TIMEOUT_MS = 4000, MARK_PX = 9;
const large = make("div", { id: "camera-large", hidden: true });
const known = await request("GET", "/api/cameras");
const cameras = known.map((camera) => new Camera(camera));

/** Picture of one camera with its overlay, state and buttons. */
function Camera({ name, width, height, calibrated }) {
  const id = encodeURIComponent(name);
  const image = make("img", { alt: `live picture of camera ${name}` });
  const drawing = svg("svg", { viewBox: `-0.5 -0.5 ${width} ${height}`, "aria-hidden": "true" });
  const state = make("output", { "aria-label": `state of camera ${name}` }), problem = make("p", { className: "mind" });
  const shown = make("input", { type: "checkbox", checked: calibrated, disabled: !calibrated });
  const legend = make("span", { className: "camera-legend dim" },
    make("i", { "data-sign": "model" }), "tubes by the model", make("i", { "data-sign": "measured" }), "measured tip", make("i", { "data-sign": "desired" }), "desired tip");
  const enlarge = button("Large", () => setLarge(large.firstChild === figure ? null : figure), { name: "large" });
  const picture = make("div", { className: "camera-picture", style: `aspect-ratio: ${width} / ${height}` }, image, drawing);
  const figure = make("figure", { className: "camera", style: `--ratio: ${width / height}` }, picture,
    make("figcaption", {}, make("b", {}, name), state, make("label", { title: calibrated ? "" : "the lens or the pose of this camera is not known" }, shown, "model over the picture"),
      button("Snapshot", () => saveSnapshot(name)), enlarge, problem, legend));
  let live = false, loading = false, retry = 0, socket = null, calibrating = false;

  /** Start or end the stream: it runs only while the picture is visible. */
  const update = () => {
    const visible = !document.hidden && (isOpen("cameras") || large.firstChild === figure);
    setText(enlarge, large.firstChild === figure ? "Small" : "Large");
    if (visible === live) return;
    live = visible;
    clearTimeout(retry);
    if (live) { connect(); return; }
    socket.close();
    show("");
  };
  // A stream over HTTP would take one of the six connections that a browser opens for all windows of this page.
  const connect = () => {
    socket?.close();
    const opened = socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/cameras/${id}/pictures`);
    opened.binaryType = "blob";
    const reconnectAfter = (delay) => { clearTimeout(retry); retry = setTimeout(connect, delay); };
    opened.addEventListener("message", ({ data }) => {
      if (opened !== socket || !live) return;
      reconnectAfter(SILENT_MS); // a dead connection reports no end
      if (!loading) show(URL.createObjectURL(data)); // a slow computer skips pictures
    });
    opened.addEventListener("close", () => { if (opened === socket && live) reconnectAfter(RETRY_MS); });
    reconnectAfter(SILENT_MS);
  };
  for (const type of ["load", "error"]) image.addEventListener(type, () => { loading = false; });
  const show = (address) => {
    const before = image.src;
    loading = address !== "";
    if (loading) image.src = address; else image.removeAttribute("src");
    if (before !== "") URL.revokeObjectURL(before);
  };
  let pending = false;
  setInterval(async () => {
    if (!live || !shown.checked || pending || calibrating) return;
    pending = true;
    const overlay = await request("GET", `/api/cameras/${id}/overlay`, undefined, TIMEOUT_MS).catch(() => null);
    pending = false;
    // The user may have switched the drawing off while the answer was on its way.
    if (calibrating) return;
    if (overlay === null || !shown.checked) drawing.replaceChildren(); else draw(drawing, overlay);
  }, OVERLAY_INTERVAL_MS);
  shown.addEventListener("change", () => { if (!shown.checked) drawing.replaceChildren(); legend.hidden = !shown.checked; });
  legend.hidden = !calibrated;
  return {
    figure, update, name,
    corners: (pixels) => drawing.replaceChildren(...pixels.map(([x, y]) => svg("circle", { class: "corner", cx: x, cy: y, r: MARK_PX }))),
    pauseOverlay: (paused) => { calibrating = paused; if (!paused) drawing.replaceChildren(); },
    show: (now) => {
      setText(state, now.age === null ? "no frame yet" : `${now.rate.toFixed(0)} frames/s, ${now.age < 10 ? now.age.toFixed(2) : now.age.toFixed(0)} s old`);
      setText(problem, now.problem);
      problem.hidden = now.problem === "";
    },
  };
}

/** Draw the tubes of the model, the measured and the desired tip [pixel]. */
function draw(drawing, { tubes, tip_measured: measured, tip_desired: desired }) {
  const line = (points, sign) => svg("polyline", { class: sign, points: points.map((one) => one.join(",")).join(" ") });
  const mark = (sign, [x, y]) => (sign === "measured" ? svg("circle", { class: sign, cx: x, cy: y, r: MARK_PX })
    : svg("path", { class: sign, d: `M${x - MARK_PX},${y - MARK_PX}l${2 * MARK_PX},${2 * MARK_PX}m0,${-2 * MARK_PX}l${-2 * MARK_PX},${2 * MARK_PX}` }));
  const longest = tubes[0] ?? []; // the innermost tube; the others lie on its line
  drawing.replaceChildren(line(longest, "under"), line(longest, "model"), ...[["measured", measured], ["desired", desired]].filter(([, at]) => at !== null).map(([sign, at]) => mark(sign, at)));
}

async function saveSnapshot(name) {
  try {
    const answer = await fetch(`/api/cameras/${encodeURIComponent(name)}/snapshot`, { cache: "no-store" });
    if (!answer.ok) throw new Error((await answer.json()).error);
    const file = /filename="([^"]+)"/.exec(answer.headers.get("content-disposition") ?? "")?.[1] ?? `${name}.jpg`;
    const link = make("a", { href: URL.createObjectURL(await answer.blob()), download: file });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    note(`saved the picture as ${file}`, true);
  } catch (error) {
    note(`no picture of camera ${name}: ${error.message}`);
  }
}

/** Show a picture in the area of the scene, and all others in the tab; null: all in the tab. */
function setLarge(figure) {
  large.replaceChildren(...(figure === null ? [] : [figure]));
  large.hidden = figure === null;
  $("cameras").replaceChildren(...cameras.map((one) => one.figure).filter((one) => one !== figure), boardBox);
  if (figure !== null && cameras.length === 1) $("cameras").append(make("p", { className: "dim" }, "The picture is next to these controls. Press Small to move it back."));
  updateAll();
}

// ---- calibration with a printed board

const COLUMNS_OF_GRID = 8, GRID_UNIT = 10;
const square = numberField("side of a square of the board [mm]", 35, { min: 5, max: 200, required: true });
const chosen = cameras.map(({ name }, i) => make("input", { type: "checkbox", checked: i < 2, value: name }));
const boardLink = make("a", { target: "_blank", rel: "noopener" }, "Open the board to print");
const setLink = () => { if (square.validity.valid) boardLink.href = `/api/cameras/board.svg?square=${1e-3 * square.number}`; };
square.addEventListener("input", setLink);
setLink();
const startBoard = button("Start", () => square.reportValidity() && sendBoard("/api/cameras/calibration", { cameras: chosen.filter((one) => one.checked).map((one) => one.value), square: 1e-3 * square.number }), { className: "main" });
const finishBoard = button("Compute result", () => sendBoard("/api/cameras/calibration/finish"), { className: "main" }), cancelBoard = button("Cancel", () => sendBoard("/api/cameras/calibration/cancel"));
const boardInstruction = make("p", { className: "task", "aria-live": "polite" }), boardSeen = make("div", { className: "board-seen" }), boardResult = make("div");
const boardForm = make("div", {}, make("p", {}, "Finds the lens of each camera and the pose of a second one, in two to five minutes. Print the board at 100 %, glue it on a flat plate, and hold it still at many places in the pictures, also tilted. The station takes the pictures by itself."),
  make("div", { className: "rows" }, make("span", { className: "dim" }, "cameras"), make("span", { className: "wide acts", style: "margin:0" }, ...chosen.map((one) => make("label", {}, one, ` ${one.value}`))), ...row("square, measured on the print", square, "mm")),
  make("div", { className: "acts" }, startBoard, boardLink));
const boardRun = make("div", { hidden: true }, boardInstruction, boardSeen, make("div", { className: "acts" }, finishBoard, cancelBoard));
const boardBox = make("section", { id: "board" }, make("h3", {}, "Calibrate cameras"), boardForm, boardRun, boardResult);

async function sendBoard(path, body = {}) {
  const answer = await sendCommand("POST", path, body);
  if (answer !== null) showBoard(answer.board);
}

/** Draw which parts of a picture have had a corner of the board. */
function coverageGrid({ coverage }) {
  const parts = coverage.flatMap((cells, y) => cells.map((seen, x) => svg("rect", { x: GRID_UNIT * x, y: GRID_UNIT * y, width: GRID_UNIT - 1, height: GRID_UNIT - 1, class: seen ? "seen" : "" })));
  return svg("svg", { viewBox: `0 0 ${GRID_UNIT * COLUMNS_OF_GRID} ${GRID_UNIT * coverage.length}`, role: "img", "aria-label": "parts of the picture with the board" }, ...parts);
}

function showBoard(board) {
  const running = board !== null && (board.stage === "looking" || board.stage === "solving");
  boardForm.hidden = running;
  boardRun.hidden = !running;
  for (const camera of cameras) {
    const seen = running ? board.cameras[camera.name] : undefined;
    camera.pauseOverlay(seen !== undefined);
    if (seen !== undefined) camera.corners(seen.corners);
  }
  if (board === null) return;
  setText(boardInstruction, running ? board.instruction : "");
  enable(finishBoard, board.stage === "solving" ? "The calibration is being computed" : board.enough ? "" : "The cameras need more pictures of the board");
  boardSeen.replaceChildren(...(running ? Object.entries(board.cameras).map(([name, seen]) => make("figure", {}, coverageGrid(seen),
    make("figcaption", {}, make("b", {}, name), ` ${seen.pictures} pictures, ${seen.corners.length} corners now`))) : []));
  boardResult.replaceChildren(...(board.result.length === 0 ? [] : [
    ...board.result.map((sentence) => make("p", {}, sentence)),
    ...(board.folder === "" ? [] : [make("p", {}, "To use the result, add this line to the station file and start the station again: "), make("code", {}, `calibration = ${JSON.stringify(board.folder)}`)])]));
}

let polling = false;
async function pollBoard() {
  if (!isOpen("cameras") || polling) return;
  polling = true;
  const answer = await request("GET", "/api/cameras/calibration", undefined, TIMEOUT_MS).catch(() => null);
  polling = false;
  if (answer !== null && (answer.board !== null || !boardRun.hidden)) showBoard(answer.board);
}

const updateAll = () => cameras.forEach((camera) => camera.update());

if (cameras.length === 0) {
  $("cameras").append(make("h3", {}, "This station has no camera"),
    make("p", {}, "A camera shows the robot with the model drawn over it, records videos of the runs, and two cameras can measure the tip."),
    make("p", {}, "With a camera on this computer: add a table with its device (they are listed in ", make("code", {}, "/dev/v4l/by-id"), ") to the station file, and start the station again:"),
    make("pre", {}, '[cameras.side]\ndevice = "/dev/video0"'),
    make("p", {}, "Without a camera: ", make("code", {}, "ctr-station serve --lab two_cameras"), " has two simulated ones."));
} else {
  $("left").append(large);
  setLarge(null);
  onTab("cameras", updateAll);
  document.addEventListener("visibilitychange", updateAll);
  const poll = async () => {
    if (!isOpen("cameras") && large.hidden) return;
    const states = await request("GET", "/api/cameras", undefined, TIMEOUT_MS).catch(() => []);
    for (const state of states) cameras.find(({ name }) => name === state.name)?.show(state);
  };
  setInterval(poll, STATE_INTERVAL_MS);
  onTab("cameras", poll);
  poll();
  setInterval(pollBoard, STATE_INTERVAL_MS);
  onTab("cameras", pollBoard);
}
