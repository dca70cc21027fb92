// The operator: take and release control, and report its loss.
import { $, confirm, latest, make, name, note, onStatus, sendCommand } from "./station.js";

let mine = false, leaving = false; // whether this page is operator; whether this page is releasing control on purpose

export async function changeOperator() {
  const { you, name: current } = latest().operator;
  if (you) {
    leaving = true;
    return sendCommand("DELETE", "/api/operator");
  }
  const field = make("input", { type: "text", maxLength: 40, value: name.get(), "aria-label": "your name", required: true });
  const text = current === null ? "All users will see this name." : `'${current}' is operator now, and will only be able to view and to STOP.`;
  const title = current === null ? "Take control" : "Take over";
  if (!await confirm(title, title, make("p", {}, text), make("label", {}, "Your name", field))) return null;
  name.set(field.value.trim());
  return sendCommand("POST", "/api/operator", { name: field.value.trim() || null, take_over: current !== null });
}
$("operator-act").addEventListener("click", changeOperator);

/** Return a button that takes control from the current operator. */
export function takeOver() {
  const button = make("button", { type: "button" }, "Take over…");
  button.addEventListener("click", changeOperator);
  return button;
}

function reportLoss(operator) {
  if (mine && !operator.you && !leaving) {
    if (operator.name === null) note("You are no longer operator: the station has received nothing from this page for too long. Your next command makes you operator again.");
    else note(`'${operator.name}' has taken control: you may view and STOP.`, false, takeOver(), (now) => now.operator.name === operator.name);
  }
  if (!operator.you) leaving = false;
  mine = operator.you;
}

onStatus((status) => {
  if (status === null) return;
  const { operator } = status, button = $("operator-act");
  $("operator-name").textContent = operator.you ? "You are operator" : operator.name === null ? "No operator" : `Operator: ${operator.name}`;
  $("operator-name").title = operator.name ?? "the first command makes its sender operator";
  button.hidden = operator.role !== "operator";
  button.textContent = operator.you ? "Release" : operator.name === null ? "Take control" : "Take over…";
  if (operator.role === "viewer") $("operator-name").textContent += " · you may view and STOP";
  reportLoss(operator);
});
