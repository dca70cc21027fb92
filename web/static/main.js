// The page. Header and scene first: they wait for nothing. Then the tabs, each by itself.
import "./header.js";
import "./scene.js";
import { note, start } from "./station.js";
import { open } from "./tabs.js";

open("start");
start();
for (const part of ["run", "jog", "goto", "devices", "plots", "runs", "calibrate", "faults"]) {
  import(`./${part}.js`).catch((error) => note(`the tab '${part}' did not come up (${error.message}); reload the page`));
}
