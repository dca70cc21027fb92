// Run: experiments that come with the station, and free motions with parameters of one's own.
import { $, ask, confirm, fresh, latest, make, mayCommand, note, onStatus, press } from "./station.js";
import { tellWhy } from "./acts.js";
import { inPageUnits } from "./units.js";
import { form, poseText, schemas, sentence, variants } from "./form.js";
import { go } from "./goto.js";
import { change, origin, rows } from "./places.js";
import { saved } from "./saved.js";
import { waypoints } from "./waypoints.js";

/** Where a form begins for what has no default. SI. */
const FIRST = {
  circle: { radius: 0.01, period: 20 }, sinusoid: { amplitude: 0.01, frequency: 0.05 }, step: { offset: [0.001, 0, 0] },
  helix: { radius: 0.008, pitch: 0.003, turn: 20, turns: 3 },
  constant: { magnitude: 0.2 }, sine: { amplitude: 0.2, frequency: 0.05 }, raised_cosine: { peak: 0.3, period: 20 },
  trapezoid: { magnitude: 0.3, rise: 1, fall: 1, stay: 10, start: 2 }, tap: { peak: 0.5, start: 2 }, hung_weight: { weight: 0.2 }, ramps: { times: [0, 2.5, 5], magnitudes: [0, 0.5, 0] }, contact: { magnitude: 0.3, place: 0.1 },
};
const MORE = ["task", "direction_weight", "deflection_rate", "tip_velocity", "filter_bandwidth", "observer_bandwidth", "hold", "transport", "sublink", "direction", "max_speed", "max_acceleration"];
const TARGET = "The tip goes where a program says over OpenIGTLink: transforms named Target, in the world.";
/** After the last place [s]. */
const STAY = 3;
/** A start pose nearer than this needs no confirmation [rad, m]. */
const NEAR = { rad: 0.02, m: 0.001 };

let known = null, starting = false, unable = "", bench = null, startButton = null, refusal = null;

function card(title, text, picture, act) {
  const image = picture === null ? null : make("img", { src: picture, alt: "", width: 116, height: 58 });
  const button = make("button", { type: "button", className: "card" }, image, make("div", {}, make("b", {}, title), make("span", {}, text)));
  button.addEventListener("click", act);
  return button;
}

function back(title) {
  const button = make("button", { type: "button" }, "‹ all motions");
  button.addEventListener("click", overview);
  return make("div", { className: "acts", style: "margin:0 0 10px" }, button, make("b", {}, title));
}

function starter(label, act) {
  startButton = make("button", { type: "submit", className: "main" }, label);
  unable = "";
  refusal = make("span", { className: "small dim" });
  const frame = make("div", { className: "acts sticky" }, startButton, refusal);
  return { frame, on: (element) => element.addEventListener("submit", async (event) => {
    event.preventDefault();
    startButton.disabled = starting = true;
    if (await fresh()) await act(); // the way is tried on the model first, which takes a moment
    starting = false;
  }) };
}

/** Start, and tell what a person should know about it and was not told before. */
async function begin(wish, told = []) {
  const answer = await press("POST", "/api/start", wish);
  for (const text of answer?.warnings ?? []) if (!told.includes(text)) note(`started, but ${text}`);
}

async function overview() {
  const all = await schemas(), motions = Object.entries(variants(all, all.StartIn.properties.trajectory));
  const experiments = make("div", { className: "cards" }, make("p", { className: "dim" }, "being checked on the model …"));
  startButton = null;
  $("start").replaceChildren(
    make("h3", {}, "Experiments"), experiments,
    make("h3", {}, "Free motions, from where the robot is"),
    make("div", { className: "cards" }, ...motions.map(([kind, schema]) =>
      card(kind.replaceAll("_", " "), sentence(schema), null, () => motion(kind, schema, all))),
    // The station tells of these only where it takes targets.
    all.LeadIn && card("target from outside", TARGET, null, () => led(all))),
  );
  if (known !== null) listed(experiments, known);
  try {
    const now = await ask("GET", "/api/experiments"); // one's own may have been edited meanwhile
    if (JSON.stringify(now) !== JSON.stringify(known)) listed(experiments, known = now);
  } catch (error) {
    const again = make("button", { type: "button" }, "Ask again");
    again.addEventListener("click", overview);
    experiments.replaceChildren(make("p", { className: "mind" }, `the experiments are not known: ${error.message}`), again);
  }
}

