// Calibrate: procedures that a person is guided through, what they found, and what to do after tubes were exchanged.
import { $, ask, confirm, fresh, latest, make, mayCommand, note, onStatus, press, Refused } from "./station.js";
import { tellWhy } from "./acts.js";
import { isOpen, onTab } from "./tabs.js";

const known = await ask("GET", "/api/calibration");
const titles = Object.fromEntries(known.offers.map((offer) => [offer.name, offer.title]));
const place = make("div"), now = make("div", { id: "course", "aria-live": "polite" });
$("calibrate").append(now, place);

const clock = (seconds) => {
  const whole = Math.max(0, Math.round(seconds));
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
};
const about = (seconds) => (seconds < 90 ? `about ${Math.round(seconds / 10) * 10} s` : `about ${Math.round(seconds / 60)} min`);
const row = (label, control, unit = "") => [make("label", {}, label), control, make("span", { className: "unit" }, unit)];

// ---- the procedure that is on, or how the last one has ended

const bar = make("progress", { max: 1, "aria-label": "progress of the calibration" }), says = make("p", { className: "small" });
const task = make("p", { className: "task" }), done = make("button", { type: "button", className: "main big" });
const abort = make("button", { type: "button" }, "Abort"), title = make("b"), left = make("span", { className: "dim live" });
done.addEventListener("click", () => command("done"));
abort.addEventListener("click", () => command("abort"));
const asking = make("div", { id: "asked" }, task, make("div", { className: "acts" }, done));
const onIt = make("fieldset", {}, make("legend", {}, "Now"), make("div", { className: "acts", style: "margin:0" }, title, left),
  bar, says, asking, make("div", { className: "acts" }, abort));
const ended = make("p", { className: "ended" }), look = make("button", { type: "button", className: "main" }, "What was found"), seen = make("button", { type: "button" }, "All right");
const over = make("fieldset", {}, make("legend", {}, "Ended"), ended, make("div", { className: "acts" }, look, seen));
let course = known.course, wasOn = false, dismissed = course !== null && !course.on;
seen.addEventListener("click", () => { dismissed = true; show(); });
look.addEventListener("click", () => { dismissed = true; show(); details(course.result); });
now.append(onIt, over);

async function command(what) {
  const answer = await press("POST", `/api/calibration/${what}`, {});
  if (answer !== null) { course = answer.course; show(); }
}

/** Texts are only touched when they change: a person may be selecting them. */
const put = (element, text) => { if (element.textContent !== text) element.textContent = text; };

function show() {
  const on = course !== null && course.on;
  if (on) dismissed = false;
  if (on !== wasOn && isOpen("calibrate")) overview();
  if (!on && wasOn && course?.stage === "done") note(`calibrate ${course.what}: done`, true);
  wasOn = on;
  onIt.hidden = !on;
  over.hidden = on || course === null || dismissed;
  if (course === null) return;
  put(title, titles[course.what]);
  put(left, `${Math.round(100 * course.done)} %, ${course.asked === "" ? `about ${clock(course.left)} left` : "waiting for you"}`);
  bar.value = course.done;
  put(says, course.says);
  const asked = course.asked !== "";
  if (asked && asking.hidden) { // it has become a person's turn
    if (isOpen("calibrate")) queueMicrotask(() => done.focus());
    else note(`Calibrate: ${course.asked}`, true);
  }
  asking.hidden = !asked;
  put(task, course.asked);
  put(done, course.hangs > 0 ? "Weight attached" : "Weight removed");
  put(ended, course.stage === "done" ? `${titles[course.what]}: done in ${clock(course.elapsed)}.`
    : `${titles[course.what]}: ${course.stage === "failed" ? "no result" : "ended"}, nothing was written. The cause: ${course.says}.`);
  look.hidden = course.result === "";
  enable();
}

// ---- what can be begun

let starter = null, why = null;

