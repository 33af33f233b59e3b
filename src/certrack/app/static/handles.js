// Limits that can be moved where they are drawn: a grip at the right end of the line, by mouse and by keys.
import { element, ownGesture, write } from "./dom.js";
import { format } from "./numbers.js";

const STEPS = { ArrowUp: 0.01, ArrowDown: -0.01, PageUp: 0.1, PageDown: -0.1 }, FINE = 0.1, WIDTH = 30, HALF = 8, DIGITS = 3;
const rounded = (value) => Number(value.toPrecision(DIGITS));

export class Handles {
  /** `plot` has root, box, plot (uPlot) and spec.handles() [{id, y, label, unit, help, drag(y), done(y), remove()}]. */
  constructor(plot) {
    this.plot = plot;
    this.made = new Map();
  }

  /** Where the lines are now; grips that are not wanted any more go. */
  place(u) {
    const wanted = this.plot.spec.handles?.() ?? [], ids = new Set(wanted.map((handle) => handle.id));
    for (const [id, entry] of this.made) {
      if (ids.has(id)) continue;
      entry.grip.remove();
      this.made.delete(id);
    }
    const { over } = u, { box } = this.plot, taken = [];
    const place = (y) => Math.min(over.clientHeight - HALF, Math.max(HALF, u.valToPos(y, "y"))), off = (y) => Math.abs(place(y) - u.valToPos(y, "y"));
    for (const handle of [...wanted].sort((a, b) => off(a.y) - off(b.y))) { // those on their lines first: the rest give way
      const entry = this.made.get(handle.id) ?? this.make(handle.id);
      entry.handle = handle;
      let at = place(handle.y);
      const by = at < over.clientHeight / 2 ? 2 * HALF : -2 * HALF;
      while (taken.some((other) => Math.abs(other - at) < 2 * HALF)) at += by;
      taken.push(at);
      entry.grip.style.top = `${box.offsetTop + over.offsetTop + (Number.isFinite(at) ? at : HALF)}px`;
      entry.grip.style.left = `${box.offsetLeft + over.offsetLeft + over.clientWidth - WIDTH}px`;
      entry.grip.className = handle.idle ? "limit-grip idle" : "limit-grip";
      entry.grip.title = `${handle.label} ${format(handle.y, DIGITS)} ${handle.unit}\n${handle.help}`;
      entry.grip.setAttribute("aria-label", handle.label);
      entry.grip.setAttribute("aria-valuenow", handle.y);
      entry.grip.setAttribute("aria-valuetext", `${format(handle.y, DIGITS)} ${handle.unit}`.trim());
      write(entry.help, handle.help);
    }
  }

  make(id) {
    const help = element("span", { class: "vh", id: `${id}-help` });
    const grip = element("div", { class: "limit-grip", role: "slider", tabindex: 0, "aria-orientation": "vertical", "aria-describedby": `${id}-help`, "data-handle": id }, help);
    const entry = { grip, help };
    ownGesture(grip);
    grip.addEventListener("pointerdown", (event) => this.press(event, entry));
    grip.addEventListener("keydown", (event) => this.key(event, entry));
    this.plot.root.append(grip);
    this.made.set(id, entry);
    return entry;
  }

  press(event, made) {
    if (event.button) return;
    event.stopPropagation();
    const { grip } = made;
    grip.focus();
    grip.setPointerCapture(event.pointerId);
    const from = event.clientY;
    let value = null;
    const move = (drag) => {
      if (value === null && Math.abs(drag.clientY - from) <= 1) return;
      const u = this.plot.plot;
      value = rounded(u.posToVal(drag.clientY - u.over.getBoundingClientRect().top, "y"));
      if (Number.isFinite(value)) made.handle.drag(value);
    };
    const release = () => {
      grip.removeEventListener("pointermove", move);
      if (value !== null && Number.isFinite(value)) made.handle.done(value);
    };
    grip.addEventListener("pointermove", move);
    grip.addEventListener("pointerup", release, { once: true });
    grip.addEventListener("pointercancel", release, { once: true });
  }

  key(event, entry) {
    const { handle } = entry, step = STEPS[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Delete" && handle.remove) handle.remove();
    else if (step) {
      const factor = (1 + Math.abs(step)) ** (Math.sign(step) * (event.shiftKey ? FINE : 1));
      const value = Number((handle.y * (handle.y < 0 ? 1 / factor : factor)).toPrecision(DIGITS + 1));
      handle.drag(value);
      handle.done(value);
    } else return;
    event.preventDefault();
    event.stopPropagation();
  }
}
