// The live telemetry, one socket for all of the page: what is known now, and nothing that is not.
const RATE = 20, STALE = 500; // Hz, ms
const listeners = [], openers = [];
let newest = null, heard = -Infinity;

/** Call `opener()` when the stream begins, and each time that it begins anew. */
export const onOpen = (opener) => { openers.push(opener); };
/** Call `listener(sample)` with each one as it comes. */
export const onSample = (listener) => { listeners.push(listener); };
/** The newest sample; null when none has come for half a second. */
export const latestSample = () => (performance.now() - heard < STALE ? newest : null);

/** A vector of a sample; null where it stands from before, or its device is not to be believed: the station knows. */
export const known = (sample, group) => sample[group] ?? null;

/** Whether the run follows a target that moves. */
export const follows = (sample) => sample !== null && sample.phase === "moving" && sample.target_followed > 0;

/** Where the tip should be: at the setpoint, or at the offset from a target that is followed; null when that is not known. [m] */
function wanted(sample, group) {
  if (!follows(sample)) return sample.tip_desired;
  const target = sample.target_seen ? known(sample, group.replace("tip", "target")) : null, offset = known(sample, "target_offset");
  return target && offset && target.map((x, i) => x + offset[i]);
}

/** From `tip_true` or `tip_measured` to where it should be [mm] while a motion is on; else null. */
export function error(sample, group) {
  const tip = sample.phase === "moving" ? known(sample, group) : null, there = tip && wanted(sample, group);
  return there && there.map((x, i) => 1e3 * (x - tip[i]));
}

/** Angle between where the tip points, by `direction_true` or `direction_measured`, and where it should [°]; null where nobody asks, and without a motion. */
export function turned(sample, group) {
  const here = sample.phase === "moving" ? known(sample, group) : null, there = here && known(sample, "direction_desired");
  if (!there) return null;
  const across = Math.hypot(...[0, 1, 2].map((i) => here[(i + 1) % 3] * there[(i + 2) % 3] - here[(i + 2) % 3] * there[(i + 1) % 3]));
  return (180 / Math.PI) * Math.atan2(across, here.reduce((sum, x, i) => sum + x * there[i], 0));
}

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const socket = new WebSocket(`${scheme}://${location.host}/api/telemetry?rate=${RATE}`);
  socket.addEventListener("open", () => { for (const opener of openers) opener(); });
  socket.addEventListener("message", (event) => {
    newest = JSON.parse(event.data);
    heard = performance.now();
    for (const listener of listeners) listener(newest);
  });
  socket.addEventListener("close", () => setTimeout(connect, 1000));
}
connect();
