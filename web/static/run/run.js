// Run: the station's experiments, and free motions with custom parameters.
import { $, blockReason, button, confirm, enable, ensureFresh, inPageUnits, latest, make, mayCommand, note, onStatus, request, rigAnswer, sendCommand, withCode, CHECKING, Refused } from "../page/station.js";
import { showReason } from "../page/header.js";
import { form, poseText, refuse, schemas, sentence, variants, withMaximum } from "../page/form.js";
import { card, head, onPlace, openTab, showing } from "../page/tabs.js";
import { go } from "../jog/jog.js";
import { change, origin, rows } from "./waypoint_list.js";
import { box as now } from "./now.js";
import { STIFFNESS_FIELDS, stiffnessForm } from "./stiffness.js";
import { addToQueue, box as queue, repetitions } from "./queue.js";
import { waypoints } from "./waypoints.js";

/** Initial values of form fields without a default, SI. */
const INITIAL_VALUES = {
  circle: { radius: 0.01, period: 20 }, sinusoid: { amplitude: 0.01, frequency: 0.05 }, step: { offset: [0.001, 0, 0] },
  helix: { radius: 0.008, pitch: 0.003, turn: 20, turns: 3 }, force: { direction: [0, 0, 1], force: 0.2 },
  constant: { magnitude: 0.2 }, sine: { amplitude: 0.2, frequency: 0.05 }, raised_cosine: { peak: 0.3, period: 20 },
  trapezoid: { magnitude: 0.3, rise: 1, fall: 1, stay: 10, start: 2 }, tap: { peak: 0.5, start: 2 }, hung_weight: { weight: 0.2 }, ramps: { times: [0, 2.5, 5], magnitudes: [0, 0.5, 0] }, contact: { magnitude: 0.3, place: 0.1 },
  sphere: { center: [0, 0, 0.02], radius: 0.015, stiffness: 200 },
};
const FOLDED_FIELDS = ["task", "direction_weight", "deflection_rate", "tip_velocity", "filter_bandwidth", "observer_bandwidth", "command_interval", "transport_delay", "integrator", "sublink", "direction", "max_speed", "max_acceleration"];
const STREAM_DESCRIPTION = "An external program controls the tip over OpenIGTLink: transforms named Target, in the world frame.";
const NO_TARGET = "Not possible here: no target is measured. Start the station by ctr-station serve --lab breathing, or give the tracker a second coil.";
/** Time for which the tip stays at the last waypoint [s]. */
const FINAL_PAUSE_S = 3;
/** If each joint is at most this far from its start position, the start needs no confirmation [rad, m]. */
const NEAR_START = { rad: 0.02, m: 0.001 };

const content = make("div"); // the list of motions, or the form of one
const motionsView = button("Motions", () => view(false)), runView = enable(button("This run", () => view(true)), "No run is in progress");
$("start").replaceChildren(make("div", { className: "views", role: "group", "aria-label": "shown in this tab" }, motionsView, runView), queue, now, content);
view(false);

/** Show the run in progress, or the motions: each in the place of the other, so that nothing moves. */
function view(ofRun) {
  now.hidden = !ofRun;
  content.hidden = ofRun;
  motionsView.setAttribute("aria-pressed", String(!ofRun));
  runView.setAttribute("aria-pressed", String(ofRun));
  $("start").scrollTop = 0;
}

let running = ""; // id of the run in progress
onStatus((status) => {
  if (status === null) return; // no answer: what the station did last stays visible
  const run = status.state === "RUNNING" && status.run ? status.run.id : "";
  enable(runView, run === "" ? "No run is in progress" : "");
  if (run === running) return;
  const isWriting = content.contains(document.activeElement) && document.activeElement.matches("input, select, textarea");
  if (run === "" || !isWriting) view(run !== "");
  running = run;
});
let loaded = null, starting = false, blockedReason = "", rig = null, submitButton = null, refusal = null;

