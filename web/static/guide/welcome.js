// First visit: one obvious thing to do, and three sentences about the page. Shown once per browser.
import { $, button, make, mayCommand, onStatus, sendCommand } from "../page/station.js";
import { openTab } from "../page/tabs.js";

const STEPS = [
  ["stop", "STOP, or Shift+Space, stops every axis at once, at any time."],
  ["state-box", "This part shows the state of the station and what you can do next."],
  ["strip", "During a run: distance of the tip from its desired position, force, deflection and time left."],
];

if (localStorage.getItem("welcomed") === null) welcome();

function welcome() {
  const demo = button("Run the demo (1 min)", runDemo, { className: "main" });
  const reason = make("span", { className: "small dim" });
  const box = make("div", { id: "welcome" }, make("h2", {}, "Welcome"),
    make("p", {}, "The demo drives the tip of the simulated robot along a circle while a load pulls at it."),
    make("div", { className: "acts" }, demo, button("Show me around", () => tour(0)), button("Close", close)), reason);
  $("panel").insertBefore(box, $("tabs"));

  async function runDemo() {
    openTab("start");
    if (await sendCommand("POST", "/api/start", { experiment: "demo" })) close();
  }

  onStatus((status) => {
    demo.hidden = status !== null && !status.simulated; // a real robot starts from its form, after a look at the bench
    demo.disabled = status === null || status.state !== "READY" || !mayCommand(status);
    reason.textContent = demo.hidden || !demo.disabled ? "" : status === null ? "" : status.next;
  });

  function close() {
    localStorage.setItem("welcomed", "yes");
    unmark();
    box.remove();
  }

  function tour(step) {
    unmark();
    if (step === STEPS.length) { close(); return; }
    const [id, text] = STEPS[step];
    $(id).classList.add("pointed-at");
    box.replaceChildren(make("p", {}, `${step + 1} of ${STEPS.length}: ${text}`),
      make("div", { className: "acts" }, button(step + 1 < STEPS.length ? "Next" : "Done", () => tour(step + 1), { className: "main" }), button("Skip", close)));
    box.querySelector("button").focus();
  }
}

function unmark() {
  for (const one of document.querySelectorAll(".pointed-at")) one.classList.remove("pointed-at");
}
