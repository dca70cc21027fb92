// The scene in its frame: under this page's identity, kept connected, and the switches below it.
import { $, ask, client, latest, mayCommand, note, onStatus, press } from "./station.js";

const frame = $("scene"), boxes = [...document.querySelectorAll("#switches input")];

frame.addEventListener("load", () => {
  if (frame.contentDocument === null) return; // no scene: an error page of the browser's
  // viser reconnects only while its document has the focus, which a frame seldom has.
  frame.contentDocument.hasFocus = () => !document.hidden;
  // Its own control panel is empty: all controls are ours.
  const style = frame.contentDocument.createElement("style");
  style.textContent = "[data-testid=floating-panel], #root .mantine-Paper-root, #webgl-software-rendering { display: none !important; }"
    + ` canvas[data-engine] { background: ${getComputedStyle(document.body).backgroundColor}; }`;
  frame.contentDocument.head.append(style);
});
// In the page's colours.
const dark = matchMedia("(prefers-color-scheme: dark)");
const draw = () => { frame.src = `/viser/as/${client}/${dark.matches ? "?darkMode" : ""}`; };
dark.addEventListener("change", draw);
draw();

// A dropped socket: viser looks at the focus only when it changes.
setInterval(() => { if (frame.contentDocument !== null) frame.contentWindow.dispatchEvent(new Event("focus")); }, 2000);

// What lies over it waits for the station; the scene does not.
import("./views.js").catch((error) => note(`the views and the close-up of the tip did not come up (${error.message}); reload the page`));

let changes = 0, pending = 0; // made by this page's person; an older answer must not undo them

for (const box of boxes) {
  box.addEventListener("change", async () => {
    changes += 1;
    pending += 1;
    await press("PUT", "/api/scene", Object.fromEntries(boxes.map((one) => [one.name, one.checked])));
    pending -= 1;
    refresh();
  });
}
$("go").addEventListener("click", () => press("POST", "/api/scene/target/go", {}));

let cut = 0; // looks running that found the scene without its stream

/** What the picture is worth; numbers and STOP are only called live while they are. */
function tellCut(stale) {
  $("scene-cut").hidden = !stale && cut < 3;
  $("scene-cut").textContent = stale ? "Nothing here is live: there is no fresh word from the station." : "The scene is not connected: the picture is not live. Numbers and STOP are.";
}

async function refresh() {
  const before = changes;
  try {
    const shown = await ask("GET", "/api/scene", undefined, 1000);
    cut = shown.connected ? 0 : cut + 1;
    if (pending === 0 && before === changes) for (const box of boxes) box.checked = shown[box.name];
    $("target-box").hidden = !shown.target;
    if (!shown.target) return;
    const target = await ask("GET", "/api/scene/target", undefined, 1000);
    const place = target.position.map((x) => (1e3 * x).toFixed(1)).join(", ");
    const pointing = target.direction === null ? "" : `, pointing (${target.direction.map((x) => x.toFixed(2)).join(", ")})`;
    const where = `(${place}) mm${pointing}`;
    $("target-says").textContent = target.reachable ? `✓ ${where} in ${target.duration.toFixed(0)} s` : `✗ ${where}: ${target.reason}`;
    $("target-says").title = $("target-says").textContent;
    const status = latest();
    $("go").disabled = !target.reachable || status === null || status.state !== "READY" || !mayCommand(status);
  } catch {
    return; // the header says that nobody answers
  }
}
setInterval(refresh, 600);
onStatus((status, stale) => { tellCut(stale); for (const box of boxes) box.disabled = stale || !mayCommand(status); });
refresh();
ask("GET", "/api/bench").then((bench) => { document.querySelector("[name=force]").parentElement.hidden = !bench.virtual; });