/** Show a form; its button `label` starts a motion. */
function open(title, children, label, onStart) {
  submitButton = make("button", { type: "submit", className: "main" }, label);
  refusal = make("span", { className: "small dim refusal" });
  const element = make("form", {}, head("all motions", overview, title), ...children, make("div", { className: "acts sticky" }, submitButton, refusal));
  element.addEventListener("submit", async (event) => {
    event.preventDefault();
    starting = true;
    refresh();
    if (await ensureFresh()) await onStart(); // disabled meanwhile, because the station first checks the path on the model
    starting = false;
  });
  content.replaceChildren(element);
  view(false);
  refresh();
}

/** Start a run and show its warnings, except warnings that were already shown. */
async function startRun(body, shownWarnings = []) {
  const answer = await sendCommand("POST", "/api/start", body, (text) => refuse(content.querySelector("form"), text));
  for (const text of answer?.warnings ?? []) if (!shownWarnings.includes(text)) note(`started, but ${text}`);
}

const missingTarget = (kind) => (kind === "follow" && !rig.can_track_target ? NO_TARGET : "");

/** Return the title of a kind of motion; "hold" is also a state of the station. */
const motionTitle = (kind) => (kind === "hold" ? "stay" : kind.replaceAll("_", " "));

async function overview() {
  showing("start", "");
  // The descriptions come at once; the check of every motion on the model takes seconds, and longer on a busy computer.
  const described = loaded ?? request("GET", "/api/experiments?check=false").catch((error) => error);
  const all = await schemas(), motions = Object.entries(variants(all, all.Start.properties.trajectory));
  const experiments = make("div", {}, make("p", { className: "dim" }, "loading …"));
  submitButton = null;
  content.replaceChildren(experiments);
  // The free motions come below the experiments, when the list of these has its length; nothing moves then.
  const addFree = () => {
    if (!experiments.isConnected || experiments.nextSibling !== null) return;
    content.append(make("h3", {}, "Free motions, from the current pose"), make("div", { className: "cards" },
      ...motions.map(([kind, schema]) => card(motionTitle(kind), [sentence(schema), missingTarget(kind)], () => motion(kind, schema, all))),
      // The API description contains StreamAgreement only if the gateway accepts targets.
      all.StreamAgreement && card("external target", [STREAM_DESCRIPTION], () => streamForm(all))));
  };
  try {
    const first = await described;
    if (first instanceof Error) throw first;
    showExperiments(experiments, first);
    addFree();
    const now = await request("GET", "/api/experiments"); // a user may have edited experiment files meanwhile
    if (JSON.stringify(now) !== JSON.stringify(loaded)) showExperiments(experiments, loaded = now);
  } catch (error) {
    experiments.replaceChildren(make("p", { className: "mind" }, `the experiments could not be loaded: ${error.message}`), button("Try again", overview));
    addFree();
  }
}

/** Return why no case can start here: the file is invalid, or all cases are refused; empty if a case can start. */
const refusalOf = (one) => one.error || (one.cases.every((each) => each.refused !== "") ? one.cases[0].refused : "");

/** Title of each group of experiments. */
const GROUPS = { paper: "Figures of the paper", station: "More experiments", mine: "Mine" };

function showExperiments(list, all) {
  const unavailable = all.filter((one) => refusalOf(one) !== ""), offered = all.filter((one) => refusalOf(one) === "");
  list.replaceChildren(...Object.entries(GROUPS).flatMap(([group, title]) => {
    const cards = offered.filter((one) => one.group === group).map((one) =>
      card(one.name.replaceAll("_", " "), [one.title, one.checked ? "" : "checking on the model …"], () => experiment(one), make("img", { src: `/api/experiments/${one.name}/picture.svg`, alt: "", width: 116, height: 58, loading: "lazy" })));
    return cards.length === 0 ? [] : [make("h3", {}, title), make("div", { className: "cards" }, ...cards)];
  }));
  if (unavailable.length) list.append(make("details", { open: unavailable.some((one) => one.error !== "") },
    make("summary", {}, `${unavailable.length} that cannot be started here`), ...groupedByReason(unavailable)));
}

/** Open a case of an experiment (by default the first case) from another part of the page. */
export async function openExperiment(name, caseName) {
  openTab("start");
  const all = loaded ?? await request("GET", "/api/experiments?check=false").catch(() => []);
  const one = all.find((each) => each.name === name && each.error === "");
  if (one === undefined || !one.cases.some((each) => each.name === (caseName ?? each.name))) note(`'${name}${caseName === undefined ? "" : `, ${caseName}`}' is not an experiment of this station any more`);
  else experiment(one, caseName);
  if (!content.hasChildNodes()) await overview();
}

