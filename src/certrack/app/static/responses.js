// The plots of a run, on one axis of time.
import { write } from "./dom.js";
import { format, hasBound, nameParts } from "./numbers.js";
import { Plot } from "./plot.js";

const LINES = ["--line-1", "--line-2", "--line-3", "--line-4"], DASHES = [undefined, [6, 3], [2, 3], [8, 3, 2, 3]];
const TWO_COLUMNS = matchMedia("(min-width: 2400px)");
export const ERROR_MODES = [
  ["log", "|e| log", "Size of the error, logarithmic: start, decay and bound in one view"],
  ["sym", "± sym", "Signed: linear within the bound, logarithmic outside"],
  ["zoom", "± zoom", "Signed, linear, scaled to the bound"],
];

/** The bound on |e_1| from the start, at the times t. */
export function tubeAt(tube, times) {
  const { pieces, alpha } = tube, values = new Float64Array(times.length);
  let i = 0;
  for (let k = 0; k < times.length; k += 1) {
    while (i + 1 < pieces.length && pieces[i + 1][0] <= times[k]) i += 1;
    while (i > 0 && pieces[i][0] > times[k]) i -= 1;
    const [begin, square, floor] = pieces[i], decay = Math.exp(-alpha * Math.max(0, times[k] - begin));
    values[k] = Math.sqrt(square * decay + floor * (1 - decay));
  }
  return values;
}

export class Responses {
  /** `state` is read; `on`: zoom(low, high), edit(path, value). */
  constructor(parent, state, on) {
    this.parent = parent;
    this.state = state;
    this.on = on;
    this.plots = [];
    this.dragged = null;
    TWO_COLUMNS.addEventListener("change", () => (this.axes(), this.draw()));
  }

  build(system) {
    const mode = this.error?.mode ?? "log";
    for (const plot of this.plots) plot.destroy();
    this.plots = [];
    const n = system.states.length, { state } = this;
    this.rows = { x: (k) => state.run.rows[1 + k], e: () => state.run.rows[1 + n], y: () => state.run.rows[2 + n], u: () => state.run.rows[3 + n], z: (k) => state.run.rows[4 + n + k] };
    const unit = system.units[0], { rows } = this;
    const end = () => (state.run && state.run.header.outcome !== "finished" ? state.run.header.end : null);
    this.add({ id: "output", title: "Output and reference", unit, clock: true, end, series: [{ label: system.states[0], name: true, color: "--output", width: 2 }, { label: "reference", color: "--reference", dash: [5, 4] }] }, (t) => [t, rows.x(0), rows.y()]);
    this.error = this.add(this.errorSpec(unit, mode, end), (t, plot) => this.errorData(t, plot), () => [this.state.bound, ...this.over()]);
    this.add({ id: "input", title: "Input u", unit: system.units[n], end, series: [{ label: "u", color: "--input" }], ghosts: () => [...this.before("u"), ...this.optimum("u")], limits: () => this.inputLimits(), handles: () => this.inputHandles() }, (t) => [t, rows.u()], () => [this.dragged, ...this.over()]);
    for (const [group, indices] of this.groups(system)) {
      this.add({ id: `states-${indices[0]}`, title: "States", unit: group, end, series: indices.map((k, j) => ({ label: system.states[k], name: true, color: LINES[j], dash: DASHES[j] })) }, (t) => [t, ...indices.map((k) => rows.x(k))]);
    }
    if (system.estimates.length) {
      const known = system.estimated.some((entry) => entry.value !== null);
      this.add({ id: "estimates", title: "Estimates", unit: "", note: known ? "true value dashed" : "", end, series: system.estimates.slice(0, 4).map((name, j) => ({ label: name, name: true, color: LINES[j] })), limits: () => this.trueValues() }, (t) => [t, ...system.estimates.slice(0, 4).map((_, k) => rows.z(k))]);
    }
    this.plots.at(-1).root.classList.add("last");
    this.axes();
    for (const plot of this.plots) plot.spec.id = plot.spec.id ?? plot.spec.title;
  }

  /** The lowest plot carries the axis of time; in two columns the lowest of each. */
  axes() {
    const lowest = TWO_COLUMNS.matches ? 2 : 1;
    this.plots.forEach((plot, k) => {
      const last = k >= this.plots.length - lowest;
      if (last === Boolean(plot.spec.last)) return;
      plot.spec.last = last;
      plot.build();
    });
  }

  /** What else lies over error and input: of this design, or pinned. */
  over() {
    const { before, worst, optima, design, tuneLimits } = this.state, current = (one) => (one?.design === design ? one : null);
    return [before, current(worst), current(optima), tuneLimits];
  }

