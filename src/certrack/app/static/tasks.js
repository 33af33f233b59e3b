// The bottom bar: long computations with progress and cancel, and the drawer with their results.
import { byId, element, write } from "./dom.js";
import { Drawer, sentence, table } from "./drawer.js";
import { Fan } from "./fan.js";
import { hasBound, typed } from "./numbers.js";
import { Tuning } from "./tuning.js";

const PINNED = "Pinned designs";
const NAMES = { falsify: "Falsify", ensemble: "Ensemble", margins: "Margins", tune: "Tune", optimum: "Optimum", compare: "Compare", export: "Export" };

export class Tasks {
  /**
   * `on`: start(task, options), cancel(), apply(gains), restore(pin), behind(pin), edit(path, value), openText(text, name),
   * download(name, text), snapshot(), goBack(snapshot), redraw(), note(text).
   */
  constructor(state, on) {
    this.state = state;
    this.on = on;
    this.running = null;
    this.made = null;
    this.drawer = new Drawer(byId("drawer"));
    this.fan = new Fan(state, this.drawer);
    this.tuning = new Tuning(this.drawer, { start: (options) => this.start("tune", options), apply: (gains) => this.apply(gains), note: on.note, units: () => state.system.units, limits: (limits) => this.limits(limits) });
    byId("tasks").addEventListener("click", (event) => {
      const task = event.target.dataset?.task;
      if (task) this.press(task);
    });
    byId("cancel").onclick = () => on.cancel();
  }

  press(task) {
    if (!this.state.system) return;
    if (task === "tune") this.tuning.form();
    else if (task === "compare") this.compare();
    else this.start(task, {});
  }

  start(task, options) {
    if (this.running) {
      this.on.note("One long computation at a time: wait for it or cancel it.");
      return;
    }
    if (!this.on.start(task, options)) {
      this.on.note("Not begun: the server is not there.");
      return;
    }
    this.made = { ...this.on.snapshot(), at: new Date().toLocaleTimeString() };
    this.begin(task);
  }

  begin(task) {
    this.running = task;
    byId("work").hidden = false;
    byId("bar").removeAttribute("value");
    write(byId("work-text"), `${NAMES[task]} …`);
    this.buttons();
  }

  stop() {
    this.running = null;
    byId("work").hidden = true;
    this.buttons();
  }

  buttons() {
    for (const button of byId("tasks").children) {
      const off = !this.state.system || (this.running && button.dataset.task !== "compare");
      button.disabled = off;
      button.setAttribute("aria-pressed", String(this.running === button.dataset.task));
    }
  }

  /** A frame of a computation. */
  frame({ header, rows, design }) {
    if (header.state === "running") {
      this.progress(header);
      return;
    }
    if (header.state === "cancelled") {
      if (this.running) this.on.note("Cancelled.");
      this.stop();
      return;
    }
    if (header.state !== "early") this.stop();
    this[header.task]?.(header, rows, design);
    this.drawer.label(this.made, (made) => this.on.goBack(made));
    this.freshen();
  }

  /** It ended without a result. */
  failed(message) {
    this.stop();
    if (!this.drawer.root.hidden) this.drawer.remark(message);
  }

  /** Say beside a result that the design has changed since, as soon as it has. */
  freshen() {
    const { made } = this.drawer;
    if (this.drawer.title === PINNED) this.compareAgain();
    if (!made) return;
    const { base, values } = this.on.snapshot(), now = JSON.stringify(values);
    if (base !== made.base) this.drawer.outdated("changed");
    else if (now === JSON.stringify(made.values)) this.drawer.outdated("present");
    else this.drawer.outdated(now === made.tuned ? "applied" : "changed");
  }

  /** The gains that the tuner ended at become those of the page. */
  apply(gains) {
    this.on.apply(gains);
    if (this.drawer.made) this.drawer.made.tuned = JSON.stringify(this.on.snapshot().values);
    this.freshen();
  }

  progress({ task, words, share }) {
    if (share === null) byId("bar").removeAttribute("value");
    else byId("bar").value = share;
    write(byId("work-text"), `${NAMES[task]}: ${words}`);
  }

  close() {
    return this.drawer.close();
  }

  /** Draw with the colours of another theme. */
  recolor() {
    this.fan.recolor();
  }

  falsify(header, rows, design) {
    const unit = this.state.system.units[0];
    this.state.worst = { design, worst: header.worst ?? Infinity, text: header.text, rows, alarm: header.alarm };
    const loop = header.loop === "implemented" ? "of the loop as the drive runs it" : "of the continuous loop";
    const facts = [["worst error found", `${header.text} ${unit}`], ["certified", header.certified ? `${header.certified} ${unit}` : "—"], ["certified / found", header.ratio ? `${header.ratio.toFixed(2)} ×` : "—"], ["loop", loop], ["runs spent", header.spent]];
    for (const [what, why] of Object.entries(header.left_out)) facts.push([`not tried: ${what}`, why]);
    if (header.alarm) facts.unshift(["ALARM", header.reason]);
    const name = `worst-of-${this.state.name.replace(/^.*\//, "")}`;
    const actions = element("div", { class: "actions" }, element("button", { onclick: () => this.on.openText(header.case, name) }, "Open this case"), element("button", { onclick: () => this.on.download(name, header.case) }, "Save it as a file"));
    this.drawer.open("Worst case found", [actions, table(["", ""], facts, "facts"), sentence("The largest error that the search met among cases which the premises admit. It proves nothing, but shows how tight the bound is.")]);
    this.on.note(`Worst case found, ${loop}: ${header.text} ${unit}.`);
    this.on.redraw();
  }