/** Open the form of a free motion. */
export async function openMotion(kind) {
  openTab("start");
  const all = await schemas();
  motion(kind, variants(all, all.Start.properties.trajectory)[kind], all);
}

/** Open the form of a recorded run with its settings, and press its button. */
export async function runAgain(id) {
  let run;
  try { run = await request("GET", `/api/runs/${encodeURIComponent(id)}/settings`); } catch (error) { note(error.message); return; }
  const { experiment: name, case: caseName, settings } = run, all = await schemas(), schema = variants(all, all.Start.properties.trajectory)[settings.trajectory?.kind];
  if (name === "" && schema === undefined) { note("this run has no settings to run again: an external program controlled it"); return; }
  openTab("start");
  if (name !== "") await openExperiment(name, caseName);
  else if (settings.trajectory.kind === "waypoints") restoreMotion({ ...settings, start: null }, schema, all);
  else motion(settings.trajectory.kind, schema, all, settings);
  if (submitButton !== null && !submitButton.disabled) submitButton.form.requestSubmit();
}

/** Return the unavailable experiments, grouped by their reason. */
const groupedByReason = (all) => [...new Set(all.map(refusalOf))].map((reason) => make("p", { className: "small" },
  make("b", {}, all.filter((one) => refusalOf(one) === reason).map((one) => one.name.replaceAll("_", " ")).join(", ")), ": ", ...withCode(inPageUnits(reason))));

function experiment(one, caseName = one.cases[0].name) {
  showing("start", `experiment/${one.name}${caseName === one.cases[0].name ? "" : `/${caseName}`}`);
  const select = make("select", { "aria-label": "case", className: "wide" }, ...one.cases.map((each) => make("option", { value: each.name, selected: each.name === caseName }, each.words)));
  const facts = make("div", { className: "rows" });
  const drawn = make("img", { alt: `path and load of ${one.name}`, width: 288, height: 144, style: "background:#fff;border-radius:6px;filter:var(--drawing)" });
  const show = () => {
    const chosen = one.cases.find((each) => each.name === select.value);
    drawn.src = `/api/experiments/${one.name}/picture.svg?case=${encodeURIComponent(chosen.name)}`;
    const lines = chosen.facts.map((fact) => [fact.what, fact.text, "wide"]);
    lines.push(...chosen.warnings.map((text) => ["warning", inPageUnits(text), "wide mind"]));
    if (chosen.refused !== "") lines.push(["not available", inPageUnits(chosen.refused), "wide mind"]);
    facts.replaceChildren(...lines.flatMap(([key, text, className]) => [make("span", { className: "dim" }, key), make("span", { className }, text)]));
    blockedReason = chosen.refused === "" ? "" : "not available on this station";
    refresh();
    return chosen;
  };
  select.addEventListener("change", show);
  show();
  open(one.name.replaceAll("_", " "), [make("p", {}, one.title), drawn, make("p", { className: "small dim" }, "left: path of the tip; right: load over the motion"),
    make("div", { className: "rows" }, make("label", {}, "case"), select), make("h3", {}, "What it does"), facts], "Start experiment", async () => {
    const chosen = show(), now = latest().joints;
    const farFromStart = rig.joints.some((joint) => !(Math.abs(now[joint.name] - chosen.start[joint.name]) < NEAR_START[joint.unit]));
    if (farFromStart && !await confirm(`Start ${one.name}?`, "Start",
      make("p", {}, "The robot first goes to the start pose, all joints at the same time:"), make("p", {}, poseText(rig.joints, chosen.start)),
      make("p", { className: "dim" }, `Now: ${poseText(rig.joints, now)}. Check that the path is clear. STOP works at any time.`))) return;
    await startRun({ experiment: one.name, case: chosen.name }, chosen.warnings);
  });
  const repeat = repetitions();
  submitButton.after(button("Add to queue", () => addToQueue({ experiment: one.name, case: select.value }, repeat)),
    ...(one.cases.length > 1 ? [button(`Add all ${one.cases.length} cases to queue`, () => addToQueue({ experiment: one.name }, repeat))] : []), repeat.element);
}