function enable() {
  const status = latest(), may = status !== null && mayCommand(status);
  done.disabled = abort.disabled = !may;
  if (starter === null || status === null) return;
  const on = course !== null && course.on;
  starter.disabled = on || !may || status.state !== "READY";
  if (on) { put(why, "one procedure at a time"); delete why.dataset.shown; } else tellWhy(why, status);
}

function card(heading, text, small, act) {
  const button = make("button", { type: "button", className: "card" }, make("div", {}, make("b", {}, heading), make("span", {}, text), small === "" ? null : make("span", {}, small)));
  button.addEventListener("click", act);
  return button;
}

function back(heading) {
  const button = make("button", { type: "button" }, "‹ all procedures");
  button.addEventListener("click", overview);
  return make("div", { className: "acts", style: "margin:0 0 10px" }, button, make("b", {}, heading));
}

async function overview() {
  starter = null;
  const kept = make("div", { className: "cards" });
  place.replaceChildren(
    make("h3", {}, "Procedures"), make("div", { className: "cards" }, ...known.offers.map((offer) =>
      card(offer.title, offer.sentence, `${about(offer.seconds)}${offer.needs === "" ? "" : ` · needs ${offer.needs}`}`, () => procedure(offer)))),
    make("h3", {}, "Other tubes"), make("div", { className: "cards" },
      card("Tube exchange", "What of an earlier calibration still holds after tubes were exchanged, and what to do again.", "", exchange)),
    make("h3", {}, "Found so far"), kept,
  );
  try {
    const found = await ask("GET", "/api/calibration/results", undefined, 5000);
    kept.replaceChildren(...found.map((one) => card(one.title, `${new Date(one.made).toLocaleString()} · ${one.simulated ? "simulated bench" : one.bench}`, one.findings[0] ?? "", () => details(one.name))));
    if (found.length === 0) kept.append(make("p", { className: "dim" }, "Nothing has been calibrated yet."));
  } catch (error) {
    if (error instanceof Refused) note(error.message);
  }
}

function procedure(offer) {
  const effort = make("select", { "aria-label": "effort" }, ...[["0.5", "quick: half the poses"], ["1", "usual"], ["2", "thorough: twice the poses"]].map(([value, text]) => make("option", { value }, text)));
  effort.value = "1";
  const weights = make("input", { type: "text", value: known.weights.join(", "), required: true, "aria-label": "known weights [N]" });
  const long = make("span", { className: "wide" });
  const hung = () => weights.value.split(",").map(Number);
  const tell = () => {
    const seconds = offer.seconds + (offer.weighs ? offer.weight_seconds * (hung().length - known.weights.length) : 0);
    long.textContent = about(seconds * (offer.scales ? Number(effort.value) : 1));
  };
  effort.addEventListener("change", tell);
  weights.addEventListener("input", tell);
  tell();
  starter = make("button", { type: "submit", className: "main" }, `Start: ${offer.title}`);
  why = make("span", { className: "small dim" });
  const form = make("form", {}, back(offer.title), make("p", {}, offer.sentence),
    offer.needs === "" ? null : make("p", {}, "Have at hand: ", make("b", {}, offer.needs), "."),
    make("div", { className: "rows" }, ...(offer.scales ? row("effort", effort) : []), ...(offer.weighs ? row("weights", weights, "N") : []),
      make("span", { className: "dim" }, "takes"), long),
    make("p", { className: "small dim", style: "margin-top:8px" }, "STOP and Abort end it at any time; then nothing is written."),
    make("div", { className: "acts sticky" }, starter, why));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    if (!await fresh()) return;
    const sure = make("label", {}, make("input", { type: "checkbox" }), "The way is clear: I have looked.");
    if (!await confirm(`Start ${offer.title}?`, "Start",
      make("p", {}, "The tubes will move through their whole workspace, turn and slide, again and again. Is the way clear of everything?"), sure)) return;
    const wish = { what: offer.name, way_is_clear: true };
    if (offer.scales) wish.effort = Number(effort.value);
    if (offer.weighs) wish.weights = hung();
    const answer = await press("POST", "/api/calibration/start", wish);
    if (answer !== null) { course = answer.course; show(); }
  });
  place.replaceChildren(form);
  enable();
}

