// One number: a logarithmic slider with a field and a lock. Its value keeps its sign.
import { attribute, drawing, element, write, ownGesture } from "./dom.js";
import { format, nameElement, typed } from "./numbers.js";

const SPAN = 10, NEAR = 12, FINE = 0.1;
const STEPS = { ArrowRight: 0.01, ArrowUp: 0.01, ArrowLeft: -0.01, ArrowDown: -0.01, PageUp: 0.1, PageDown: -0.1 };
const spoken = (unit) => (unit === "1/s" ? "per second" : unit);
let count = 0;

export class Slider {
  /** `gain`: label, value, unit, help, positive. `on`: input(slider, event), commit(), problem(text). */
  constructor(parent, gain, on, { lock = true, linked = false } = {}) {
    this.gain = gain;
    this.on = on;
    this.value = gain.value;
    this.base = gain.value;
    this.locked = false;
    this.sign = Math.sign(gain.value) || 1;
    this.low = Math.abs(gain.value) / SPAN;
    this.high = Math.abs(gain.value) * SPAN;
    const id = `gain-${(count += 1)}`;
    const label = nameElement(gain.label, "label");
    label.id = `${id}-label`;
    label.htmlFor = `${id}-field`;
    label.title = gain.help;
    this.fill = element("span", { class: "fill" });
    this.mark = element("span", { class: "mark" });
    this.knob = element("span", { class: "knob" });
    this.track = element("div", { class: "slider", role: "slider", tabindex: 0, "aria-labelledby": `${id}-label`, "aria-describedby": `${id}-help`, "data-path": gain.path ?? "bandwidth" }, this.fill, this.mark, this.knob);
    this.field = element("input", { id: `${id}-field`, inputmode: "decimal", autocomplete: "off", "aria-describedby": `${id}-help` });
    this.lock = element("button", { class: "lock", "aria-pressed": "false", "aria-label": `Lock ${gain.label}`, title: "Keep this gain when bandwidth or tune moves the others  L" }, drawing(12, "M2.5 5.5h7v5h-7z", "M4 5.5V4a2 2 0 0 1 4 0"));
    this.row = element("div", { class: linked ? "gain linked" : "gain" }, label, this.track, element("div", { class: "value" }, this.field, element("i", {}, gain.unit), lock ? this.lock : null), element("span", { class: "vh", id: `${id}-help` }, `${gain.help}. Logarithmic.`));
    parent.append(this.row);
    this.lock.onclick = () => this.toggleLock();
    ownGesture(this.track);
    this.track.addEventListener("pointerdown", (event) => this.press(event));
    this.track.addEventListener("dblclick", (event) => this.set(this.base, event, true));
    this.track.addEventListener("keydown", (event) => this.key(event));
    for (const over of ["keyup", "blur"]) this.track.addEventListener(over, () => this.commitKeys());
    this.field.addEventListener("change", (event) => this.type(event));
    this.field.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.field.value = format(this.value);
      if (event.key === "Escape" || event.key === "Enter") this.field.blur();
    });
    this.field.addEventListener("blur", () => this.show());
    this.ticks();
    this.show();
  }

  toggleLock() {
    this.locked = !this.locked;
    this.lock.setAttribute("aria-pressed", this.locked);
    this.track.setAttribute("aria-disabled", this.locked);
  }

  share(size) {
    return Math.log(size / this.low) / Math.log(this.high / this.low);
  }

  ticks() {
    this.track.querySelectorAll(".decade").forEach((tick) => tick.remove());
    for (let k = Math.ceil(Math.log10(this.low) - 1e-9); k <= Math.log10(this.high) + 1e-9; k += 1) {
      const tick = element("span", { class: "decade" });
      tick.style.left = `${100 * this.share(10 ** k)}%`;
      this.track.prepend(tick);
    }
  }

  press(event) {
    if (event.button || this.refused()) return;
    this.track.focus();
    this.track.setPointerCapture(event.pointerId);
    const box = this.track.getBoundingClientRect(), span = Math.log(this.high / this.low);
    let x = event.clientX, position = Math.log(Math.abs(this.value)), moved = false;
    const away = Math.abs(x - box.left - this.share(Math.abs(this.value)) * box.width);
    if (away > NEAR) {
      position = Math.log(this.low) + (span * (x - box.left)) / box.width;
      moved = true;
      this.set(this.sign * Math.exp(position), event);
    }
    const move = (drag) => {
      if (!moved && Math.abs(drag.clientX - event.clientX) <= 1) return;
      moved = true;
      position += ((drag.clientX - x) / box.width) * span * (drag.shiftKey ? FINE : 1);
      x = drag.clientX;
      this.set(this.sign * Math.exp(position), drag);
    };
    const release = () => {
      this.track.removeEventListener("pointermove", move);
      if (moved) this.on.commit();
    };
    this.track.addEventListener("pointermove", move);
    this.track.addEventListener("pointerup", release, { once: true });
    this.track.addEventListener("pointercancel", release, { once: true });
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = STEPS[event.key];
    let value;
    if (step) value = this.value * (1 + Math.abs(step)) ** (Math.sign(step) * (event.shiftKey ? FINE : 1));
    else if (event.key === "Home") value = this.sign * this.low;
    else if (event.key === "End") value = this.sign * this.high;
    else if (event.key === "Delete" || event.key === "Backspace") value = this.base;
    else return;
    event.preventDefault();
    if (this.refused()) return;
    this.keyed = true; // one gesture until the key is let go
    this.set(value, event);
  }

  commitKeys() {
    if (this.keyed) this.on.commit();
    this.keyed = false;
  }

  type(event) {
    const value = typed(this.field.value);
    const wrong = !Number.isFinite(value) || value === 0 || (this.gain.positive && value < 0);
    if (wrong) {
      this.field.setAttribute("aria-invalid", "true");
      this.on.problem(`${this.gain.label} must be a number ${this.gain.positive ? "above 0" : "that is not 0"}`);
      this.field.value = format(this.value);
      return;
    }
    this.field.removeAttribute("aria-invalid");
    if (this.refused()) return;
    this.sign = Math.sign(value);
    this.set(value, event, true, true);
  }

  refused() {
    if (this.locked) this.on.problem(`${this.gain.label} is locked`);
    return this.locked;
  }

  set(value, event, commit = false, anywhere = false) {
    if (!Number.isFinite(value) || value === 0) return;
    const size = anywhere ? Math.abs(value) : Math.min(Math.max(Math.abs(value), this.low), this.high);
    const next = this.sign * Number(size.toPrecision(anywhere ? 12 : 4));
    if (next === this.value && !commit) return;
    this.quiet(next);
    this.on.input(this, event);
    if (commit) this.on.commit();
  }

  /** The same number of another text. */
  take(gain) {
    this.gain = gain;
    this.quiet(gain.value);
  }

  /** Another value without telling anybody. */
  quiet(value) {
    this.value = value;
    const size = Math.abs(value);
    if (size < this.low || size > this.high) {
      this.low = Math.min(this.low, size / 3);
      this.high = Math.max(this.high, size * 3);
      this.ticks();
    }
    this.show();
  }

  /** Take the present value as the baseline. */
  rebase(value = this.value) {
    this.base = value;
    this.show();
  }

  show() {
    const at = 100 * this.share(Math.abs(this.value)), base = 100 * Math.min(1, Math.max(0, this.share(Math.abs(this.base))));
    this.knob.style.transform = `translateX(${at}cqw)`; // which needs no layout of the page
    this.fill.style.transform = `translateX(${Math.min(at, base)}cqw) scaleX(${Math.abs(at - base) / 100})`;
    this.mark.style.left = `${base}%`;
    if (document.activeElement !== this.field) this.field.value = format(this.value);
    const ends = [this.low, this.high].map((size) => Number((this.sign * size).toPrecision(4))).sort((a, b) => a - b);
    attribute(this.track, "aria-valuemin", ends[0]);
    attribute(this.track, "aria-valuemax", ends[1]);
    attribute(this.track, "aria-valuenow", this.value);
    attribute(this.track, "aria-valuetext", `${format(this.value)} ${spoken(this.gain.unit)}`.trim());
  }
}