function union(all, field, kind, title, values = INITIAL_VALUES[kind]) {
  const { installed, ...own } = variants(all, field), kinds = installed && rig.loads.length > 0 ? { ...own, installed } : own;
  const select = make("select", { "aria-label": title }, ...Object.keys(kinds).map((one) => make("option", { value: one }, one.replaceAll("_", " "))));
  const fields = make("div"), description = make("p", { className: "small dim" });
  let chosen = null;
  const show = () => {
    chosen = form(kinds[select.value], { values: select.value === kind ? values : INITIAL_VALUES[select.value], more: FOLDED_FIELDS,
      choices: { name: rig.loads } });
    description.textContent = sentence(kinds[select.value]);
    fields.replaceChildren(chosen.element);
  };
  select.value = kind;
  select.addEventListener("change", show);
  show();
  return { element: make("fieldset", {}, make("legend", {}, title), select, description, fields), read: () => chosen.read() };
}

/** Return the fields of the controller: {element, read()}. Without `yields` the stiffness of the tip is not offered. */
function controllerForm(all, values = rig.controller, yields = true) {
  const control = form(all.ControllerFile, { values, more: FOLDED_FIELDS, skip: STIFFNESS_FIELDS, choices: { strategy: rig.strategies, inner: rig.inner } });
  const stiffness = yields ? stiffnessForm(all.ControllerFile, values) : null;
  return { element: make("div", {}, make("fieldset", {}, make("legend", {}, "Control"), control.element), stiffness?.element), read: () => ({ ...control.read(), ...stiffness?.read() }) };
}

function motion(kind, schema, all, values = {}) {
  showing("start", `motion/${kind}`);
  const holdsForce = ["force", "palpate"].includes(kind);
  const path = form(holdsForce ? withMaximum(schema, "force", rig.max_desired_force) : schema, { values: { ...INITIAL_VALUES[kind], ...values.trajectory }, more: FOLDED_FIELDS, skip: ["points"] });
  // Only the virtual lab can apply a load; on a real rig a person attaches it.
  const load = rig.virtual ? union(all, all.Start.properties.load, values.load?.kind ?? "none", "Load on the simulated tip", values.load) : null;
  const control = controllerForm(all, values.controller, !holdsForce);
  const time = form({ properties: { duration: all.Start.properties.duration }, required: ["duration"] }, { values: { duration: values.duration ?? 60 } });
  const read = () => ({ trajectory: { ...path.read(), ...(table && { points: table.read() }) }, ...(load && { load: load.read() }), controller: control.read(), ...time.read() });
  blockedReason = missingTarget(kind);
  const table = kind === "waypoints" ? waypointTable(path, control, time) : null;
  open(kind.replaceAll("_", " "), [make("p", {}, sentence(schema)),
    make("p", { className: "small dim" }, `If the force on the tip exceeds ${rig.max_force.toPrecision(2)} N, the motion ends in HOLD (${rig.max_force_reason}).${rig.model && ` ${rig.model[0].toUpperCase()}${rig.model.slice(1)}.`}`),
    make("fieldset", {}, make("legend", {}, "Motion"), table?.element, path.element, time.element,
      table && saved(kind, () => ({ ...read(), ...(origin() && { start: origin().joints }) }), (stored) => restoreMotion(stored, schema, all))),
    load?.element, control.element], "Start motion", () => startRun(read()));
  const repeat = repetitions();
  submitButton.after(button("Add to queue", () => { if (submitButton.form.reportValidity()) addToQueue(read(), repeat); }), repeat.element);
}

/** Show the form of a run that follows external targets while this page is operator. */
function streamForm(all) {
  const bounds = form(all.StreamAgreement, { skip: ["frame", "controller"], more: ["acceleration", "silence"] });
  const control = controllerForm(all);
  blockedReason = "";
  open("external target", [make("p", {}, STREAM_DESCRIPTION),
    make("p", { className: "small dim" }, "The tip does not move before the first target arrives. The first program that sends a target controls the tip until it disconnects. Keep this page open, and STOP within reach."),
    make("fieldset", {}, make("legend", {}, "Bounds"), bounds.element), control.element],
  "Start following", () => sendCommand("POST", "/api/gateway/target", { ...bounds.read(), controller: control.read() }, (text) => refuse(content.querySelector("form"), text)));
}

