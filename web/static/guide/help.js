// Help: what the states, the keys and the marks mean, and the switches of sounds. Opened by "?" or by its button.
import { $, button, make } from "../page/station.js";
import { switches } from "./notify.js";

const STATES = [
  ["OFF", "no device is connected: press Connect"],
  ["CONNECTING", "the devices are searched and set up; the first start also compiles the model for a minute or more"],
  ["CONNECTED", "the devices answer, but the positions of the joints are unknown: home the stages"],
  ["READY", "nothing moves, and a motion can start"],
  ["RUNNING, HOMING", "the robot moves"],
  ["HOLD", "a fault or a limit has ended the motion; the robot keeps its position, motors on; Reset leads back to READY"],
  ["STOPPED", "an operator or viewer has pressed STOP; Reset leads back to READY"],
  ["FAULT", "a device or a program has failed and every axis was stopped; remove the cause, then press Reset"],
];
const KEYS = [
  ["Shift+Space", "STOP, wherever the focus is"],
  ["Escape", "while something moves, or while the data are old: STOP; but an open question is closed instead, so use Shift+Space there"],
  ["", "at rest: closes what is open: a question, this help, the list of actions or the tour"],
  ["Ctrl+K", "list of all actions, by name"],
  ["← →", "next tab; width of the controls while their border has the focus"],
  ["Space, held", "jogs while the focus is on a button of the tab Jog"],
  ["?", "this help"],
];
const TIPS = [
  ["desired", "where the tip should be now"],
  ["measured", "where the tracker measures the tip, with its noise and delay"],
  ["estimated", "where the model puts the tip, from joints and force only, without the tracker"],
  ["true", "where the simulated tip is; only a virtual lab knows it, and the controller never does"],
];

const WORDS = [
  ["error", "distance of the tip from its desired position"],
  ["deflection", "distance by which the load moves the tip, from the model and the measured force"],
  ["force", "force on the tip, from the force sensors, filtered"],
  ["working pose", "pose with room for motions in all directions; the robot goes there after homing"],
  ["zero (tare)", "set the force sensors to zero while nothing touches the tubes"],
  ["missed", "periods of the 500 Hz control loop that this computer was too busy to keep"],
  ["MCAP", "format of the recordings; CSV, Parquet and MATLAB files are made from it"],
];

const list = (rows) => make("dl", {}, ...rows.flatMap(([term, text]) => [make("dt", {}, term), make("dd", {}, text)]));

const dialog = make("dialog", { id: "help", "aria-labelledby": "help-title" },
  make("h2", { id: "help-title" }, "Help"),
  make("h3", {}, "States"), list(STATES),
  make("h3", {}, "Keys"), list(KEYS),
  make("h3", { id: "help-tips" }, "Four marks of the tip"), list(TIPS),
  make("h3", {}, "Words"), list(WORDS),
  make("h3", {}, "Notifications"), switches(),
  make("p", {}, make("a", { href: "/api/docs", target: "_blank" }, "REST interface"), " for scripts"),
  make("menu", {}, button("Close", () => dialog.close(), { className: "main" })));
document.querySelector("main").append(dialog);

/** Open the help below the header, so that STOP stays free; a second call closes it. */
export function toggleHelp() {
  if (dialog.open) dialog.close(); else dialog.show();
  dialog.scrollTop = 0; // the focus is on the switches at its end
}

// A help mark elsewhere on the page opens its section: the event's detail is the last part of the section's id.
document.addEventListener("help", ({ detail }) => {
  dialog.show();
  $(`help-${detail}`).scrollIntoView();
});

$("tools").append(button("?", toggleHelp, { title: "Help (?)", "aria-label": "help" }));
document.addEventListener("keydown", (event) => {
  const typing = event.target.closest?.("input, textarea, select") != null;
  if (event.key === "?" && !typing) toggleHelp();
  else if (event.key === "Escape" && dialog.open) { event.preventDefault(); dialog.close(); } // while something moves, Escape has been taken for STOP
});
