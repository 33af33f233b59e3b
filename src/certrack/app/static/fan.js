// An ensemble as a fan chart: bands of each signal, which settle as more members come.
import { element, write } from "./dom.js";
import { sentence, table } from "./drawer.js";
import { format, nameParts } from "./numbers.js";
import { Plot } from "./plot.js";

const TITLE = "Ensemble";

export class Fan {
  constructor(state, drawer) {
    this.state = state;
    this.drawer = drawer;
    this.plot = null;
    this.signal = null;
  }

  /** Show an ensemble, or the first members of one. */
  show(header, rows, early) {
    Object.assign(this, { header, rows });
    const shown = this.drawer.title === TITLE && this.plot && this.pick.options.length === header.signals.length;
    if (!shown) this.open(header.signals);
    this.facts.textContent = "";
    for (const line of this.lines(header, early)) this.facts.append(sentence(line));
    this.facts.append(table(["metric", "median", "95 %", "99 %", "largest"], header.table));
    if (shown) this.fill();
    else this.draw();
  }

  open(signals) {
    this.chart = element("div", { class: "fan" });
    this.facts = element("div", { tabindex: 0, role: "group", "aria-label": "Figures of the ensemble" });
    this.pick = element("select", { "aria-label": "Signal of the fan chart" }, ...signals.map((name) => element("option", { selected: name === this.signal }, name)));
    this.pick.onchange = () => this.draw();
    this.drawer.open(TITLE, [element("div", { class: "split" }, element("div", { class: "fan-side" }, this.pick, this.chart), this.facts)], () => this.destroy());
  }

  lines({ members, seed, levels, outcomes, violations, limit_text: limit, limit_origin: origin }, early) {
    if (early) return [`The first ${members} members; more are on their way.`];
    const lines = [`${members} members, seed ${seed}: ${Object.entries(outcomes).map(([name, n]) => `${n} ${name}`).join(", ")}.`];
    const inner = [...levels].filter((level) => level < 0.5).map((level) => `${Number((100 - 200 * level).toPrecision(3))} %`);
    lines.push(`The line is the median; bands hold the middle ${inner.reverse().join(", ")} of the members at each time.`);
    if (violations) {
      const [low, high] = (violations.interval ?? []).map((value) => format(value, 3));
      lines.push(`${violations.count} with a tail error beyond ${limit} (${origin})${violations.interval ? `; the probability of one is between ${low} and ${high} (95 % confidence)` : ""}.`);
    }
    return lines;
  }

  draw() {
    this.destroy();
    this.signal = this.pick.value;
    const { header, state } = this, { levels, signals } = header, units = state.system.units;
    const [letter, index] = nameParts(this.signal), last = levels.length - 1;
    const pairs = levels.map((_, k) => [k + 1, last - k + 1]).filter(([a, b]) => a < b);
    const unit = { e_1: units[0], u: units.at(-1) }[this.signal] ?? units[signals.indexOf(this.signal) - 1] ?? "";
    this.plot = new Plot(this.chart, {
      id: "fan", alone: true, title: `${letter}${index}`, unit, last: true,
      series: levels.map((level) => ({ label: level === 0.5 ? "median" : `${format(100 * level, 3)} %`, color: "--line-1", width: level === 0.5 ? 1.5 : 0.5, hidden: level !== 0.5 })),
      bands: pairs.map(([low, high]) => ({ of: [high, low], color: "--fan" })),
    }, { window: () => [0, state.system.duration], zoom: () => {}, time: () => {}, redraw: () => {} });
    this.fill();
  }

  fill() {
    const { levels, signals } = this.header, s = signals.indexOf(this.signal);
    this.plot.set([this.rows[0], ...levels.map((_, level) => this.rows[1 + level * signals.length + s])]);
  }

  /** Draw with the colours of another theme. */
  recolor() {
    if (this.plot) this.draw();
  }

  destroy() {
    this.plot?.destroy();
    this.plot = null;
    if (this.chart) write(this.chart, "");
  }
}
