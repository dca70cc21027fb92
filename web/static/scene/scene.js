// The scene in its frame, which is loaded under this page's identity and reconnects; and the switches below the scene.
import { $, blockReason, client, enable, latest, make, note, onStatus, request, rigAnswer, sendCommand } from "../page/station.js";

const trueDiameter = make("input", { type: "checkbox", name: "true_diameter" });
$("switches").querySelector("div").append(make("label", { title: "Draw the tubes at their true diameter instead of magnified" }, trueDiameter, "true diameter"));
const frame = $("scene"), boxes = [...document.querySelectorAll("#switches input")];

frame.addEventListener("load", () => {
  if (frame.contentDocument === null) return; // the scene was not loaded, and the browser shows an error page
  // viser reconnects only while its document has the focus, which a frame seldom has.
  frame.contentDocument.hasFocus = () => !document.hidden;
  // viser's control panel is hidden, because it is empty: this page has all controls.
  const style = frame.contentDocument.createElement("style");
  style.textContent = "[data-testid=floating-panel], #root .mantine-Paper-root, #webgl-software-rendering { display: none !important; }"
    + ` canvas[data-engine] { background: ${getComputedStyle(document.body).backgroundColor}; }`;
  frame.contentDocument.head.append(style);
});
// The scene follows the page's theme.
const darkTheme = matchMedia("(prefers-color-scheme: dark)");
const loadScene = () => { frame.src = `/viser/as/${client}/${darkTheme.matches ? "?darkMode" : ""}`; };
darkTheme.addEventListener("change", loadScene);
loadScene();

// After a dropped connection viser checks the focus only when a focus event arrives.
setInterval(() => { if (frame.contentDocument !== null) frame.contentWindow.dispatchEvent(new Event("focus")); }, 2000);

// Views and close-up are imported separately, so that the scene does not wait for the answer that they need.
import("./overlays.js").catch((error) => note(`the views and the close-up of the tip could not be loaded (${error.message}); reload the page`));

let userChanges = 0, pending = 0; // changes by the user, and unanswered requests; an older answer must not undo a change

for (const box of boxes) {
  box.addEventListener("change", async () => {
    userChanges += 1;
    pending += 1;
    await sendCommand("PUT", "/api/scene", Object.fromEntries(boxes.map((one) => [one.name, one.checked])));
    pending -= 1;
    refresh();
  });
}
$("go").addEventListener("click", () => sendCommand("POST", "/api/scene/target/go", {}));

const PERIOD_MS = 600; // pause between two requests for the view options
let disconnectedPolls = 0; // consecutive polls without a connected scene

/** Show a message if only the scene is disconnected. While the page has no data, its banner is below the header. */
function showConnection(stale) {
  $("scene-cut").hidden = stale || disconnectedPolls < 3;
  $("scene-cut").textContent = "The 3D picture is frozen. Numbers and STOP still work.";
}

async function refresh() {
  const before = userChanges;
  try {
    const settings = await request("GET", "/api/scene", undefined, 1000);
    disconnectedPolls = settings.connected ? 0 : disconnectedPolls + 1;
    if (pending === 0 && before === userChanges) for (const box of boxes) box.checked = settings[box.name];
    if ($("magnified")) $("magnified").hidden = settings.true_diameter;
    $("target-box").hidden = !settings.target;
    if (!settings.target) return;
    const target = await request("GET", "/api/scene/target", undefined, 5000); // the check on the model takes a second on a busy computer
    const position = target.position.map((x) => (1e3 * x).toFixed(1)).join(", ");
    const direction = target.direction === null ? "" : `, pointing (${target.direction.map((x) => x.toFixed(2)).join(", ")})`;
    const targetText = `(${position}) mm${direction}`;
    $("target-says").textContent = target.reachable ? `✓ reachable: ${targetText}; the motion takes ${target.duration.toFixed(0)} s` : `✗ ${targetText}: ${target.reason}`;
    $("target-says").title = $("target-says").textContent;
    enable($("go"), target.reachable ? blockReason(latest(), false, ["READY"]) : target.reason);
  } catch {
    return; // the page's header reports that the station does not answer
  }
}
// Old data does not disable the switches: on a busy computer they would flicker, and the station checks every change.
onStatus((status, stale) => { showConnection(stale); for (const box of boxes) enable(box, blockReason(status)); });
(async () => { for (;;) { await refresh(); await new Promise((then) => setTimeout(then, PERIOD_MS)); } })();
rigAnswer().then((rig) => { document.querySelector("[name=force]").parentElement.hidden = !rig.virtual; });
