// Motions kept under a name, and taken up again: experiments like any other.
import { ask, confirm, make, note, Refused } from "./station.js";

/** The lines below a motion's form: `wish()` is what to keep, `take(motion)` fills the form with what was kept; `kind` of motion. */
export function saved(kind, wish, take) {
  const name = make("input", { type: "text", maxLength: 60, pattern: "[A-Za-z0-9_][A-Za-z0-9_\\-]*", placeholder: "name", title: "letters, digits, _ and -", "aria-label": "name to save it under" });
  const save = make("button", { type: "button" }, "Save"), list = make("select", { "aria-label": "saved motions" }), load = make("button", { type: "button" }, "Load");
  const has = make("label", {}, list, " ", load);

  async function keep(replace) {
    const body = wish();
    try {
      const { note: said } = await ask("PUT", `/api/experiments/${encodeURIComponent(name.value)}`, { ...body, replace });
      note(`${said}; ctr-station run ${name.value} takes it, too`, true);
      refresh();
    } catch (error) {
      const there = !replace && error instanceof Refused && error.message.includes("is there already");
      if (!there) note(error.message);
      else if (await confirm(`Replace '${name.value}'?`, "Replace", make("p", {}, `There is an experiment '${name.value}' already. What is in its file is lost.`))) await keep(true);
    }
  }

  save.addEventListener("click", () => {
    name.required = true;
    const may = name.form.reportValidity();
    name.required = false; // only to save it
    if (may) keep(false);
  });
  load.addEventListener("click", async () => {
    try { take(await ask("GET", `/api/experiments/${encodeURIComponent(list.value)}/motion`)); name.value = list.value; } catch (error) { note(error.message); }
  });

  async function refresh() {
    const all = await ask("GET", "/api/experiments").catch(() => []);
    list.replaceChildren(...all.filter((one) => one.cases[0]?.trajectory === kind).map((one) => make("option", { value: one.name }, one.name)));
    if (name.value) list.value = name.value;
    has.hidden = list.options.length === 0;
  }
  has.hidden = true;
  refresh();
  return make("div", { className: "acts" }, name, save, has);
}
