// Calibrate: guided procedures, their results, and a checklist for exchanged tubes.
import { $, blockReason, button, clock, confirm, dateTime, enable, ensureFresh, latest, make, mayCommand, note, onStatus, request, sendCommand, setText, Refused } from "../page/station.js";
import { showReason } from "../page/header.js";
import { row, schemas } from "../page/form.js";
import { card, head, isOpen, onPlace, onTab, showing } from "../page/tabs.js";
import { numberList } from "../page/number.js";

let info = await request("GET", "/api/calibration");
const titles = Object.fromEntries(info.offers.map((offer) => [offer.name, offer.title]));
const content = make("div"), courseBox = make("div", { id: "course", "aria-live": "polite" });
$("calibrate").append(courseBox, content);

const about = (seconds) => (seconds < 90 ? `about ${Math.round(seconds / 10) * 10} s` : `about ${Math.round(seconds / 60)} min`);

// ---- the running calibration, or the result of the last one

const bar = make("progress", { max: 1, "aria-label": "progress of the calibration" }), message = make("p", { className: "small" });
const instruction = make("p", { className: "task" }), done = button("", () => sendAction("done"), { className: "main big" });
const abort = button("Abort", () => sendAction("abort")), title = make("b"), left = make("span", { className: "dim live" });
const instructionBox = make("div", { id: "asked", hidden: true }, instruction, make("div", { className: "acts" }, done));
const runningBox = make("fieldset", {}, make("legend", {}, "Now"), make("div", { className: "acts", style: "margin:0" }, title, left),
  bar, message, instructionBox, make("div", { className: "acts" }, abort));
const ended = make("p", { className: "ended" }), dismiss = () => { dismissed = true; show(); };
const showResults = button("Show results", () => { dismiss(); details(course.result); }, { className: "main" });
const endedBox = make("fieldset", {}, make("legend", {}, "Ended"), ended, make("div", { className: "acts" }, showResults, button("Dismiss", dismiss)));
let takesFocus = false; // whether the button of a manual step takes the focus as soon as it is enabled
let course = info.course, wasOn = false, dismissed = course !== null && !course.on;
courseBox.append(runningBox, endedBox);

async function sendAction(action, body = {}) {
  const answer = await sendCommand("POST", `/api/calibration/${action}`, body);
  if (answer !== null) { course = answer.course; show(); }
  return answer !== null;
}

function show() {
  const on = course !== null && course.on;
  if (on) dismissed = false;
  if (!on && wasOn && overviewShown && isOpen("calibrate")) overview(); // a form or a result that the user opened stays
  if (!on && wasOn && course?.stage === "done") note(`calibrate ${course.what}: done`, true);
  wasOn = on;
  runningBox.hidden = !on;
  endedBox.hidden = on || course === null || dismissed;
  if (course === null) return;
  setText(title, titles[course.what]);
  setText(left, `${Math.round(100 * course.done)} %, ${course.instruction === "" ? `about ${clock(course.left)} left` : "waiting for you"}`);
  bar.value = course.done;
  setText(message, course.message);
  const needsAction = course.instruction !== "";
  if (needsAction && instructionBox.hidden) { // a manual step is required from now on
    if (isOpen("calibrate")) takesFocus = true;
    else note(`Calibrate: ${course.instruction}`, true);
  }
  instructionBox.hidden = !needsAction;
  setText(instruction, course.instruction);
  setText(done, course.weight > 0 ? "Weight attached" : "Weight removed");
  setText(ended, course.stage === "done" ? `${titles[course.what]}: done in ${clock(course.elapsed)}.`
    : `${titles[course.what]}: ${course.stage === "failed" ? "no result" : "ended"}, nothing was written. Cause: ${course.message}.`);
  showResults.hidden = course.result === "";
  enableActions();
}

// ---- available procedures

let starter = null, reason = null, overviewShown = false;

function enableActions() {
  const status = latest(), mayStart = mayCommand(status);
  for (const control of [done, abort]) enable(control, blockReason(status));
  if (takesFocus && mayStart) { // a disabled button cannot have the focus
    takesFocus = false;
    queueMicrotask(() => done.focus());
  }
  if (starter === null || status === null) return;
  const on = course !== null && course.on;
  enable(starter, on ? "One procedure at a time" : blockReason(status, false, ["READY"]));
  if (on) { setText(reason, "one procedure at a time"); delete reason.dataset.shown; } else showReason(reason, status);
}

const back = (heading) => head("all procedures", overview, heading);

function offerCard(offer) {
  const effort = offer.missing !== "" ? `${offer.missing}, which this bench does not have` : `${about(offer.seconds)}${offer.needs === "" ? "" : ` · needs ${offer.needs}`}`;
  const clears = offer.name === info.clearing ? "Clears “not calibrated” in the picture of the robot." : "";
  const shown = card(offer.title, [offer.sentence, effort, clears], () => procedure(offer));
  return enable(shown, offer.missing === "" ? "" : effort);
}

