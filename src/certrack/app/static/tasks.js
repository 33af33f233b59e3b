// The bottom bar: long computations with progress and cancel, and the drawer with their results.
import { byId, element, write } from "./dom.js";
import { format, nameParts } from "./numbers.js";
import { Plot } from "./plot.js";

const NAMES = { falsify: "Falsify", ensemble: "Ensemble", margins: "Margins", tune: "Tune", compare: "Compare", export: "Export" };
const OBJECTIVES = { error: "certified error", peak: "peak input", energy: "input energy", period: "longest stable period" };
const LIMITS = [["error", "certified error at most"], ["peak_input", "peak input at most"], ["energy", "energy at most"], ["period", "stable if held for, s"], ["noise", "noise gain at most"]];

export class Tasks {
  /** `on`: start(task, options), cancel(), apply(gains), restore(pin), note(text). */
  constructor(state, on) {
    this.state = state;
    this.on = on;
    this.running = null;
    this.drawer = byId("drawer");
    this.fan = null;
    byId("tasks").addEventListener("click", (event) => {
      const task = event.target.dataset?.task;
      if (task) this.press(task);
    });
    byId("cancel").onclick = () => on.cancel();
  }

  press(task) {
    if (!this.state.system) return;
    if (task === "tune") this.tuneForm();
    else if (task === "compare") this.compare();
    else this.start(task, {});
  }

  start(task, options) {
    if (this.running) {
      this.on.note("One long computation at a time: wait for it or cancel it.");
      return;
    }
    this.on.start(task, options);
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
    this.stop();
    if (header.state === "cancelled") {
      this.on.note("Cancelled.");
      return;
    }
    this[header.task]?.(header, rows, design);
  }

  progress({ task, done, total, best }) {
    if (total) byId("bar").value = done / total;
    const unit = this.state.system.units[0], word = task === "tune" ? "best" : "worst";
    const count = total ? `${Math.round(done)} of ${Math.round(total)}` : `${Math.round(done)}`;
    write(byId("work-text"), `${NAMES[task]} ${count}${best === null ? "" : ` · ${word} so far ${format(best, 4)} ${unit}`}`.trim());
  }

  open(title, ...content) {
    this.fan?.destroy();
    this.fan = null;
    this.drawer.textContent = "";
    const close = element("button", { class: "icon small", "aria-label": "Close the result", title: "Close  Esc", onclick: () => this.close() }, "×");
    const grip = element("div", { class: "grip", role: "separator", tabindex: 0, "aria-orientation": "horizontal", "aria-label": "Height of the result", "aria-valuenow": 240, "aria-valuemin": 120, "aria-valuemax": 600 });
    this.resizable(grip);
    this.body = element("div", { class: "drawer-body", tabindex: 0, role: "group", "aria-label": title }, ...content);
    this.drawer.append(grip, element("header", {}, element("h2", {}, title), element("span", { class: "spacer" }), close), this.body);
    this.drawer.hidden = false;
  }

  resizable(grip) {
    const set = (height) => {
      const value = Math.max(120, Math.min(600, height));
      this.drawer.style.height = `${value}px`;
      grip.setAttribute("aria-valuenow", Math.round(value));
    };
    grip.addEventListener("pointerdown", (event) => {
      grip.setPointerCapture(event.pointerId);
      const from = event.clientY, height = this.drawer.offsetHeight;
      const move = (drag) => set(height + from - drag.clientY);
      grip.addEventListener("pointermove", move);
      grip.addEventListener("pointerup", () => grip.removeEventListener("pointermove", move), { once: true });
    });
    grip.addEventListener("keydown", (event) => {
      const by = { ArrowUp: 20, ArrowDown: -20 }[event.key];
      if (by) {
        event.preventDefault();
        set(this.drawer.offsetHeight + by);
      }
    });
  }

  close() {
    const was = !this.drawer.hidden;
    this.fan?.destroy();
    this.fan = null;
    this.drawer.hidden = true;
    this.drawer.textContent = "";
    return was;
  }

