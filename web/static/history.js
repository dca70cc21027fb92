// The telemetry of the last minutes; it survives a reload of the page.
const KEY = "telemetry";

function stored() {
  try { return JSON.parse(sessionStorage.getItem(KEY)) ?? []; } catch { return []; }
}

/** Telemetry samples as streamed by the station, the oldest first. */
export const samples = stored();

/** Mark a gap between the last sample and the next one: plots draw no line across it. */
export function gap() {
  if (samples.length > 0) samples.push({ time: samples.at(-1).time, joints: [] });
}

window.addEventListener("pagehide", () => {
  const text = (recent) => JSON.stringify(recent, (_, value) => (typeof value === "number" ? Number(value.toFixed(7)) : value));
  // A browser stores a few million characters. If the samples do not fit, only the newest half is stored, and so on.
  for (let recent = samples; recent.length > 0; recent = recent.slice(Math.ceil(recent.length / 2))) {
    try { sessionStorage.setItem(KEY, text(recent)); return; } catch { continue; }
  }
});