async function overview() {
  starter = null;
  overviewShown = true;
  showing("calibrate", "");
  const stored = make("div", { className: "cards" });
  content.replaceChildren(
    make("h3", {}, "Procedures"), make("div", { className: "cards" }, ...info.offers.map(offerCard)),
    make("h3", {}, "Other tubes"), make("div", { className: "cards" },
      card("Tube exchange", ["Which calibrations remain valid after tubes were exchanged, and which to repeat."], exchange)),
    make("h3", {}, "Results"), inUse(), stored,
  );
  try {
    const results = await request("GET", "/api/calibration/results", undefined, 5000);
    stored.replaceChildren(...results.map((entry) => card(entry.title, [`${dateTime(new Date(entry.made))} · ${entry.simulated ? "simulated rig" : entry.bench}`, entry.findings[0] ?? ""], () => details(entry.name))));
    if (results.length === 0) stored.append(make("p", { className: "dim" }, "Nothing has been calibrated yet."));
  } catch (error) {
    if (error instanceof Refused) note(error.message);
  }
}

function procedure(offer) {
  showing("calibrate", offer.name);
  const effort = make("select", { "aria-label": "effort" }, ...[["0.5", "quick: half the poses"], ["1", "usual"], ["2", "thorough: twice as many poses"]].map(([value, text]) => make("option", { value, selected: value === "1" }, text)));
  const weights = numberList("known weights [N]", info.weights, { required: true });
  const durationText = make("span", { className: "wide" });
  const showDuration = () => {
    const seconds = offer.seconds + (offer.weighs ? offer.weight_seconds * (weights.numbers.length - info.weights.length) : 0);
    durationText.textContent = about(seconds * (offer.scales ? Number(effort.value) : 1));
  };
  effort.addEventListener("change", showDuration);
  weights.addEventListener("input", showDuration);
  showDuration();
  starter = make("button", { type: "submit", className: "main" }, `Start: ${offer.title}`);
  reason = make("span", { className: "small dim" });
  const form = make("form", {}, back(offer.title), make("p", {}, offer.sentence),
    offer.needs === "" ? null : make("p", {}, "Prepare: ", make("b", {}, offer.needs), "."),
    make("div", { className: "rows" }, ...(offer.scales ? row("effort", effort) : []), ...(offer.weighs ? row("weights", weights, "N") : []),
      make("span", { className: "dim" }, "duration"), durationText),
    make("p", { className: "small dim", style: "margin-top:8px" }, "STOP and Abort end the procedure at any time; then nothing is written."),
    make("div", { className: "acts sticky" }, starter, reason));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    if (!await ensureFresh()) return;
    const clearBox = make("label", {}, make("input", { type: "checkbox" }), "The path is clear: I have checked.");
    if (!await confirm(`Start ${offer.title}?`, "Start",
      make("p", {}, "The tubes will repeatedly turn and slide through their whole workspace. Is the path clear of all objects?"), clearBox)) return;
    const body = { what: offer.name, way_is_clear: true };
    if (offer.scales) body.effort = Number(effort.value);
    if (offer.weighs) body.weights = weights.numbers;
    if (await sendAction("start", body)) overview();
  });
  overviewShown = false;
  content.replaceChildren(form);
  enableActions();
}

// ---- results

async function details(name) {
  let stored;
  try {
    stored = await request("GET", `/api/calibration/results/${encodeURIComponent(name)}`, undefined, 5000);
  } catch (error) {
    note(error.message);
    return;
  }
  starter = null;
  overviewShown = false;
  showing("calibrate", `result/${name}`);
  const file = (entry) => `/api/calibration/results/${encodeURIComponent(name)}/${encodeURIComponent(entry)}`;
  const copy = (text) => make("div", { className: "copied" }, make("code", {}, text), button("Copy", () =>
    navigator.clipboard.writeText(text).then(() => note("copied", true), () => note("the browser does not allow this page to copy; select the text"))));
  content.replaceChildren(
    back(stored.title), make("p", { className: "small dim" }, `${dateTime(new Date(stored.made))} · ${stored.bench} · ${stored.visits} visits, ${clock(stored.robot_s)} of robot time · ${stored.name}`),
    ...stored.findings.map((sentence) => make("p", {}, sentence)),
    make("div", { className: "acts" }, make("a", { href: file("report.html"), target: "_blank", rel: "noopener" }, "Report with figures"),
      ...stored.files.filter((entry) => entry !== "report.html").map((entry) => make("a", { href: file(entry), download: "" }, entry))),
    make("h3", {}, "Use the result"), inUse(), ...(stored.use.line === "" ? [make("p", {}, stored.use.text)] : [
      make("div", { className: "acts" }, enable(button("Apply…", () => apply(stored), { className: "main" }), info.in_use.endsWith(`/${stored.name}`) ? "The station uses this result already" : ""), make("span", { className: "small dim" },
        info.in_use.endsWith(`/${stored.name}`) ? "" : `Written to ${info.file || "this session"}; the station then restarts.`)),
      make("details", {}, make("summary", {}, "Use it elsewhere"), make("p", {}, stored.use.text), copy(stored.use.line))]),
    make("h3", {}, "Estimated values"),
    make("table", { id: "found" }, make("tr", {}, ...["", "before", "found", "± (95 %)"].map((text) => make("th", {}, text))),
      ...stored.found.map((entry) => make("tr", {}, make("td", { className: "any" }, entry.name), make("td", { className: "number" }, entry.before), make("td", { className: "number" }, entry.found), make("td", { className: "number" }, entry.interval)))),
  );
}