// ---- what was found

async function details(name) {
  let kept;
  try {
    kept = await ask("GET", `/api/calibration/results/${encodeURIComponent(name)}`, undefined, 5000);
  } catch (error) {
    note(error.message);
    return;
  }
  starter = null;
  const file = (one) => `/api/calibration/results/${encodeURIComponent(name)}/${encodeURIComponent(one)}`;
  const copy = (text) => {
    const button = make("button", { type: "button" }, "Copy");
    button.addEventListener("click", () => navigator.clipboard.writeText(text).then(() => note("copied", true), () => note("the browser does not let this page copy; select the text")));
    return make("div", { className: "copied" }, make("code", {}, text), button);
  };
  place.replaceChildren(
    back(kept.title), make("p", { className: "small dim" }, `${new Date(kept.made).toLocaleString()} · ${kept.bench} · ${kept.visits} visits, ${clock(kept.robot_s)} of robot time · ${kept.name}`),
    ...kept.findings.map((sentence) => make("p", {}, sentence)),
    make("div", { className: "acts" }, make("a", { href: file("report.html"), target: "_blank", rel: "noopener" }, "Report with figures"),
      ...kept.files.filter((one) => one !== "report.html").map((one) => make("a", { href: file(one), download: "" }, one))),
    make("h3", {}, "How to use it"), make("p", {}, kept.use.text),
    ...[kept.use.line, kept.use.options].filter((text) => text !== "").map(copy),
    make("h3", {}, "What was found"),
    make("table", { id: "found" }, make("tr", {}, ...["", "before", "found", "± (95 %)"].map((text) => make("th", {}, text))),
      ...kept.found.map((one) => make("tr", {}, make("td", { className: "any" }, one.name), make("td", { className: "number" }, one.before), make("td", { className: "number" }, one.found), make("td", { className: "number" }, one.interval)))),
  );
}

// ---- other tubes

function exchange() {
  starter = null;
  const robot = make("select", { "aria-label": "robot with the new tubes" }, ...known.robots.map((one) => make("option", { value: one }, one)));
  const file = make("input", { type: "file", accept: ".toml", "aria-label": "robot's file" });
  const list = make("ol", { className: "todo" });
  let latest = 0; // an answer that comes after a later question is of no use any more
  const ask_ = async (wish) => {
    const mine = (latest += 1);
    const todo = await press("POST", "/api/calibration/exchange", wish);
    if (todo === null || mine !== latest) return;
    list.replaceChildren(...todo.map((one) => {
      const offer = known.offers.find((each) => each.name === one.procedure);
      const go = offer === undefined ? null : make("button", { type: "button" }, offer.title);
      go?.addEventListener("click", () => procedure(offer));
      return make("li", {}, make("label", {}, make("input", { type: "checkbox" }), ` ${one.text} `), go);
    }));
  };
  robot.addEventListener("change", () => ask_({ robot: robot.value }));
  file.addEventListener("change", async () => { if (file.files.length > 0) ask_({ file: await file.files[0].text() }); });
  place.replaceChildren(back("Tube exchange"), make("p", {}, "Which robot will it be?"),
    make("div", { className: "rows" }, ...row("one of these", robot), ...row("or its file", file)), list);
  ask_({ robot: robot.value });
}

// ---- looks

async function refresh() {
  try {
    course = (await ask("GET", "/api/calibration", undefined, 2000)).course;
    show();
  } catch {
    return; // the header says that nobody answers
  }
}
// Also with the tab closed, now and then: a person is told when it is their turn.
let count = 0;
setInterval(() => { if (isOpen("calibrate") || count++ % 4 === 0) refresh(); }, 500);
onTab("calibrate", (open) => { if (open) { refresh(); enable(); } });
onStatus(enable);
show();
await overview();
