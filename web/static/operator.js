// Who is operator: taking and giving back control, and telling a person who has lost it.
import { $, confirm, latest, make, name, note, onStatus, press } from "./station.js";

let mine = false, leaving = false; // this page's person is operator; gives it back on purpose

export async function changeOperator() {
  const { you, name: holder } = latest().operator;
  if (you) {
    leaving = true;
    return press("DELETE", "/api/operator");
  }
  const field = make("input", { type: "text", maxLength: 40, value: name.get(), "aria-label": "your name", required: true });
  const text = holder === null ? "Everybody will see this name." : `'${holder}' is operator now and will only be able to look, and to STOP.`;
  const title = holder === null ? "Take control" : "Take over";
  if (!await confirm(title, title, make("p", {}, text), make("label", {}, "Your name", field))) return null;
  name.set(field.value.trim());
  return press("POST", "/api/operator", { name: field.value.trim() || null, take_over: holder !== null });
}
$("operator-act").addEventListener("click", changeOperator);

/** A button that takes control from whoever has it. */
export function takeOver() {
  const button = make("button", { type: "button" }, "Take over…");
  button.addEventListener("click", changeOperator);
  return button;
}

function tellLoss(operator) {
  if (mine && !operator.you && !leaving) {
    if (operator.name === null) note("You are operator no longer: the station has heard nothing from this page for too long. Your next command makes you operator again.");
    else note(`'${operator.name}' has taken control: you may look, and STOP.`, false, takeOver(), (now) => now.operator.name === operator.name);
  }
  if (!operator.you) leaving = false;
  mine = operator.you;
}

onStatus((status) => {
  if (status === null) return;
  const { operator } = status, act = $("operator-act");
  $("operator-name").textContent = operator.you ? "You are operator" : operator.name === null ? "No operator" : `Operator: ${operator.name}`;
  $("operator-name").title = operator.name ?? "the first command makes its sender operator";
  act.hidden = operator.role !== "operator";
  act.textContent = operator.you ? "Release" : operator.name === null ? "Take control" : "Take over…";
  if (operator.role === "viewer") $("operator-name").textContent += " · you may look, and STOP";
  tellLoss(operator);
});
