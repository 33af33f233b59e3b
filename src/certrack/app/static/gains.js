// The panel of gains: groups of sliders, and one above them that moves the poles together.
import { element } from "./dom.js";
import { NumberRow, Slider } from "./slider.js";

const FOLDED = new Set(["damping", "prior guesses", "weights"]);
const mean = (sliders) => Math.exp(sliders.reduce((sum, slider) => sum + Math.log(Math.abs(slider.value)), 0) / sliders.length);

export class Gains {
  /** `on`: moved(event), commit(), problem(text), step(path, value). */
  constructor(parent, on) {
    this.parent = parent;
    this.on = on;
    this.sliders = new Map();
    this.bandwidth = null;
  }

  /** Show the gains of a system: the sliders that are there already, with the focus and the gesture that they have, or new ones. */
  build(system) {
    const { gains, feedforward } = system;
    const same = JSON.stringify([gains.map(({ value, ...rest }) => [rest, Math.sign(value)]), feedforward]);
    if (this.same === same) {
      for (const gain of gains) this.sliders.get(gain.path).take(gain);
      if (this.bandwidth) this.bandwidth.quiet(Number(mean(this.linked).toPrecision(4)));
      return;
    }
    this.same = same;
    this.rebuild(system);
  }

  /** New sliders; the folds that were open stay open. */
  rebuild(system) {
    const open = new Set([...this.parent.querySelectorAll("details[open]")].map((fold) => fold.dataset.group));
    const locked = new Set([...this.sliders.values()].filter((slider) => slider.locked).map((slider) => slider.gain.path));
    this.parent.textContent = "";
    this.sliders = new Map();
    this.bandwidth = null;
    const linked = system.gains.filter((gain) => gain.linked && gain.logarithmic);
    const folds = system.gains.some((gain) => !FOLDED.has(gain.group)); // there is always something to move
    const on = { input: (slider, event) => this.input(slider, event), commit: () => this.on.commit(), problem: (text) => this.on.problem(text) };
    let group = "", box = this.parent;
    if (linked.length > 1) {
      const value = mean(linked.map((gain) => ({ value: gain.value })));
      this.bandwidth = new Slider(this.parent, { path: "bandwidth", label: "bandwidth", value: Number(value.toPrecision(4)), unit: "1/s", help: "Moves all error poles together; locked ones stay", positive: true }, { ...on, input: (slider, event) => this.moveTogether(slider.value, event) }, { lock: false, linked: true });
    }
    for (const gain of system.gains) {
      if (gain.group !== group) {
        group = gain.group;
        box = this.box(group, open.has(group) || !folds);
      }
      const slider = gain.logarithmic ? new Slider(box, gain, on) : new NumberRow(box, gain, on);
      if (locked.has(gain.path) && slider.toggleLock) slider.toggleLock();
      this.sliders.set(gain.path, slider);
    }
    if (system.feedforward) this.stepper(system.feedforward);
    if (!system.gains.length) this.parent.append(element("p", { class: "sub" }, "This law has no numbers to move: see System."));
  }

  box(group, isOpen) {
    if (!FOLDED.has(group)) {
      const box = element("div", { class: "gain-group", role: "group", "aria-label": group });
      if (group !== "poles") box.append(element("h3", {}, group));
      this.parent.append(box);
      return box;
    }
    const fold = element("details", { class: "gain-group", "data-group": group, open: isOpen }, element("summary", {}, element("h3", {}, group)));
    this.parent.append(fold);
    return fold;
  }

  stepper({ value, most, path }) {
    const shown = element("output", { "aria-live": "polite" }, String(value));
    const step = (by) => element("button", { class: "icon small", "aria-label": by < 0 ? "Fewer derivatives" : "More derivatives", disabled: by < 0 ? value <= 0 : value >= most, onclick: () => this.on.step(path, String(value + by)) }, by < 0 ? "−" : "+");
    this.parent.append(element("div", { class: "gain-group" }, element("div", { class: "stepper", role: "group", "aria-label": "feed-forward" }, element("span", { title: "Derivatives of y_d in the virtual controls" }, "feed-forward q"), step(-1), shown, step(1))));
  }

  get linked() {
    return [...this.sliders.values()].filter((slider) => slider.gain.linked && slider.gain.logarithmic);
  }

  input(slider, event) {
    if (slider.gain.linked && this.bandwidth) this.bandwidth.quiet(Number(mean(this.linked).toPrecision(4)));
    this.on.moved(event);
  }

  moveTogether(target, event) {
    const linked = this.linked, free = linked.filter((slider) => !slider.locked);
    if (!free.length) return;
    const factor = (target / mean(linked)) ** (linked.length / free.length);
    for (const slider of free) slider.quiet(Number((slider.value * factor).toPrecision(4)));
    this.on.moved(event);
  }

  /** All numbers by their paths. */
  all() {
    return Object.fromEntries([...this.sliders].map(([path, slider]) => [path, slider.value]));
  }

  /** The numbers that differ from those of the text. */
  values(system) {
    const changed = {};
    for (const gain of system.gains) {
      const slider = this.sliders.get(gain.path);
      if (slider && slider.value !== gain.value) changed[gain.path] = slider.value;
    }
    return changed;
  }

  /** Set numbers: those of the text, but for the ones named. */
  set(system, values, { keepLocked = false } = {}) {
    for (const gain of system.gains) {
      const slider = this.sliders.get(gain.path);
      if (!slider || (keepLocked && slider.locked)) continue;
      slider.quiet(values[gain.path] ?? gain.value);
    }
    if (this.bandwidth) this.bandwidth.quiet(Number(mean(this.linked).toPrecision(4)));
  }

  /** Marks of the baseline: the present values, or those of a pin. */
  rebase(bases = null) {
    for (const [path, slider] of this.sliders) slider.rebase(bases?.get(path) ?? slider.value);
    if (this.bandwidth) this.bandwidth.rebase(bases?.get("bandwidth") ?? this.bandwidth.value);
  }

  bases() {
    const bases = new Map([...this.sliders].map(([path, slider]) => [path, slider.base]));
    if (this.bandwidth) bases.set("bandwidth", this.bandwidth.base);
    return bases;
  }

  /** Lock or unlock the slider that has the focus; whether there was one. */
  lockFocused() {
    const slider = [...this.sliders.values()].find((entry) => entry.row.contains(document.activeElement));
    slider?.toggleLock?.();
    return Boolean(slider);
  }
}