/** Why none of its cases can be started here: its file is none, or all of them are for another robot; else empty. */
const unfit = (one) => one.error || (one.cases.every((each) => each.refused !== "") ? one.cases[0].refused : "");

function listed(place, all) {
  const misfits = all.filter((one) => unfit(one) !== "");
  place.replaceChildren(...all.filter((one) => unfit(one) === "").map((one) =>
    card(one.name.replaceAll("_", " "), one.title, `/api/experiments/${one.name}/picture.svg`, () => experiment(one))));
  if (misfits.length) place.append(make("details", { open: misfits.some((one) => one.error !== "") },
    make("summary", {}, `${misfits.length} that cannot be started here`), ...grouped(misfits)));
}

/** Experiments that cannot be started, those with the same reason together. */
const grouped = (all) => [...new Set(all.map(unfit))].map((why) => make("p", { className: "small" },
  make("b", {}, all.filter((one) => unfit(one) === why).map((one) => one.name.replaceAll("_", " ")).join(", ")), `: ${inPageUnits(why)}`));

async function experiment(one) {
  const select = make("select", { "aria-label": "case", className: "wide" }, ...one.cases.map((each) => make("option", { value: each.name }, each.words)));
  const facts = make("div", { className: "rows" });
  const drawn = make("img", { alt: `path and load of ${one.name}`, width: 288, height: 144, style: "background:#fff;border-radius:6px" });
  const show = () => {
    const chosen = one.cases.find((each) => each.name === select.value);
    drawn.src = `/api/experiments/${one.name}/picture.svg?case=${encodeURIComponent(chosen.name)}`;
    const lines = chosen.facts.map((fact) => [fact.what, fact.text, "wide"]);
    lines.push(...chosen.warnings.map((text) => ["warning", inPageUnits(text), "wide mind"]));
    if (chosen.refused !== "") lines.push(["not here", inPageUnits(chosen.refused), "wide mind"]);
    facts.replaceChildren(...lines.flatMap(([key, text, className]) => [make("span", { className: "dim" }, key), make("span", { className }, text)]));
    unable = chosen.refused === "" ? "" : "not on this station";
    refresh();
    return chosen;
  };
  select.addEventListener("change", show);
  const { frame, on } = starter("Start experiment", async () => {
    const chosen = show(), now = latest().joints;
    const far = bench.joints.some((joint) => !(Math.abs(now[joint.name] - chosen.start[joint.name]) < NEAR[joint.unit]));
    if (far && !await confirm(`Start ${one.name}?`, "Start",
      make("p", {}, "The robot first goes to the start pose, all joints at the same time:"), make("p", {}, poseText(bench.joints, chosen.start)),
      make("p", { className: "dim" }, `Now: ${poseText(bench.joints, now)}. Look that the way is clear; STOP works all the time.`))) return;
    await begin({ experiment: one.name, case: chosen.name }, chosen.warnings);
  });
  const whole = make("form", {}, back(one.name), make("p", {}, one.title),
    drawn,
    make("p", { className: "small dim" }, "left: path of the tip; right: load over the motion"),
    make("div", { className: "rows" }, make("label", {}, "case"), select), make("h3", {}, "What it does"), facts, frame);
  on(whole);
  $("start").replaceChildren(whole);
  $("start").scrollTop = 0;
  show();
  refresh();
}

function union(all, field, kind, title, values = FIRST[kind]) {
  const kinds = variants(all, field), select = make("select", { "aria-label": title }, ...Object.keys(kinds).map((one) => make("option", { value: one }, one.replaceAll("_", " "))));
  const place = make("div"), said = make("p", { className: "small dim" });
  let chosen = null;
  const show = () => {
    chosen = form(kinds[select.value], { values: select.value === kind ? values : FIRST[select.value], more: MORE });
    said.textContent = sentence(kinds[select.value]);
    place.replaceChildren(chosen.element);
  };
  select.value = kind;
  select.addEventListener("change", show);
  show();
  return { element: make("fieldset", {}, make("legend", {}, title), select, said, place), read: () => chosen.read() };
}

