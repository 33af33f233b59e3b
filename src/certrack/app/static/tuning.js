// Tuning: what is optimised within which limits, the tuned design, and the price of a limit.
import { element } from "./dom.js";
import { sentence, table } from "./drawer.js";
import { frontChart } from "./front.js";
import { typed } from "./numbers.js";

const OBJECTIVES = { error: "certified error", peak: "peak input", energy: "input energy", period: "longest stable period" };
const LIMITS = [
  ["error", "certified error at most", "Bound of |e₁| once settled, in the unit of the output", ([output]) => output],
  ["peak_input", "peak input at most", "Of |u| over the box of starts", (units) => units.at(-1)],
  ["energy", "energy at most", "Integral of u² over the run", (units) => units.at(-1) && `(${units.at(-1)})² s`],
  ["period", "stable if u is held for", "The loop stays stable with u held for so long", () => "s"],
  ["noise", "noise gain at most", "From noise of the sensors to the input", () => ""],
];
const DRAWN = ["error", "peak_input"], STARTS = 2;
const SWEPT = { period: "period of the drive", "peak-input": "peak input", energy: "energy", noise: "noise gain", error: "certified error" };

export class Tuning {
  /** `on`: start(options), apply(gains), note(text), units(), limits(values) shown in the plots, null for none. */
  constructor(drawer, on) {
    this.drawer = drawer;
    this.on = on;
    this.last = {};
  }

  form() {
    const { last } = this;
    const objective = element("select", { id: "tune-objective" }, ...Object.entries(OBJECTIVES).map(([value, text]) => element("option", { value, selected: value === last.objective }, text)));
    const field = (name, value, attributes) => element("input", { name, value: value ?? "", autocomplete: "off", ...attributes });
    const labelled = (text, input, help = null) => {
      if (help) input.setAttribute("aria-description", help);
      return element("label", { class: "inline", title: help }, text, input);
    };
    const units = this.on.units();
    const limits = LIMITS.map(([name, text, help, unit]) => labelled([text, unit(units)].filter(Boolean).join(", "), field(name, last[name], { inputmode: "decimal", placeholder: "no limit" }), help));
    const starts = field("starts", last.starts ?? STARTS, { inputmode: "numeric" });
    const front = element("select", { name: "front" }, element("option", { value: "" }, "none"), ...Object.entries(SWEPT).map(([value, text]) => element("option", { value, selected: value === last.front }, text)));
    const begin = element("button", { class: "primary", onclick: () => this.begin(objective.value, Number(starts.value) || STARTS, front.value) }, "Tune");
    this.drawer.open("Tune within limits", [
      element("div", { class: "tune-form" }, labelled("optimise", objective, "What becomes as small (a period: as long) as the limits allow"), ...limits, labelled("starts of the search", starts, "Starts of the search: more of them find more, and take longer"), labelled("sweep a limit", front, "Tune for a row of values of one limit: what it costs"), begin),
      sentence("Locked gains are kept when the result is applied. The tuned design is certified by a fast proof; once its gains are used the page proves it anew, and the finer proof may give less. A sweep shows what a limit costs, and each point of it can be tuned for. Limits of error and peak input can be dragged in the plots, too."),
    ], () => this.on.limits(null));
    const fields = () => Object.fromEntries(DRAWN.map((name) => [name, typed(this.drawer.body.querySelector(`input[name=${name}]`).value) || null]));
    for (const name of DRAWN) this.drawer.body.querySelector(`input[name=${name}]`).addEventListener("input", () => this.on.limits(fields()));
    this.on.limits(fields());
    objective.focus();
  }

  /** A limit was dragged in a plot. */
  limit(name, value) {
    const field = this.drawer.body.querySelector(`input[name=${name}]`);
    field.value = value === null ? "" : String(value);
    field.dispatchEvent(new Event("input"));
  }

  begin(objective, starts, front) {
    const options = { objective, starts, front };
    for (const [name, text] of LIMITS) {
      const shown = this.drawer.body.querySelector(`input[name=${name}]`).value;
      if (!shown.trim()) continue;
      const value = typed(shown);
      if (!(value > 0)) return this.on.note(`${text}: must be a number above 0, got ${shown}`);
      options[name] = value;
    }
    this.last = options;
    return this.on.start(options);
  }

  done(header) {
    const apply = element("button", { class: "primary", onclick: () => this.on.apply(header.gains) }, "Use these gains");
    const again = element("button", { onclick: () => this.form() }, "Change the limits");
    const notes = [...header.active, ...header.notes, `Limits: ${[...new Set(header.limits)].join(", ") || "none"}.`];
    const result = element("div", {}, element("div", { class: "actions" }, apply, again), table(["", "before", "after"], header.table), ...notes.map(sentence));
    if (header.front) this.front = header.front;
    const swept = header.front ?? (this.fromFront ? this.front : null);
    this.fromFront = false;
    const chart = swept ? frontChart(swept, (value) => this.at(swept.limit, value)) : null;
    this.drawer.open("Tuning", [chart ? element("div", { class: "split" }, chart, result) : result]);
    this.on.note("Tuning is done.");
  }

  /** Tune for a point of the front, which stays in the picture. */
  at(limit, value) {
    this.last = { ...this.last, front: "", [limit.replaceAll(/[- ]/g, "_")]: value };
    this.fromFront = true;
    this.on.start(this.last);
  }
}
