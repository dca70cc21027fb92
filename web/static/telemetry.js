// The live telemetry: one socket for the whole page. Stale and invalid values are returned as null.
const RATE_HZ = 20, STALE_AFTER_MS = 500; // requested samples [Hz]; age from which the newest sample is stale [ms]
const listeners = [], openers = [];
let newestSample = null, receivedAt = -Infinity;

/** Call `opener()` whenever the stream is connected or reconnected. */
export const onOpen = (opener) => { openers.push(opener); };
/** Call `listener(sample)` with each received sample. */
export const onSample = (listener) => { listeners.push(listener); };
/** Return the newest telemetry sample; null if none was received for half a second. */
export const latestSample = () => (performance.now() - receivedAt < STALE_AFTER_MS ? newestSample : null);

/** Return a vector of a telemetry sample; null if the station marks it as stale or its device as faulty. */
export const valueOf = (sample, group) => sample[group] ?? null;

/** Return whether the run follows a moving target. */
export const follows = (sample) => sample !== null && sample.phase === "moving" && sample.target_followed > 0;

/** Return the desired position of the tip [m]: the setpoint, or a followed target plus its offset; null if unknown. */
function desiredTip(sample, group) {
  if (!follows(sample)) return sample.tip_desired;
  const target = sample.target_visible ? valueOf(sample, group.replace("tip", "target")) : null, offset = valueOf(sample, "target_offset");
  return target && offset && target.map((x, i) => x + offset[i]);
}

/** Return the vector from `tip_true` or `tip_measured` to the desired tip [mm] during a motion; otherwise null. */
export function error(sample, group) {
  const tip = sample.phase === "moving" ? valueOf(sample, group) : null, desired = tip && desiredTip(sample, group);
  return desired && desired.map((x, i) => 1e3 * (x - tip[i]));
}

/**
 * Angle from `direction_true` or `direction_measured` to the desired direction [°]; null without a desired direction
 * or a motion.
 */
export function directionError(sample, group) {
  const actual = sample.phase === "moving" ? valueOf(sample, group) : null, desired = actual && valueOf(sample, "direction_desired");
  if (!desired) return null;
  const across = Math.hypot(...[0, 1, 2].map((i) => actual[(i + 1) % 3] * desired[(i + 2) % 3] - actual[(i + 2) % 3] * desired[(i + 1) % 3]));
  return (180 / Math.PI) * Math.atan2(across, actual.reduce((sum, x, i) => sum + x * desired[i], 0));
}

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const socket = new WebSocket(`${scheme}://${location.host}/api/telemetry?rate=${RATE_HZ}`);
  socket.addEventListener("open", () => { for (const opener of openers) opener(); });
  socket.addEventListener("message", (event) => {
    newestSample = JSON.parse(event.data);
    receivedAt = performance.now();
    for (const listener of listeners) listener(newestSample);
  });
  socket.addEventListener("close", () => setTimeout(connect, 1000));
}
connect();