  falsify(header, rows, design) {
    const unit = this.state.system.units[0];
    this.state.worst = { design, worst: header.worst ?? Infinity, text: header.text, rows, alarm: header.alarm };
    const loop = header.loop === "implemented" ? "of the loop as the drive runs it" : "of the continuous loop";
    const facts = [["worst error found", `${header.text} ${unit}`], ["certified", header.certified ? `${header.certified} ${unit}` : "—"], ["certified / found", header.ratio ? `${header.ratio.toFixed(2)} ×` : "—"], ["loop", loop], ["runs spent", String(header.runs)]];
    for (const [what, why] of Object.entries(header.left_out)) facts.push([`not tried: ${what}`, why]);
    if (header.alarm) facts.unshift(["ALARM", header.reason]);
    this.open("Worst case found", table(["", ""], facts, "facts"), element("p", { class: "sub" }, "The largest error that the search met among cases which the premises admit. It proves nothing, but shows how tight the bound is."));
    this.on.note(`Worst of ${header.runs} admissible cases: ${header.text} ${unit}.`);
    this.on.redraw();
  }

  ensemble(header, rows) {
    const { signals, levels } = header, times = rows[0], count = signals.length, unit = this.state.system.units;
    const violations = header.violations, units = { e_1: unit[0], u: unit.at(-1) };
    const chart = element("div", { class: "fan" }), pick = element("select", { "aria-label": "Signal of the fan chart" }, ...signals.map((name) => element("option", {}, name)));
    const lines = [`${header.members} members, seed ${header.seed}: ${Object.entries(header.outcomes).map(([name, n]) => `${n} ${name}`).join(", ")}.`];
    if (violations) lines.push(`Tail error beyond ${header.limit_text} (${header.limit_origin}): ${violations.count}${violations.interval ? `, probability within ${format(violations.interval[0], 3)} to ${format(violations.interval[1], 3)} (95 %)` : ""}.`);
    const stats = table(["metric", "median", "95 %", "99 %", "largest"], header.table);
    this.open("Ensemble", element("div", { class: "split" }, element("div", { class: "fan-side" }, pick, chart), element("div", {}, ...lines.map((line) => element("p", { class: "sub" }, line)), stats)));
    const draw = () => {
      this.fan?.destroy();
      const s = signals.indexOf(pick.value), [letter, index] = nameParts(pick.value);
      const last = levels.length - 1, band = (level) => rows[1 + level * count + s];
      const pairs = levels.map((_, k) => [k + 1, last - k + 1]).filter(([a, b]) => a < b);
      this.fan = new Plot(chart, {
        id: "fan", alone: true, title: `${letter}${index}`, unit: units[pick.value] ?? unit[signals.indexOf(pick.value) - 1] ?? "", last: true,
        series: levels.map((level) => ({ label: `${format(100 * level, 3)} %`, color: "--line-1", width: level === 0.5 ? 1.5 : 0.5, hidden: level !== 0.5 })),
        bands: pairs.map((of) => ({ of: [of[1], of[0]], color: "--fan" })),
      }, { window: () => [0, this.state.system.duration], zoom: () => {}, time: () => {}, redraw: () => {} });
      this.fan.set([times, ...levels.map((_, k) => band(k))]);
    };
    pick.onchange = draw;
    draw();
    this.on.note(`Ensemble of ${header.members} members is done.`);
  }

  margins(header) {
    const unit = this.state.system.units[0];
    const rows = header.rows.map((row) => [row.label, row.within, row.bounded, row.exact]);
    const lines = [`Admitted tail error ${header.error} ${unit} (${header.origin}); ${header.members} members tried at every value, which proves nothing.`, `Delay and saturation at a period of ${header.at} s.`];
    if (header.as_stated) lines.push(`The drive as it stands in the file: tail error ${header.as_stated} ${unit}.`);
    this.open("Margins of the implementation", table(["margin", "within the error", "bounded", "exact edge"], rows), ...lines.map((line) => element("p", { class: "sub" }, line)));
    this.on.note("Margins are done.");
  }

