// Entry point of the page. STOP is in the document itself. Header and tabs are loaded first, then all other parts; a part
// that cannot be loaded leaves the others usable.
import { note, start } from "./page/station.js";

const load = (path) => import(`./${path}.js`).catch((error) => { note(`'${path.split("/")[1]}' could not be loaded (${error.message}); reload the page`); return {}; });

const [{ openPlace = () => {} }] = await Promise.all(["page/tabs", "page/header", "page/layout"].map(load));
openPlace();
start();
for (const path of ["scene/scene", "page/strip", "run/run", "jog/jog", "jog/hands", "devices/devices", "plots/plots", "runs/runs", "calibrate/calibrate", "cameras/cameras", "faults/faults", "guide/notify", "guide/help", "guide/palette", "guide/welcome"]) load(path);