  /** `data(t, plot)`: times and rows; `others()`: what it shows besides the run. */
  add(spec, data, others = () => []) {
    const plot = new Plot(this.parent, spec, {
      window: () => this.window,
      zoom: (low, high) => this.on.zoom(low, high),
      redraw: () => this.draw(),
      time: (t) => this.plots[0]?.clock && write(this.plots[0].clock, t === null || t === undefined ? "" : `t = ${format(t)} s`),
    });
    Object.assign(plot, { curves: data, others });
    this.plots.push(plot);
    return plot;
  }

  get window() {
    return this.state.window ?? [0, this.state.system?.duration ?? 1];
  }

  /** States of one unit share a plot, at most four. */
  groups(system) {
    const byUnit = new Map();
    system.states.forEach((_, k) => byUnit.set(system.units[k], [...(byUnit.get(system.units[k]) ?? []), k]));
    const groups = [];
    for (const [unit, indices] of byUnit) for (let k = 0; k < indices.length; k += 4) groups.push([unit, indices.slice(k, k + 4)]);
    return groups;
  }

  errorSpec(unit, mode, end) {
    const { state } = this;
    return {
      id: "error", title: "Error", unit, kind: "error", mode, modes: ERROR_MODES, end,
      series: [{ label: "error", color: "--output" }, { label: "tube from the start", renamed: true, color: "--bound", width: 1, dash: [2, 3] }, { label: "", color: "--bound", width: 1, dash: [2, 3], hidden: true }],
      bands: [{ of: [2, 3] }],
      ghosts: () => [...this.before("e"), ...this.optimum("e"), ...this.worstCurve()],
      handles: () => this.tuneHandles("error", unit),
      range: (low, high, axis) => (axis === "zoom" && state.bound?.bound > 0 ? [-1.6 * state.bound.bound, 1.6 * state.bound.bound] : null),
      limits: (plot) => this.errorLimits(plot, unit),
    };
  }

  errorData(t, plot) {
    const e = this.rows.e(), log = plot.mode === "log", tube = this.state.bound?.tube;
    const width = tube ? tubeAt(tube, t) : null, none = () => new Array(t.length).fill(null);
    const below = !width ? none() : log ? new Array(t.length).fill(1e-14) : width.map((value) => -value);
    return [t, log ? e.map(Math.abs) : e, width ?? none(), below];
  }

  errorLimits(plot, unit) {
    const { bound, worst, design } = this.state, limits = [], shown = unit ? ` ${unit}` : "";
    if (hasBound(bound)) {
      const word = bound.contradicted?.length ? "not certified" : bound.exact ? "certified" : "estimated";
      limits.push({ y: bound.bound, color: "--bound", label: `${word} ${bound.text}${shown}`, fit: plot.mode === "log" });
      if (plot.mode !== "log") limits.push({ y: -bound.bound, color: "--bound" });
    }
    limits.push(...this.tuneLimits("error", unit));
    if (worst && worst.design === design && Number.isFinite(worst.worst)) limits.push({ y: worst.worst, color: "--worst", dash: [2, 3], label: `worst found ${worst.text}${shown}`, below: true });
    return limits;
  }

  before(what) {
    const { before, run } = this.state;
    return before?.run && before.run !== run && before[what] ? [{ t: before.t, y: before[what], color: "--before" }] : [];
  }

  worstCurve() {
    const { worst, design } = this.state;
    return worst?.rows && worst.design === design ? [{ t: worst.rows[0], y: worst.rows[1], color: "--worst", width: 1 }] : [];
  }

  /** The trajectory that no law can better, where one was searched for this design. */
  optimum(what) {
    const { optima, design } = this.state, curve = optima?.design === design ? optima.curves[optima.shown] : null;
    return curve ? [{ t: curve.t, y: curve[what], color: "--line-2", dash: [6, 3] }] : [];
  }

  /** Ends of what the actuator gives: of the file, or where they are being dragged to. */
  get saturation() {
    return this.dragged ?? this.state.system?.limits ?? [];
  }

  inputLimits() {
    const { units, limits } = this.state.system, unit = units.at(-1), shown = unit ? ` ${unit}` : "";
    const ends = this.saturation.map((y) => ({ y, color: "--bound", label: `limit ${format(y, 3)}${shown}`, below: y < 0, grip: true }));
    return [...(limits ? ends : []), ...this.tuneLimits("peak_input", unit)];
  }

  inputHandles() {
    const { system } = this.state, unit = system.units.at(-1), symmetric = (system.limits ?? []).reduce((sum, y) => sum + y, 0) === 0;
    const moved = (k, y) => {
      const [low, high] = this.saturation;
      if (symmetric) return [-Math.abs(y), Math.abs(y)];
      return k ? [low, Math.max(y, low)] : [Math.min(y, high), high];
    };
    const help = `What the actuator gives at most: writes implementation.saturation into the file${symmetric ? ", both ends alike" : ""}. Arrows 1 %, PgUp 10 %, Shift a tenth.`;
    const drag = (k, y) => {
      this.dragged = moved(k, y);
      this.redraw();
    };
    const ends = this.saturation.map((y, k) => ({ id: `saturation-${k}`, y, unit, help, label: k ? "Highest input" : "Lowest input", drag: (to) => drag(k, to), done: (to) => this.on.edit("implementation.saturation", `[${moved(k, to).join(", ")}]`) }));
    return [...ends, ...this.tuneHandles("peak_input", unit)];
  }

