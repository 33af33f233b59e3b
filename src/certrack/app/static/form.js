// The system as a form: every key of the file, with its unit, its limits, and the help of the documentation.
import { element, write } from "./dom.js";
import { Profile } from "./profile.js";

const WORDS = new Set(["choice"]);

const NAME = /^[A-Za-z]\w*$/;
const KIND_OF_REFERENCE = "reference.kind";

export class Form {
  /** `on`: edit(path, value), discard() what has errors. */
  constructor(parent, on) {
    this.parent = parent;
    this.on = on;
    this.stale = null;
    this.profile = new Profile(on);
  }

  /** Show the keys of a system. */
  build({ form: sections, reference, units }) {
    const open = new Set([...this.parent.querySelectorAll("details[open]")].map((fold) => fold.dataset.title));
    const focused = document.activeElement?.dataset?.path, first = !this.parent.childElementCount;
    this.parent.textContent = "";
    this.stale = element("p", { class: "stale-note", hidden: true }, "");
    this.parent.append(this.stale);
    for (const { title, fields: all } of sections) {
      const fields = all.filter((field) => field.path !== KIND_OF_REFERENCE); // beside the drawing
      const filled = fields.filter((field) => field.value !== "");
      const fold = element("details", { class: "section", "data-title": title, open: first ? title === "Plant" || title === "Reference" : open.has(title) }, element("summary", {}, element("h3", {}, title), element("span", { class: "count" }, filled.length ? String(filled.length) : "not used")));
      if (title === "Reference") fold.append(this.profile.build(reference, units[0]));
      for (const field of filled) fold.append(this.field(field));
      if (title === "Plant") fold.append(this.constant());
      const empty = fields.filter((field) => field.value === "");
      if (empty.length) {
        const more = element("details", { class: "more" }, element("summary", {}, `${empty.length} more`));
        for (const field of empty) more.append(this.field(field));
        fold.append(more);
      }
      this.parent.append(fold);
    }
    if (focused) this.parent.querySelector(`[data-path="${CSS.escape(focused)}"]`)?.focus();
  }

  field(field) {
    const id = `field-${field.path}`, helpId = `${id}-help`;
    const attributes = { id, "data-path": field.path, "aria-describedby": helpId };
    let input;
    if (WORDS.has(field.kind) && field.choices.length) {
      const options = field.choices.includes(field.value) || !field.value ? field.choices : [field.value, ...field.choices];
      input = element("select", attributes, ...(field.value ? [] : [element("option", { value: "" }, "—")]), ...options.map((choice) => element("option", { value: choice, selected: choice === field.value }, choice)));
    } else if (field.kind === "flag") {
      input = element("select", attributes, ...["", "true", "false"].map((choice) => element("option", { value: choice, selected: choice === field.value }, choice || "—")));
    } else {
      input = element("input", { ...attributes, value: field.value ?? "", placeholder: field.value === null ? "too long: see File" : field.left_out, disabled: field.value === null, autocomplete: "off", spellcheck: "false" });
      input.addEventListener("keydown", (event) => {
        if (event.key === "Enter") input.blur();
        if (event.key === "Escape") {
          input.value = field.value ?? "";
          input.blur();
        }
      });
    }
    input.addEventListener("change", () => this.on.edit(field.path, input.value));
    const limits = [field.shape && !field.help.includes(field.shape) ? field.shape : "", field.limits && field.kind !== "choice" ? field.limits : "", field.left_out && !["required", "()"].includes(field.left_out) ? `if left out: ${field.left_out}` : ""].filter((part) => part && part !== field.help).join("; ");
    const help = element("span", { class: "help", id: helpId }, field.help, limits ? element("small", {}, ` · ${limits}`) : null);
    return element("div", { class: "field" }, element("label", { for: id }, field.name, field.unit ? element("i", {}, field.unit) : null), input, help);
  }

  /** A name that formulas may use, and its value: what the text says under [plant.constants]. */
  constant() {
    const name = element("input", { id: "constant-name", "aria-label": "name of a new constant", placeholder: "name", autocomplete: "off", spellcheck: "false" });
    const value = element("input", { id: "constant-value", "aria-label": "value of a new constant", placeholder: "value", autocomplete: "off", spellcheck: "false" });
    const add = () => {
      const wrong = NAME.test(name.value.trim()) ? (value.value.trim() ? null : value) : name;
      if (wrong) return wrong.focus();
      this.on.edit(`plant.constants.${name.value.trim()}`, value.value);
      name.value = value.value = "";
      return name.focus();
    };
    for (const input of [name, value]) input.addEventListener("keydown", (event) => event.key === "Enter" && add());
    return element("div", { class: "field" }, element("label", { for: "constant-name" }, "new constant"), element("div", { class: "pair" }, name, value, element("button", { class: "small", onclick: add }, "Add")), element("span", { class: "help" }, "a name for every formula, such as J = 8e-4"));
  }

  /** Mark the field of an error with what is wrong, and say that the rest of the form waits. */
  mark(problem) {
    this.parent.querySelectorAll(".wrong-note").forEach((said) => said.remove());
    const path = problem?.key?.replace(/\[.*$/, ""), input = path ? this.parent.querySelector(`[data-path="${CSS.escape(path)}"]`) : null;
    if (this.stale) {
      this.stale.hidden = !problem;
      write(this.stale, problem ? `${problem.message.replace(/\.?$/, ".")} The page shows the last good design until this is mended; go on filling in. ` : "");
      if (input) this.stale.append(element("button", { class: "small", onclick: () => input.focus() }, "Go to the field"), " ");
      if (problem) this.stale.append(element("button", { class: "small", onclick: () => this.on.discard() }, "Discard these changes"));
    }
    this.parent.querySelectorAll("[aria-invalid]").forEach((input) => input.removeAttribute("aria-invalid"));
    if (!input) return;
    input.setAttribute("aria-invalid", "true");
    for (let fold = input.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
    input.closest(".field").append(element("span", { class: "wrong-note" }, problem.message.slice(problem.message.indexOf(path) + path.length).replace(/^\S*:\s*/, "")));
  }
}
