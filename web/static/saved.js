// Save and load motions under a name; the station stores them as experiments.
import { request, confirm, make, note, Refused } from "./station.js";

/**
 * Return the fields for saving and loading a motion. `motionOf()` returns the motion of the form, `restore(motion)` fills
 * the form with a loaded motion, and `kind` is the kind of motion.
 */
export function saved(kind, motionOf, restore) {
  const name = make("input", { type: "text", maxLength: 60, pattern: "[A-Za-z0-9_][A-Za-z0-9_\\-]*", placeholder: "name", title: "letters, digits, _ and -", "aria-label": "name to save it under" });
  const save = make("button", { type: "button" }, "Save"), list = make("select", { "aria-label": "saved motions" }), load = make("button", { type: "button" }, "Load");
  const loadBox = make("label", {}, list, " ", load);

  async function store(replace) {
    const body = motionOf();
    try {
      const { note: message } = await request("PUT", `/api/experiments/${encodeURIComponent(name.value)}`, { ...body, replace });
      note(`${message}; ctr-station run ${name.value} runs it, too`, true);
      refresh();
    } catch (error) {
      const exists = !replace && error instanceof Refused && error.message.includes("exists already");
      if (!exists) note(error.message);
      else if (await confirm(`Replace '${name.value}'?`, "Replace", make("p", {}, `'${name.value}' exists already. Its file will be overwritten.`))) await store(true);
    }
  }

  save.addEventListener("click", () => {
    name.required = true;
    const may = name.form.reportValidity();
    name.required = false; // required only for saving
    if (may) store(false);
  });
  load.addEventListener("click", async () => {
    try { restore(await request("GET", `/api/experiments/${encodeURIComponent(list.value)}/motion`)); name.value = list.value; } catch (error) { note(error.message); }
  });

  async function refresh() {
    const all = await request("GET", "/api/experiments").catch(() => []);
    list.replaceChildren(...all.filter((one) => one.cases[0]?.trajectory === kind).map((one) => make("option", { value: one.name }, one.name)));
    if (name.value) list.value = name.value;
    loadBox.hidden = list.options.length === 0;
  }
  loadBox.hidden = true;
  refresh();
  return make("div", { className: "acts" }, name, save, loadBox);
}
