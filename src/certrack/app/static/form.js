// The system as a form: every key of the file, with its unit, its limits, and the help of the documentation.
import { element } from "./dom.js";
import { Profile } from "./profile.js";

const WORDS = new Set(["choice"]);

const KIND_OF_REFERENCE = "reference.kind";

export class Form {
  /** `on`: edit(path, value). */
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
    this.stale = element("p", { class: "stale-note", hidden: true }, "follows the file once it has no errors");
    this.parent.append(this.stale);
    for (const { title, fields: all } of sections) {
      const fields = all.filter((field) => field.path !== KIND_OF_REFERENCE); // beside the drawing
      const filled = fields.filter((field) => field.value !== "");
      const fold = element("details", { class: "section", "data-title": title, open: first ? title === "Plant" || title === "Reference" : open.has(title) }, element("summary", {}, element("h3", {}, title), element("span", { class: "count" }, filled.length ? String(filled.length) : "not used")));
      if (title === "Reference") fold.append(this.profile.build(reference, units[0]));
      for (const field of filled) fold.append(this.field(field));
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

  /** Mark the field of an error, and say that the form waits for the file. */
  mark(problem) {
    if (this.stale) this.stale.hidden = !problem;
    this.parent.querySelectorAll("[aria-invalid]").forEach((input) => input.removeAttribute("aria-invalid"));
    if (!problem?.key) return;
    const path = problem.key.replace(/\[.*$/, ""), input = this.parent.querySelector(`[data-path="${CSS.escape(path)}"]`);
    input?.setAttribute("aria-invalid", "true");
  }
}
