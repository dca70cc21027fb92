// Forms built from the station's description of its requests (OpenAPI): names, units, bounds, defaults.
// The page shows millimetres and degrees; requests use SI.
import { numberField, numberList, showBelow } from "./number.js";
import { inPageUnits, make, once, tidy, unit } from "./station.js";

const XYZ = ["x", "y", "z"];

const description = once("/api/openapi.json");
/** The schemas of all requests, by name. */
export const schemas = async () => (await description()).components.schemas;

/** Format a joint pose: "outer rotation 90 °, ...". `joints` are the joints of the pose's robot. */
export const poseText = (joints, pose) => joints.map((joint) => {
  const [shown, scale] = unit(joint.unit);
  return `${joint.name.replaceAll("_", " ")} ${tidy(Number((pose[joint.name] * scale).toFixed(1)))} ${shown}`;
}).join(", ");

/** Return a row of a form: label, control, unit. */
export const row = (label, control, unitText = "", title = "") => [
  make("label", { title }, label), control, make("span", { className: "unit", title }, unitText),
];

/**
 * Show in a form why the station refused its values, until the form is changed. The text is below the field that it
 * names, as in "trajectory.radius: …" or "a period of 8 s would work"; otherwise above the form's last buttons.
 */
export function refuse(form, text) {
  form.querySelector(".refused:not(.entry)")?.remove();
  const said = make("p", { className: "refused", role: "alert" }, inPageUnits(text));
  const names = (field) => {
    const words = field.ariaLabel.replace(/ [xyz]$/, "");
    return new RegExp(`(^|[.; ])${words.replaceAll(" ", "_")}(, number \\d+)?: |\\b${words} of \\S+ .*would work`).test(text);
  };
  const field = [...form.querySelectorAll(".rows :is(input, select)[aria-label]")].find(names);
  const changed = new AbortController();
  if (field === undefined) [...form.querySelectorAll(".acts")].at(-1).before(said);
  else {
    for (let folded = field.closest("details"); folded !== null; folded = folded.parentElement.closest("details")) folded.open = true;
    showBelow(field, said);
    field.setAttribute("aria-invalid", "true");
    field.focus({ preventScroll: true });
  }
  said.scrollIntoView({ block: "nearest" });
  form.addEventListener("input", () => { said.remove(); field?.removeAttribute("aria-invalid"); changed.abort(); }, { signal: changed.signal });
}

const named = (reference) => reference.split("/").at(-1);
/** Return the variants of a union by their `kind`: {circle: schema, ...}. */
export function variants(all, field) {
  const union = field.oneOf ? field : (field.anyOf ?? []).find((one) => one.oneOf);
  return Object.fromEntries(Object.entries(union.discriminator.mapping).map(([kind, where]) => [kind, all[named(where)]]));
}

/** Return a schema whose number `key` has a smaller maximum, which the station computes for this robot. */
export const withMaximum = (schema, key, maximum) =>
  ({ ...schema, properties: { ...schema.properties, [key]: { ...schema.properties[key], maximum: Math.floor(100 * maximum) / 100 } } });

/** Return the first paragraph of a schema's description. */
export const sentence = (schema) => (schema.description ?? "").split("\n\n")[0].replaceAll("\n", " ");

function bounds(field, scale) {
  const low = field.minimum ?? field.exclusiveMinimum, high = field.maximum ?? field.exclusiveMaximum;
  return { low: low === undefined ? null : low * scale, high: high === undefined ? null : high * scale,
    open: field.exclusiveMinimum !== undefined };
}

function numberInput(field, value, scale, required, label) {
  const { low, high, open } = bounds(field, scale);
  return numberField(label, typeof value === "number" ? value * scale : null,
    { min: low === null ? -Infinity : Number(tidy(low)), max: high === null ? Infinity : Number(tidy(high)), open, whole: field.type === "integer", required });
}

const range = ({ low, high, open }) => low === null && high === null ? ""
  : high === null ? (open ? ` > ${tidy(low)}` : ` ≥ ${tidy(low)}`) : ` ${low === null ? "≤" : `${tidy(low)} …`} ${tidy(high)}`;

