// The reference drawn in the form: y_d and its derivatives with their limits, and points to be moved.
import { element, ownGesture, shape } from "./dom.js";
import { format, roundedUp } from "./numbers.js";

const WIDTH = 290, LEFT = 18, RIGHT = 8, HIGH = 84, LOW = 34, GAP = 18, RADIUS = 5, STEP = 0.02, DIGITS = 4;
const MARKS = ["y", "y′", "y″", "y‴"], PER = ["", "/s", "/s²", "/s³"];

export class Profile {
  /** `on`: edit(path, value). */
  constructor(on) {
    this.on = on;
  }

  /** The kind of a reference, and its drawing. */
  build(reference, unit) {
    const kind = element("select", { id: "field-reference.kind", "data-path": "reference.kind" }, ...reference.kinds.map(([name, possible]) => element("option", { value: name, selected: name === reference.kind, disabled: !possible && name !== reference.kind }, possible ? name : `${name} (not smooth enough)`)));
    if (!reference.kinds.some(([name]) => name === reference.kind)) kind.prepend(element("option", { value: reference.kind, selected: true }, reference.kind));
    kind.addEventListener("change", () => this.on.edit("reference.kind", kind.value));
    const hint = reference.points ? "Drag a point, or move it by ↑ ↓." : null;
    return element("div", { class: "field profile" }, element("label", { for: kind.id }, "kind"), kind, this.drawing(reference, unit), hint ? element("span", { class: "help" }, hint) : null);
  }

  drawing({ times, rows, limits, points }, unit) {
    const end = times.at(-1) || 1, x = (t) => LEFT + ((WIDTH - LEFT - RIGHT) * t) / end;
    const height = rows.reduce((sum, _, k) => sum + (k ? LOW : HIGH) + GAP, 0);
    const peaks = rows.map((_, k) => (limits[k] === null ? "" : `${MARKS[k]} at most ${roundedUp(limits[k], DIGITS)} ${unit}${PER[k]}`));
    const svg = shape("svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "group", "aria-label": `Reference over ${end} s. ${peaks.filter(Boolean).join("; ")}` });
    let top = 0;
    rows.forEach((row, k) => {
      const tall = k ? LOW : HIGH, from = top + GAP, low = Math.min(0, ...row), high = Math.max(0, ...row), range = high - low || 1;
      const y = (v) => from + tall * (1 - (v - low) / range);
      svg.append(shape("text", { x: 0, y: from - 5 }, MARKS[k]), shape("text", { x: WIDTH, y: from - 5, class: "end" }, limits[k] === null ? "no limit" : `≤ ${roundedUp(limits[k], DIGITS)} ${unit || (PER[k] && "1")}${PER[k]}`));
      svg.append(shape("path", { class: "zero", d: `M${LEFT} ${y(0)}H${WIDTH - RIGHT}` }));
      svg.append(shape("path", { class: k ? "derivative" : "curve", d: row.map((v, i) => `${i ? "L" : "M"}${x(times[i]).toFixed(1)} ${y(v).toFixed(1)}`).join("") }));
      if (!k && points) this.points(svg, points, x, { y, range, tall, unit });
      top = from + tall;
    });
    return svg;
  }

  points(svg, { path, values, times }, x, scale) {
    values.forEach((value, k) => {
      if (times[k] === null) return;
      const text = (now) => `${path}[${k}] = ${format(now)} ${scale.unit}`.trim();
      const title = shape("title", {}, text(value));
      const point = shape("circle", { cx: x(times[k]), cy: scale.y(value), r: RADIUS, tabindex: 0, role: "slider", "aria-label": `point ${k + 1} of ${path}`, "aria-valuenow": value, "aria-valuetext": text(value), "data-path": `${path}[${k}]` }, title);
      const take = (now) => {
        const changed = values.map((old, j) => (j === k ? Number(now.toPrecision(3)) : old));
        this.on.edit(path, `[${changed.join(", ")}]`);
      };
      point.addEventListener("keydown", (event) => {
        const by = { ArrowUp: 1, ArrowDown: -1 }[event.key];
        if (!by) return;
        event.preventDefault();
        take(value + by * STEP * scale.range);
      });
      ownGesture(point);
      point.addEventListener("pointerdown", (event) => this.drag(event, svg, point, title, value, scale, text, take));
      svg.append(point);
    });
  }

  /** Follow the pointer; the file changes when it is let go. */
  drag(begin, svg, point, title, value, { y, range, tall }, text, take) {
    const pixel = svg.getBoundingClientRect().width / WIDTH;
    let now = value;
    point.focus();
    point.setPointerCapture(begin.pointerId);
    const move = (event) => {
      now = value - ((event.clientY - begin.clientY) / pixel / tall) * range;
      point.setAttribute("cy", y(now));
      title.textContent = text(now);
    };
    point.addEventListener("pointermove", move);
    point.addEventListener("pointerup", () => {
      point.removeEventListener("pointermove", move);
      if (Math.abs(now - value) > STEP * range / 4) take(now);
      else point.setAttribute("cy", y(value));
    }, { once: true });
  }
}
