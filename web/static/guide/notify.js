// What happens is visible in another tab, too: title and icon of the page; on request also sounds and notifications.
import { $, clock, isSilent, make, onStatus } from "../page/station.js";
import { local } from "../page/storage.js";

const COLOURS = { READY: "#007a59", RUNNING: "#0072b2", HOMING: "#0072b2", CONNECTING: "#0072b2", HOLD: "#c77d00", STOPPED: "#c77d00", FAULT: "#c62828" };
const ENDS = { READY: "The run is complete", HOLD: "HOLD", STOPPED: "STOPPED", FAULT: "FAULT" };
const TONES_HZ = { READY: [660, 880], HOLD: [520, 390], STOPPED: [520, 390], FAULT: [390, 260, 390] };
const TONE_S = 0.16;

// ---- title and icon

function icon(state) {
  const shape = state === "READY" ? "<circle cx='24' cy='24' r='7'/>" : state in ENDS ? "<rect x='17' y='17' width='14' height='14'/>" : "<path d='M17 16l14 8-14 8z'/>";
  const picture = `<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 32 32'><path d='M5 26V13C5 6 12 4 22 5' fill='none' stroke='#0072b2' stroke-width='5' stroke-linecap='round'/><g fill='${COLOURS[state] ?? "#777777"}'>${shape}</g></svg>`;
  return `data:image/svg+xml,${encodeURIComponent(picture)}`;
}

let finished = ""; // title of the run that has ended while the page was hidden
document.addEventListener("visibilitychange", () => { if (!document.hidden) finished = ""; });

function title(status) {
  if (status === null) return isSilent() ? "NO ANSWER" : "ctr-station"; // not silent: the page has just been opened
  const { run, state } = status;
  if (state !== "RUNNING" || run === null) return state !== "READY" ? state : finished === "" ? "ctr-station" : `complete · ${finished}`;
  return run.phase === "moving" ? `${Math.round(100 * run.progress)} % · ${clock(run.duration * (1 - run.progress))} left · ${run.title}` : `${run.phase} · ${run.title}`;
}

// ---- sounds and notifications, by choice of the user

const chosen = (what) => local.get(what) === "on";
let audio = null;

function beep(state) {
  audio ??= new AudioContext();
  for (const [number, frequency] of TONES_HZ[state].entries()) {
    const tone = audio.createOscillator(), start = audio.currentTime + 1.1 * TONE_S * number;
    tone.frequency.value = frequency;
    tone.connect(audio.destination);
    tone.start(start);
    tone.stop(start + TONE_S);
  }
}

function report(status) {
  if (status.state === "READY" && document.hidden) finished = status.run.title;
  const text = status.state === "READY" ? status.run.title : status.message;
  if (chosen("sounds")) beep(status.state);
  if (chosen("notifications") && document.hidden && window.Notification?.permission === "granted") new Notification(ENDS[status.state], { body: text, tag: "ctr-station" });
}

/** Return the switches of sounds and notifications. */
export function switches() {
  const box = (what, text, prepare) => {
    const input = make("input", { type: "checkbox", checked: chosen(what) });
    input.addEventListener("change", async () => {
      if (input.checked) input.checked = await prepare();
      local.set(what, input.checked ? "on" : "off");
    });
    return make("label", {}, input, text);
  };
  return make("div", {},
    box("sounds", "sound at the end of a run, and at HOLD, STOP and FAULT", async () => { beep("READY"); return true; }),
    box("notifications", "notification of the browser while this page is hidden", async () => await window.Notification?.requestPermission() === "granted"));
}

let before = null;
onStatus((status, stale) => {
  const state = status?.state ?? "";
  if (state !== before) $("icon").href = icon(state);
  watchEnd(status, stale);
  document.title = title(status);
});

/** Report the end of a run, and a state that ends one. */
function watchEnd(status, stale) {
  if (stale || status === null) return;
  const { state } = status;
  if (state !== "READY") finished = "";
  const ended = before === "RUNNING" && status.run !== null ? state in ENDS : ["HOLD", "STOPPED", "FAULT"].includes(state) && before !== null;
  if (ended && state !== before) report(status);
  before = state;
}