/** Build one field: {elements for the grid, read() in SI}. If read() returns undefined, the request omits the field. */
function build(key, field, value, required, choices) {
  const optional = (field.anyOf ?? []).some((one) => one.type === "null");
  const core = optional ? { ...field.anyOf.find((one) => one.type !== "null"), description: field.description } : field;
  const text = (core.description ?? "").replaceAll("\n", " ");
  const [, si = ""] = /\[([^\]]+)\]/.exec(text) ?? [];
  const [shown, scale] = unit(si), label = key.replaceAll("_", " ");
  // The explanation has the page's units; a screen reader reads it with the field, a mouse shows it on the label.
  const explanation = inPageUnits(text.replace(`[${si}]`, shown === "" ? "" : `[${shown}]`)).replaceAll("`", "").replaceAll("_", " ");
  const cells = (control, unitText = "") => {
    for (const field of control.matches("input, select") ? [control] : control.querySelectorAll("input, select")) field.ariaDescription = explanation;
    return row(label, control, unitText, explanation);
  };
  if (core.type === "boolean") {
    const box = make("input", { type: "checkbox", checked: Boolean(value), "aria-label": label });
    return { elements: cells(make("span", {}, box)), read: () => box.checked };
  }
  if (core.enum || choices) {
    const names = [...(optional ? [""] : []), ...(core.enum ?? choices)]; // the station chooses an omitted value
    const select = make("select", { "aria-label": label }, ...names.map((one) => make("option", { value: one }, one === "" ? "automatic" : one.replaceAll("_", " "))));
    select.value = value ?? names[0];
    return { elements: cells(select), read: () => (select.value === "" ? undefined : select.value) };
  }
  if (core.type === "number" || core.type === "integer") {
    const input = numberInput(core, value, scale, required && !optional, label);
    if (optional) input.placeholder = "automatic"; // the station chooses an omitted value
    const readValue = () => (input.number === null ? undefined : input.number / scale);
    return { elements: cells(input, shown + range(bounds(core, scale))), read: readValue };
  }
  if (core.type === "array" && core.prefixItems) {
    const inputs = XYZ.map((axis, i) => numberInput(core.prefixItems[i], value?.[i], scale, required && !optional, `${label} ${axis}`));
    const omitted = () => optional && inputs.every((input) => input.value === ""); // the station chooses an omitted value
    return { elements: cells(make("div", { className: "three" }, ...inputs), shown === "" ? "x y z" : `x y z ${shown}`),
      read: () => (omitted() ? undefined : inputs.map((input) => (input.number ?? NaN) / scale)) };
  }
  if (core.type === "string") {
    const input = make("input", { type: "text", value: value ?? "", required, "aria-label": label });
    return { elements: cells(input), read: () => input.value };
  }
  const list = numberList(label, value ?? [], { required });
  return { elements: cells(list, si), read: () => list.numbers };
}

/**
 * Return a form for an object schema: {element, read()}. `more` lists the fields that are folded; `choices` contains the
 * options of text fields.
 */
export function form(schema, { values = {}, more = [], choices = {}, skip = [] } = {}) {
  const grid = make("div", { className: "rows" }), rest = make("div", { className: "rows" }), readers = {};
  for (const [key, field] of Object.entries(schema.properties)) {
    if (field.const !== undefined || skip.includes(key)) continue;
    // Lists of rows and tables are edited in files and scripts only; the form keeps their values.
    if (field.default !== undefined && (field.type === "object" || field.oneOf || ["array", "string"].includes(field.items?.type))) {
      readers[key] = () => values[key];
      continue;
    }
    const required = (schema.required ?? []).includes(key);
    const built = build(key, field, values[key] ?? field.default, required, choices[key]);
    (more.includes(key) && !required ? rest : grid).append(...built.elements);
    readers[key] = built.read;
  }
  const element = make("div", {}, grid);
  if (rest.children.length) element.append(make("details", {}, make("summary", {}, "more"), rest));
  const kind = schema.properties.kind?.const;
  return { element, read: () => {
    const result = kind === undefined ? {} : { kind };
    for (const [key, readValue] of Object.entries(readers)) {
      const value = readValue();
      if (value !== undefined) result[key] = value;
    }
    return result;
  } };
}