async function motion(kind, schema, all, values = {}) {
  const path = form(schema, { values: { ...FIRST[kind], ...values.trajectory }, more: MORE, skip: ["points"] });
  // On a bench nobody but a person hangs anything at the tip.
  const load = bench.virtual ? union(all, all.StartIn.properties.load, values.load?.kind ?? "none", "Load on the simulated tip", values.load) : null;
  const control = form(all.ControllerFile, { values: values.controller ?? bench.controller, more: MORE, choices: { strategy: bench.strategies, inner: bench.inner } });
  const time = form({ properties: { duration: all.StartIn.properties.duration }, required: ["duration"] }, { values: { duration: values.duration ?? 60 } });
  const read = () => ({ trajectory: { ...path.read(), ...(table && { points: table.read() }) }, ...(load && { load: load.read() }), controller: control.read(), ...time.read() });
  const { frame, on } = starter("Start motion", () => begin(read()));
  const table = kind === "waypoints" ? taught(path, control, time) : null;
  const whole = make("form", {}, back(kind.replaceAll("_", " ")), make("p", {}, sentence(schema)),
    make("fieldset", {}, make("legend", {}, "Motion"), table?.element, path.element, time.element,
      table && saved(kind, () => ({ ...read(), ...(origin() && { start: origin().joints }) }), (kept) => takeUp(kept, schema, all))),
    load?.element, make("fieldset", {}, make("legend", {}, "Control"), control.element), frame);
  on(whole);
  $("start").replaceChildren(whole);
  $("start").scrollTop = 0;
  refresh();
}

/** A run whose tip goes where targets from outside say, as long as this page keeps control. */
async function led(all) {
  const bounds = form(all.LeadIn, { skip: ["frame", "controller"], more: ["acceleration", "silence"] });
  const control = form(all.ControllerFile, { values: bench.controller, more: MORE, choices: { strategy: bench.strategies, inner: bench.inner } });
  const { frame, on } = starter("Start following", () => press("POST", "/api/gateway/target", { ...bounds.read(), controller: control.read() }));
  const whole = make("form", {}, back("target from outside"), make("p", {}, TARGET),
    make("p", { className: "small dim" }, "Nothing moves before a target comes. The first program that sends one leads until it leaves; keep this page open, and STOP within reach."),
    make("fieldset", {}, make("legend", {}, "Bounds"), bounds.element), make("fieldset", {}, make("legend", {}, "Control"), control.element), frame);
  on(whole);
  $("start").replaceChildren(whole);
  $("start").scrollTop = 0;
  refresh();
}

/** The table of places in the form of a motion: tried with what else the form says, as long as the places last. */
function taught(path, control, time) {
  const table = waypoints(() => ({ ...limits(path.read()), controller: control.read() }), go);
  const duration = time.element.querySelector("input");
  const last = () => {
    unable = table.unable();
    if (unable === "") duration.value = Math.ceil(rows().at(-1)[0] + STAY);
    refresh();
  };
  table.element.addEventListener("places", last);
  last();
  for (const one of [path.element, control.element]) one.addEventListener("change", table.again);
  return table;
}
const limits = ({ max_speed, max_acceleration }) => ({ max_speed, max_acceleration });

/** A motion that was kept, in its form: it begins where it began then. */
function takeUp(kept, schema, all) {
  change({ rows: kept.trajectory.points, origin: { tip: null, joints: kept.start } });
  motion("waypoints", schema, all, kept);
}

function refresh() {
  const status = latest();
  if (startButton === null || status === null) return;
  const ready = status.state === "READY", may = mayCommand(status);
  startButton.disabled = !ready || !may || starting || unable !== "";
  if (ready && may && unable !== "") { refusal.dataset.shown = ""; refusal.textContent = unable; } else tellWhy(refusal, status);
}
onStatus(refresh);

bench = await ask("GET", "/api/bench");
await overview();