  /** Limits of tuning, as lines while its form is open; those that are not set yet stand where the run is. */
  tuneLimits(name, unit) {
    const y = this.state.tuneLimits?.[name], word = name === "error" ? "error" : "peak input", shown = unit ? ` ${unit}` : "";
    if (this.state.tuneLimits === null) return [];
    if (!y) return [{ y: this.unlimited(name), color: "--before", label: `no limit on the ${word} of tune: drag`, grip: true }];
    return [{ y, color: "--accent", label: `tune: ${word} at most ${format(y, 3)}${shown}`, grip: true }];
  }

  tuneHandles(name, unit) {
    const { tuneLimits } = this.state;
    if (!tuneLimits) return [];
    const set = (y) => this.on.limit(name, y === null ? null : Math.abs(y));
    const word = name === "error" ? "certified error" : "peak input";
    return [{ id: `tune-${name}`, y: tuneLimits[name] || this.unlimited(name), idle: !tuneLimits[name], unit, label: `Tune: ${word} at most`, help: "A limit that the tuned design keeps: fills in the field of the form below. Arrows 1 %, PgUp 10 %, Delete takes it away.", drag: set, done: set, remove: () => set(null) }];
  }

  unlimited(name) {
    const { bound, run } = this.state;
    return (name === "error" ? bound?.bound : run?.header.metrics.peak_input) || 1;
  }

  /** Where the file has not taken a limit that was dragged. */
  undrag() {
    this.dragged = null;
    this.redraw();
  }

  /** What lies over the curves has changed. */
  redraw() {
    for (const plot of this.plots) if (plot.spec.handles) plot.plot.redraw(false);
  }

  trueValues() {
    const limits = [];
    this.state.system.estimated.slice(0, 4).forEach((entry, k) => {
      if (entry.value !== null) limits.push({ y: entry.value, color: LINES[k], dash: [4, 4], fit: true });
      for (const y of entry.range ?? []) if (y !== null) limits.push({ y, color: LINES[k], dash: [1, 4], fit: true });
    });
    return limits;
  }

  draw() {
    const { run, bound, system } = this.state;
    if (!run || !system) return;
    if (this.of !== system) Object.assign(this, { of: system, dragged: null });
    const tail = run.header.metrics.tail_error;
    this.error.linear = bound?.bound || Math.max(1e-6, Number.isFinite(tail) ? tail : 1e-2); // a scale is never 0
    this.error.settled = tail;
    if (this.error.renamed) write(this.error.renamed, this.tubeName(bound));
    for (const plot of this.plots) {
      const sources = [run, system, ...this.window, ...plot.others()];
      if (sources.every((source, k) => source === plot.drawn?.[k])) continue; // a bound alone changes one plot of them
      plot.set(plot.curves(run.times, plot));
      plot.drawn = sources;
    }
  }

  /** Whose tube it is: where the bound is another proof's, the tube may end elsewhere. */
  tubeName(bound) {
    if (!bound?.tube) return "no tube";
    if (bound.loop === "implemented") return "tube, continuous law";
    return bound.exact && bound.tube.kind !== bound.method ? `tube (${bound.tube.kind})` : "tube from the start";
  }

  /** Redraw with the colours of another theme. */
  recolor() {
    for (const plot of this.plots) plot.build();
    this.draw();
  }

  /** Texts for those who do not see the curves, when a move has come to rest. */
  describe(system, run, bound) {
    const unit = system.units[0];
    for (const plot of this.plots) {
      const rows = plot.plot.data.slice(1), parts = plot.spec.series.map((series, k) => {
        if (series.hidden || series.label.startsWith("tube")) return null;
        let low = Infinity, high = -Infinity;
        for (const value of rows[k]) [low, high] = [Math.min(low, value), Math.max(high, value)];
        return `${series.name ? nameParts(series.label).join(" ") : series.label} from ${format(low, 3)} to ${format(high, 3)}`;
      });
      plot.describe(`${plot.spec.title} over ${system.duration} s: ${parts.filter(Boolean).join(", ")} ${plot.spec.unit}`.trim());
    }
    const certified = hasBound(bound) ? `; certified ${bound.text} ${unit}` : "";
    this.error.describe(`Error over ${system.duration} seconds: after ${system.tail} s at most ${run.header.texts.tail_error} ${unit}${certified}`);
  }
}
