// Entry point of the page. STOP, header and scene load first and independently; then the modules of each tab separately.
import "./page/stop.js";
import "./page/header.js";
import "./page/layout.js";
import "./scene/scene.js";
import { note, start } from "./page/station.js";
import { openPlace } from "./page/tabs.js";

openPlace();
start();
for (const path of ["page/strip", "run/run", "jog/jog", "jog/hands", "devices/devices", "plots/plots", "runs/runs", "calibrate/calibrate", "cameras/cameras", "faults/faults", "guide/notify", "guide/help", "guide/palette", "guide/welcome"]) {
  import(`./${path}.js`).catch((error) => note(`'${path.split("/")[1]}' could not be loaded (${error.message}); reload the page`));
}