/**
 * Return the table of waypoints of a motion's form. The check of the waypoints uses the form's other fields. The duration
 * in the form is set such that all waypoints are reached.
 */
function waypointTable(path, control, time) {
  const table = waypoints(() => ({ ...limits(path.read()), controller: control.read() }), go);
  const duration = time.element.querySelector("input");
  const update = () => {
    blockedReason = table.blockedReason();
    if (blockedReason === "") duration.value = Math.ceil(rows().at(-1)[0] + FINAL_PAUSE_S);
    refresh();
  };
  table.element.addEventListener("places", update);
  update();
  for (const one of [path.element, control.element]) one.addEventListener("change", table.recheck);
  return table;
}
const limits = ({ max_speed, max_acceleration }) => ({ max_speed, max_acceleration });

/**
 * Return the fields for saving and loading motions of a kind, which the station stores as experiments. `motionOf()` returns
 * the motion of the form; `restore(motion)` fills the form with a loaded motion.
 */
function saved(kind, motionOf, restore) {
  const name = make("input", { type: "text", maxLength: 60, pattern: "[A-Za-z0-9_][A-Za-z0-9_\\-]*", placeholder: "name", title: "letters, digits, _ and -", "aria-label": "name to save it under" });
  const list = make("select", { "aria-label": "saved motions" });

  async function store(replace) {
    const body = motionOf();
    try {
      const { note: message } = await request("PUT", `/api/experiments/${encodeURIComponent(name.value)}`, { ...body, replace });
      note(`${message}; ctr-station run ${name.value} runs it, too`, true);
      refreshList();
    } catch (error) {
      const exists = !replace && error instanceof Refused && error.message.includes("exists already");
      if (!exists) note(error.message);
      else if (await confirm(`Replace '${name.value}'?`, "Replace", make("p", {}, `'${name.value}' exists already. Its file will be overwritten.`))) await store(true);
    }
  }

  const save = button("Save", () => {
    name.required = true;
    const may = name.form.reportValidity();
    name.required = false; // required only for saving
    if (may) store(false);
  });
  const loadBox = make("label", { hidden: true }, list, " ", button("Load", async () => {
    try { restore(await request("GET", `/api/experiments/${encodeURIComponent(list.value)}/motion`)); name.value = list.value; } catch (error) { note(error.message); }
  }));

  async function refreshList() {
    const all = await request("GET", "/api/experiments").catch(() => []);
    list.replaceChildren(...all.filter((one) => one.cases[0]?.trajectory === kind).map((one) => make("option", { value: one.name }, one.name)));
    if (name.value) list.value = name.value;
    loadBox.hidden = list.options.length === 0;
  }
  refreshList();
  return make("div", { className: "acts" }, name, save, loadBox);
}

/** Show a saved motion in its form. The start pose of the motion is the saved one; without one, the current pose. */
function restoreMotion(stored, schema, all) {
  change({ rows: stored.trajectory.points, origin: stored.start === null ? null : { tip: null, joints: stored.start } });
  motion("waypoints", schema, all, stored);
}

function refresh() {
  const status = latest();
  if (submitButton === null || status === null) return;
  const ready = status.state === "READY", mayStart = mayCommand(status);
  enable(submitButton, starting ? CHECKING : blockedReason || blockReason(status, false, ["READY"]));
  if (ready && mayStart && blockedReason !== "") { refusal.dataset.shown = ""; refusal.textContent = blockedReason; } else showReason(refusal, status);
}
onStatus(refresh);

rig = await rigAnswer();
const isShown = onPlace("start", async (place) => {
  const [what, name, caseName] = place.split("/"), all = await schemas(), kinds = variants(all, all.Start.properties.trajectory);
  if (what === "experiment") openExperiment(name, caseName);
  else if (what === "motion" && name in kinds) motion(name, kinds[name], all);
  else overview();
});
if (!isShown) await overview();