  tuneForm() {
    const objective = element("select", { id: "tune-objective" }, ...Object.entries(OBJECTIVES).map(([value, text]) => element("option", { value }, text)));
    const fields = LIMITS.map(([name, text]) => element("label", { class: "inline" }, text, element("input", { name, inputmode: "decimal", placeholder: "no limit", autocomplete: "off" })));
    const starts = element("input", { name: "starts", inputmode: "numeric", value: "2", autocomplete: "off" });
    const front = element("select", { name: "front" }, element("option", { value: "" }, "none"), ...["period", "peak-input", "energy", "noise", "error"].map((name) => element("option", {}, name)));
    const begin = element("button", { class: "primary" }, "Tune");
    const form = element("div", { class: "tune-form" }, element("label", { class: "inline" }, "optimise", objective), ...fields, element("label", { class: "inline" }, "searches", starts), element("label", { class: "inline" }, "sweep a limit", front), begin);
    this.open("Tune within limits", form, element("p", { class: "sub" }, "Locked gains are kept when the result is applied. The tuned design is certified in full."));
    begin.onclick = () => {
      const options = { objective: objective.value, starts: Number(starts.value) || 2, front: front.value };
      for (const input of this.body.querySelectorAll(".inline input[name]")) {
        const value = Number(input.value.replace(",", "."));
        if (input.name !== "starts" && input.value.trim()) {
          if (!(value > 0)) {
            this.on.note(`${input.name} must be a number above 0`);
            return;
          }
          options[input.name] = value;
        }
      }
      this.lastTune = options;
      this.start("tune", options);
    };
    objective.focus();
  }

  tune(header) {
    const apply = element("button", { class: "primary", onclick: () => this.on.apply(header.gains) }, "Use these gains");
    const again = element("button", { onclick: () => this.tuneForm() }, "Change the limits");
    const notes = [...header.active.map((limit) => `Active: ${limit.limit} ${format(limit.value)}; a tenth more of it gains ${(100 * Math.abs(limit.price)).toFixed(1)} %.`), ...header.notes, `Limits: ${[...new Set(header.limits)].join(", ") || "none"}.`];
    const parts = [element("div", { class: "actions" }, apply, again), table(["", "before", "after"], header.table), ...notes.map((note) => element("p", { class: "sub" }, note))];
    if (header.front) parts.push(this.front(header.front));
    this.open("Tuned design", ...parts);
    this.on.note("Tuning is done.");
  }

  /** The swept limit; a click tunes with that value of it. */
  front({ limit, objective, points }) {
    const rows = points.map(([value, best]) => {
      const go = element("button", { onclick: () => this.start("tune", { ...this.lastTune, front: "", [limit.replace("-", "_").replace(" ", "_")]: value }) }, "tune to this");
      return [format(value), best === null ? "nothing keeps all limits" : format(best), best === null ? "" : go];
    });
    return element("div", {}, element("h3", {}, `Front: ${objective} against ${limit} (estimates)`), table([limit, objective, ""], rows));
  }

  compare() {
    const { pins, system, run, bound } = this.state;
    if (!pins.length) {
      this.open("Compare", element("p", { class: "sub" }, "Pin a design (P) to compare it with others; every pin stays in this list."));
      return;
    }
    const now = { name: "now", run, bound: bound?.exact ? bound : null };
    const designs = [...pins, now], names = Object.keys(system.metrics);
    const rows = [["certified bound", ...designs.map((d) => d.bound?.text ?? "—")], ...names.map((name) => [system.metrics[name], ...designs.map((d) => d.run.header.texts[name] ?? "—")])];
    const restore = ["", ...pins.map((pin) => element("button", { onclick: () => this.on.restore(pin) }, "go back")), ""];
    this.open("Pinned designs", table(["", ...designs.map((d) => d.name)], [...rows, restore]));
  }
}

/** A table of texts and elements. */
function table(heads, rows, name = "") {
  const body = element("tbody", {}, ...rows.map(([head, ...cells]) => element("tr", {}, element("th", { scope: "row" }, head), ...cells.map((cell) => element("td", {}, cell)))));
  const top = heads.some(Boolean) ? element("thead", {}, element("tr", {}, ...heads.map((head, k) => (head ? element("th", { scope: "col" }, head) : k ? element("td") : element("td"))))) : "";
  return element("table", { class: `result ${name}` }, top, body);
}
