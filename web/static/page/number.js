// Number fields. A comma or a point is the decimal sign; everything else is refused below the field. After an entry the
// field shows the number that the page sends.
import { make, tidy } from "./station.js";

const NUMBER = /^[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:e[-+]?\d+)?$/i;
const value = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value");
/** Longest text of a number, and of a list of numbers: checking a longer one, pasted by mistake, would block the page. */
const MAX_CHARS = 60, MAX_LIST_CHARS = 200_000;

/** Return the number that a text shows; null for an empty text, NaN for any other text. */
export function parsed(text) {
  const shown = text.trim().replace("−", "-"); // the minus of printed texts
  const number = shown.length <= MAX_CHARS && NUMBER.test(shown) ? Number(shown.replace(",", ".")) : NaN;
  return shown === "" ? null : Number.isFinite(number) ? number : NaN;
}

/** Return a refused text, or its beginning, for a message. */
const cut = (text) => (text.length > MAX_CHARS ? `${text.slice(0, MAX_CHARS)}…` : text);

/** Show a text below a field: in a grid of rows after the field's unit, otherwise after the field itself. */
export function showBelow(field, message) {
  let cell = field;
  while (cell.parentElement !== null && !cell.parentElement.classList.contains("rows")) cell = cell.parentElement;
  if (cell.parentElement === null) field.after(message); else cell.nextElementSibling.after(message);
}

/**
 * Return a text field. `refusal(text)` returns why a text is refused, or an empty text if it is accepted; `shown(text)`
 * returns the text that the field shows after an accepted entry.
 */
function checkedField(label, fields, refusal, shown) {
  const input = make("input", { type: "text", autocomplete: "off", spellcheck: false, "aria-label": label, ...fields });
  const message = make("p", { className: "refused entry", role: "alert" });
  const check = () => {
    const reason = refusal(input.value);
    input.setCustomValidity(reason);
    message.textContent = reason;
    if (reason !== "" || !message.isConnected) return;
    message.remove();
    input.removeAttribute("aria-invalid");
  };
  const show = () => {
    if (message.textContent === "") return;
    input.setAttribute("aria-invalid", "true");
    showBelow(input, message);
  };
  // A text that the page sets is checked like a text that the user enters.
  Object.defineProperty(input, "value", { get: () => value.get.call(input), set: (text) => { value.set.call(input, text); check(); } });
  input.addEventListener("input", check);
  input.addEventListener("invalid", show);
  input.addEventListener("change", () => {
    check();
    if (input.validationMessage === "" && input.value.trim() !== "") input.value = shown(input.value);
    show();
  });
  return input;
}

/**
 * Return a field for a number. Its property `number` is the shown number: null if it is empty, NaN if it is refused.
 * `bounds`: {min, max, open: min itself is refused, whole: only whole numbers}, in the unit of the field.
 */
export function numberField(label, initial, { min = -Infinity, max = Infinity, open = false, whole = false, ...fields } = {}) {
  const bounds = { min, max };
  const refusal = (text) => {
    const number = parsed(text);
    if (text === "") return "";
    if (number === null) return "Spaces are no number";
    if (Number.isNaN(number)) return `“${cut(text.trim())}” is not a number; write it like 0.5 or 0,5, without a unit`;
    if (whole && !Number.isInteger(number)) return "Only whole numbers are possible";
    if (open && number <= bounds.min) return `${tidy(number)} is too small; it must be more than ${tidy(bounds.min)}`;
    if (number < bounds.min) return `${tidy(number)} is too small; it must be at least ${tidy(bounds.min)}`;
    return number > bounds.max ? `${tidy(number)} is too large; it must be at most ${tidy(bounds.max)}` : "";
  };
  const input = checkedField(label, { className: "number", inputMode: min >= 0 ? "decimal" : "text", ...fields }, refusal, (text) => tidy(parsed(text)));
  Object.defineProperty(input, "number", { get: () => (refusal(input.value) === "" ? parsed(input.value) : NaN) });
  input.bounds = bounds; // may be changed before a value is set
  input.addEventListener("keydown", (event) => {
    const step = { ArrowUp: 1, ArrowDown: -1 }[event.key];
    if (step === undefined || !Number.isFinite(input.number) || event.shiftKey || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    const next = tidy(Math.min(bounds.max, Math.max(bounds.min, input.number + step)));
    if (refusal(next) !== "") return; // for example zero, where only more than zero is possible
    input.value = next;
    for (const type of ["input", "change"]) input.dispatchEvent(new Event(type, { bubbles: true }));
  });
  if (typeof initial === "number") input.value = tidy(initial);
  return input;
}

const parts = (text) => text.split(text.includes(";") ? ";" : /,\s+|\s+/).map((part) => part.trim()).filter((part) => part !== "");

/** Return a field for several numbers, separated by spaces or semicolons; its property `numbers` is their list. */
export function numberList(label, initial, fields = {}) {
  const wrong = (text) => parts(text).find((part) => part.startsWith(",") || Number.isNaN(parsed(part))) ?? (text !== "" && parts(text).length === 0 ? text : undefined);
  const refusal = (text) => text.length > MAX_LIST_CHARS ? `${text.length} characters are too many; at most ${MAX_LIST_CHARS} are possible`
    : (wrong(text) === undefined ? "" : `“${cut(wrong(text))}” is not a number; separate the numbers by spaces or semicolons, like 0.5; 2; 4`);
  const input = checkedField(label, { placeholder: "0; 2; 4", ...fields }, refusal, (text) => parts(text).map((part) => tidy(parsed(part))).join("; "));
  Object.defineProperty(input, "numbers", { get: () => parts(input.value).map(parsed) });
  input.value = initial.map(tidy).join("; ");
  return input;
}