/** A number without a slider, because it may be zero. */
export class NumberRow {
  constructor(parent, gain, on) {
    this.gain = gain;
    this.on = on;
    this.value = gain.value;
    this.base = gain.value;
    this.locked = false;
    const id = `gain-${(count += 1)}`;
    const label = nameElement(gain.label, "label");
    label.htmlFor = id;
    label.title = gain.help;
    this.field = element("input", { id, inputmode: "decimal", autocomplete: "off", title: gain.help });
    this.row = element("div", { class: "gain plain" }, label, element("span", { class: "what" }, gain.help), element("div", { class: "value" }, this.field, element("i", {}, gain.unit)));
    parent.append(this.row);
    this.field.addEventListener("change", (event) => {
      const value = typed(this.field.value);
      if (!Number.isFinite(value) || (gain.positive && value <= 0)) {
        on.problem(`${gain.label} must be a number`);
        this.show();
        return;
      }
      this.value = value;
      this.show();
      on.input(this, event);
      on.commit();
    });
    this.field.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.show();
      if (event.key === "Escape" || event.key === "Enter") this.field.blur();
    });
    this.show();
  }

  take(gain) {
    this.gain = gain;
    this.quiet(gain.value);
  }

  quiet(value) {
    this.value = value;
    this.show();
  }

  rebase(value = this.value) {
    this.base = value;
  }

  show() {
    this.field.value = this.value === 0 ? "0" : format(this.value);
    write(this.row.lastChild.lastChild, this.gain.unit);
  }
}
