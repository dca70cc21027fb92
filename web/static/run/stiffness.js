// Stiffness of the tip, as fields of the forms of the tab Run.
import { latest, make, request } from "../page/station.js";
import { form } from "../page/form.js";

/** Keys of the controller that these fields set. */
export const STIFFNESS_FIELDS = ["stiffness", "stiffness_frame", "max_offset"];
const AXES = ["along_x", "along_y", "along_z"];

/** Return the stiffness of the tubes alone along x, y and z at the current pose [N/m], by the model; null if unknown. */
async function tubeStiffness() {
  const joints = latest()?.joints ?? {};
  if (Object.keys(joints).length === 0) return null;
  const { compliance } = await request("POST", "/api/model/solve", { joints });
  return compliance.map((row, i) => 1 / row[i]);
}

/** Return the fields of a controller's stiffness: {element, read()}. `schema` is that of the controller, `values` the initial ones. */
export function stiffnessForm(schema, values) {
  const { stiffness, stiffness_frame, max_offset } = schema.properties, bounds = stiffness.anyOf.find((one) => one.prefixItems).prefixItems;
  const axes = AXES.map((name, i) => [name, { anyOf: [bounds[i], { type: "null" }], description: stiffness.description }]);
  const initial = Object.fromEntries(AXES.map((name, i) => [name, values.stiffness?.[i]]));
  const fields = form({ properties: { ...Object.fromEntries(axes), stiffness_frame, max_offset } }, { values: { ...values, ...initial } });
  const inputs = [...fields.element.querySelectorAll("input")].slice(0, AXES.length), tubes = make("span");
  const describe = (found) => { tubes.textContent = ` At the current pose the tubes alone have ${found.join(", ")} N/m along x, y, z of the world frame.`; };
  describe([30, 30, 300]); // an invisible example keeps the place, so that the answer does not move the fields below it
  tubes.style.visibility = "hidden";
  const check = () => { for (const input of inputs) input.required = inputs.some((one) => one.value !== ""); }; // all three or none
  fields.element.addEventListener("input", check);
  check();
  tubeStiffness().then((found) => {
    if (found === null) return;
    describe(found.map((one) => Number(one.toPrecision(2))));
    tubes.style.visibility = "";
  }).catch(() => {}); // the fields are complete without this hint
  const element = make("fieldset", {}, make("legend", {}, "Stiffness of the tip"),
    make("p", { className: "small dim" }, "Empty: as stiff as the joints allow. With three values the tip gives way to a force like a spring, for example 1 mm for 0.1 N at 100 N/m, but not further than the max offset.", tubes),
    fields.element);
  const read = () => {
    const { max_offset: offset, stiffness_frame: frame, ...found } = fields.read(), along = AXES.map((name) => found[name]);
    return { ...(along.includes(undefined) ? {} : { stiffness: along, stiffness_frame: frame }), ...(offset !== undefined && { max_offset: offset }) };
  };
  return { element, read };
}
