// The live telemetry: one stream for the whole page, and its last minutes. Stale and invalid values are null.
import { rigAnswer, stored, stream, STALE_AFTER_S } from "./station.js";

const RATE_HZ = 20; // requested samples [Hz]
const KEY = "telemetry";
/** Duration of the kept telemetry [s]. */
export const HISTORY_S = 300;
/** The telemetry samples of the last minutes, the oldest first. They survive a reload of the page. */
export const samples = stored(KEY) ?? [];
let receivedAt = -Infinity;

/** Return the newest telemetry sample; null if it was received more than `age` [s] ago. */
export const latestSample = (age = STALE_AFTER_S) => (performance.now() - receivedAt < 1000 * age ? samples.at(-1) : null);

/** Return whether the run follows a moving target. */
export const follows = (sample) => sample !== null && sample.phase === "moving" && sample.target_followed > 0;

/** Return the desired position of the tip [m]: the setpoint, or a followed target plus its offset; null if unknown. */
function desiredTip(sample, group) {
  if (!follows(sample)) return sample.tip_desired;
  const target = sample.target_visible ? sample[group.replace("tip", "target")] : null, offset = sample.target_offset;
  return target && offset && target.map((x, i) => x + offset[i]);
}

/** Return the vector from `tip_true` or `tip_measured` to the desired tip [mm] during a motion; otherwise null. */
export function error(sample, group) {
  const tip = sample.phase === "moving" ? sample[group] : null, desired = tip && desiredTip(sample, group);
  return desired && desired.map((x, i) => 1e3 * (x - tip[i]));
}

/**
 * Angle from `direction_true` or `direction_measured` to the desired direction [°]; null without a desired direction
 * or a motion.
 */
export function directionError(sample, group) {
  const actual = sample.phase === "moving" ? sample[group] : null, desired = actual && sample.direction_desired;
  if (!desired) return null;
  const across = Math.hypot(...[0, 1, 2].map((i) => actual[(i + 1) % 3] * desired[(i + 2) % 3] - actual[(i + 2) % 3] * desired[(i + 1) % 3]));
  return (180 / Math.PI) * Math.atan2(across, actual.reduce((sum, x, i) => sum + x * desired[i], 0));
}

let knownStd = Infinity; // standard deviation above which a force is unknown [N]
rigAnswer().then((rig) => { knownStd = rig.known_force_std; });
/** Return whether a sample's force along a unit vector is known; without force sensors, it is unknown along the tubes. */
export const isForceKnown = (sample, along) =>
  sample.force_filtered !== null && Math.sqrt(along.reduce((sum, x, i) => sum + x * x * (sample.force_variance?.[i] ?? 0), 0)) <= knownStd;

function receive(sample) {
  receivedAt = performance.now();
  if (samples.length && sample.time < samples.at(-1).time) samples.length = 0; // the time has decreased, so the control process has restarted
  samples.push(sample);
  while (samples.length && samples[0].time < sample.time - HISTORY_S) samples.shift();
}

/** Mark a gap between the last sample and the next one: plots draw no line across it. */
function gap() {
  if (samples.length > 0) samples.push({ time: samples.at(-1).time, joints: [] });
}

stream(`telemetry?rate=${RATE_HZ}`, receive, gap);

window.addEventListener("pagehide", () => {
  const text = (recent) => JSON.stringify(recent, (_, value) => (typeof value === "number" ? Number(value.toFixed(7)) : value));
  // A browser stores a few million characters. While the samples do not fit, the older half of them is left out.
  for (let recent = samples; recent.length > 0; recent = recent.slice(Math.ceil(recent.length / 2))) {
    try { sessionStorage.setItem(KEY, text(recent)); return; } catch { continue; }
  }
});
