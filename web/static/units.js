// Requests and answers use SI; the page shows millimetres and degrees, as in station/config/units.py.
const SHOWN = {
  m: ["mm", 1e3], "m/s": ["mm/s", 1e3], "m/s^2": ["mm/s²", 1e3], rad: ["°", 180 / Math.PI], "rad/s": ["°/s", 180 / Math.PI],
};

export const unit = (si) => SHOWN[si] ?? [si, 1];
/** Format a number with its significant digits only. */
export const tidy = (value) => String(Number(value.toPrecision(10)));

const NUMBER = "[-+]?\\d+(?:\\.\\d+)?(?:e[-+]?\\d+)?";
const SI = new RegExp(`(${NUMBER})( \\.\\.\\. )?(${NUMBER})? (rad/s|rad|m/s\\^2|m/s|m)(?![\\w/^²])`, "g");

/**
 * Convert the lengths and angles of a station's message to the page's units: "-0.13 ... -0.005 m" is "-130 ... -5
 * mm".
 */
export const inPageUnits = (text) => text.replace(SI, (whole, first, dots, second, si) => {
  if ((dots === undefined) !== (second === undefined)) return whole;
  const [shown, scale] = unit(si), number = (one) => String(Number((Number(one) * scale).toPrecision(4)));
  return `${number(first)}${dots === undefined ? "" : dots + number(second)} ${shown}`;
});