/** Return which calibration the station uses, with a button that undoes the last choice. */
const inUse = () => make("div", { className: "acts", style: "margin:0 0 8px" },
  make("span", {}, info.in_use === "" ? "The station uses no calibration." : `In use: ${info.in_use.split("/").at(-1)}`),
  info.can_undo ? button("Undo…", () => choose("/api/calibration/undo", "Use the earlier calibration?", "Undo", info.file === "" ? "" : `${info.file} gets its earlier text.`)) : null);

const apply = (stored) => choose(`/api/calibration/results/${encodeURIComponent(stored.name)}/apply`, `Apply ${stored.title}?`, "Apply",
  info.file === "" ? "The station uses the result until its program ends, because it was started without a station file."
    : `The line ${stored.use.line} is written to ${info.file}.`);

/** Change the calibration in use after a confirmation, wait until the station has restarted, and load the page again. */
async function choose(path, title, action, text) {
  if (!await confirm(title, action, text && make("p", {}, text), make("p", {}, "The station then restarts, which takes some seconds; real stages may have to be homed again. “Undo” in this tab takes it back.")) || !await ensureFresh()) return;
  if (await sendCommand("POST", path, {}) === null) return;
  note("The station restarts with the other calibration.", true);
  const before = info.in_use;
  const wait = setInterval(async () => {
    const now = await request("GET", "/api/calibration", undefined, 2000).catch(() => null);
    if (now === null || now.in_use === before) return;
    clearInterval(wait);
    location.reload();
  }, 1000);
}

// ---- exchanged tubes

function exchange() {
  showing("calibrate", "exchange");
  starter = null;
  overviewShown = false;
  const robot = make("select", { "aria-label": "robot with the new tubes" }, ...info.robots.map((entry) => make("option", { value: entry }, entry.replaceAll("_", " "))));
  const file = make("input", { type: "file", accept: ".toml", "aria-label": "robot's file" });
  const list = make("ol", { className: "todo" });
  let latest = 0; // an answer to an outdated request is ignored
  const requestTodo = async (body) => {
    const number = (latest += 1);
    const items = await sendCommand("POST", "/api/calibration/exchange", body);
    if (items === null || number !== latest) return;
    list.replaceChildren(...items.map((entry) => {
      const offer = info.offers.find((other) => other.name === entry.procedure);
      return make("li", {}, make("label", {}, make("input", { type: "checkbox" }), ` ${entry.text} `), offer?.missing === "" ? button(offer.title, () => procedure(offer)) : null);
    }));
  };
  robot.addEventListener("change", () => requestTodo({ robot: robot.value }));
  file.addEventListener("change", async () => {
    const [chosen] = file.files, most = (await schemas()).ExchangeIn.properties.file.anyOf[0].maxLength;
    if (chosen?.size > most) note(`The file has ${chosen.size} bytes; a robot's file has at most ${most}. Choose the robot's .toml file.`);
    else if (chosen !== undefined) requestTodo({ file: await chosen.text() });
  });
  content.replaceChildren(back("Tube exchange"), make("p", {}, "Select the robot with the new tubes:"),
    make("div", { className: "rows" }, ...row("one of these", robot), ...row("or its file", file)), list);
  requestTodo({ robot: robot.value });
}

// ---- polling

async function refresh() {
  try {
    info = await request("GET", "/api/calibration", undefined, 2000);
    course = info.course;
    show();
  } catch {
    return; // the page's header reports that the station does not answer
  }
}
// While the tab is closed, poll less often. Polling continues, because a note must report when the user must act.
let count = 0;
setInterval(() => { if (isOpen("calibrate") || count++ % 4 === 0) refresh(); }, 500);
onTab("calibrate", (open) => { if (open) { refresh(); enableActions(); } });
onStatus(enableActions);
show();
const isShown = onPlace("calibrate", (place) => {
  const [what, name] = place.split("/"), offer = info.offers.find((one) => one.name === (what === "clearing" ? info.clearing : what));
  if (what === "result") details(name);
  else if (what === "exchange") exchange();
  else if (offer?.missing === "") procedure(offer);
  else overview();
});
if (!isShown) await overview();
