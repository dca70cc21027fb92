// The page: each part looks after itself.
import "./header.js";
import "./scene.js";
import "./run.js";
import "./jog.js";
import "./devices.js";
import "./plots.js";
import "./runs.js";
import "./faults.js";
import { start } from "./station.js";
import { open } from "./tabs.js";

open("start");
start();
