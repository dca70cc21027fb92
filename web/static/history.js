// The telemetry of the last minutes, which outlives a reload of the page.
const KEY = "telemetry";

function kept() {
  try { return JSON.parse(sessionStorage.getItem(KEY)) ?? []; } catch { return []; }
}

/** Samples as the station has streamed them, the oldest first. */
export const samples = kept();

/** Nothing is known between the last sample and the next one: no line leads over it. */
export function gap() {
  if (samples.length > 0) samples.push({ time: samples.at(-1).time, joints: [] });
}

window.addEventListener("pagehide", () => {
  const text = (some) => JSON.stringify(some, (_, value) => (typeof value === "number" ? Number(value.toFixed(7)) : value));
  // A browser keeps some millions of letters: the newest half is better than nothing.
  for (let some = samples; some.length > 0; some = some.slice(Math.ceil(some.length / 2))) {
    try { sessionStorage.setItem(KEY, text(some)); return; } catch { continue; }
  }
});
