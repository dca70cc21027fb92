// Entry point of the page. STOP, header and scene load first and independently; then each tab separately.
import "./stop.js";
import "./operator.js";
import "./header.js";
import "./scene.js";
import { note, start } from "./station.js";
import { lastTab, openTab } from "./tabs.js";

openTab(lastTab());
start();
for (const module of ["strip", "run", "jog", "pad", "keys", "goto", "devices", "plots", "runs", "calibrate", "faults"]) {
  import(`./${module}.js`).catch((error) => note(`'${module}' could not be loaded (${error.message}); reload the page`));
}
