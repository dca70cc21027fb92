// The page. STOP, header and scene first: they wait for nothing. Then the tabs, each by itself.
import "./stop.js";
import "./operator.js";
import "./header.js";
import "./scene.js";
import { note, start } from "./station.js";
import { last, open } from "./tabs.js";

open(last());
start();
for (const part of ["strip", "run", "jog", "pad", "keys", "goto", "devices", "plots", "runs", "calibrate", "faults"]) {
  import(`./${part}.js`).catch((error) => note(`'${part}' did not come up (${error.message}); reload the page`));
}