  ensemble(header, rows) {
    const early = header.state === "early";
    this.fan.show(header, rows, early);
    if (!early) this.on.note(`Ensemble of ${header.members} members is done.`);
  }

  tune(header) {
    this.tuning.done(header);
  }

  /** Limits of tuning are shown as lines while its form is open. */
  limits(limits) {
    this.state.tuneLimits = limits;
    this.on.redraw();
  }

  /** Optima of the plant from the same start: each can be laid behind the curves. */
  optimum(header, rows, design) {
    const { state } = this, curves = header.optima.map((_, k) => ({ t: rows[3 * k], e: rows[3 * k + 1], u: rows[3 * k + 2] }));
    const first = header.found.indexOf(true);
    state.optima = { design, curves, shown: first };
    const choices = [["-1", "none"], ...header.optima.map((text, k) => [String(k), `${text}: ${header.table[0][k + 2]}`])].filter(([k]) => k === "-1" || header.found[Number(k)]);
    const pick = element("select", {}, ...choices.map(([value, text]) => element("option", { value, selected: value === String(first) }, text)));
    pick.onchange = () => {
      state.optima = { ...state.optima, shown: Number(pick.value) };
      this.on.redraw();
    };
    const horizon = element("input", { value: String(header.horizon), inputmode: "decimal", autocomplete: "off" });
    const again = element("button", { onclick: () => this.again(horizon.value) }, "Search again");
    const form = element("div", { class: "tune-form" }, element("label", { class: "inline" }, "behind the curves", pick), element("label", { class: "inline" }, "horizon, s", horizon), again);
    this.drawer.open("Optimum: how good any law could be", [form, table(header.columns, header.table, "optima"), ...header.notes.map(sentence)]);
    this.on.note("Optima are done.");
    this.on.redraw();
  }

  again(text) {
    const horizon = typed(text);
    if (horizon > 0) this.start("optimum", { horizon });
    else this.on.note(`horizon: must be a number of seconds above 0, got ${text}`);
  }

  margins(header) {
    const unit = this.state.system.units[0];
    const rows = header.rows.map((row) => [row.label, row.within, row.bounded, row.exact === "-" ? "—" : row.exact]);
    const lines = ["Within the error: no member tried has a larger tail error. Bounded: every one still follows, however badly. Exact edge: where the nominal loop becomes unstable, computed.", `Admitted tail error ${header.error} ${unit} (${header.origin}); ${header.members} members tried at every value, which proves nothing.`, `Delay and saturation at a period of ${header.at} s.`];
    if (header.as_stated) lines.push(`The drive as it stands in the file: tail error ${header.as_stated} ${unit}.`);
    this.drawer.open("Margins of the implementation", [table(["margin", "within the error", "bounded", "exact edge"], rows), ...lines.map(sentence)]);
    this.on.note("Margins are done.");
  }

  compare() {
    const { pins, system } = this.state;
    if (!pins.length) {
      this.drawer.open("Compare", [sentence("Pin a design (P) to compare it with others of this system; to open another system drops its pins.")]);
      return;
    }
    const columns = this.columns();
    const rows = ["certified bound", ...Object.values(system.metrics)].map((name, k) => [name, ...columns.map((column) => column[k])]);
    const button = (text, work) => pins.map((pin) => element("button", { onclick: () => work(pin) }, text));
    const behind = ["behind the curves", ...button("show", (pin) => this.on.behind(pin)), ""];
    const restore = ["gains and file", ...button("go back", (pin) => this.on.restore(pin)), ""];
    this.drawer.open(PINNED, [table(["", ...pins.map((pin) => pin.name), "now"], [behind, restore, ...rows], "pins")]);
  }

  columns() {
    const { pins, run, bound } = this.state;
    return [...pins.map((pin) => this.column(pin.run, pin.before.bound)), this.column(run, bound)];
  }

  /** What is compared of a design; a bound of the fast proof says so, because the finer one of another may be smaller. */
  column(run, bound) {
    const proven = bound?.exact && hasBound(bound) ? `${bound.text}${bound.refining ? " (fast proof)" : ""}` : "—";
    return [proven, ...Object.keys(this.state.system.metrics).map((name) => run?.header.texts[name] ?? "—")];
  }

  /** The present design in the list of pins follows its moves, and so do the bounds of pins that are being refined. */
  compareAgain() {
    const columns = this.columns(), rows = [...this.drawer.body.querySelectorAll("tbody tr")].slice(2);
    if (rows[0].cells.length !== columns.length + 1) this.compare();
    else rows.forEach((row, k) => columns.forEach((column, j) => write(row.cells[j + 1], column[k])));
  }
}
