// One plot: header with title, unit and the values under the cursor; curves, limits and regions on a canvas.
import uPlot from "./vendor/uPlot.js";
import { line, strip } from "./curves.js";
import { drawing, element, token, write } from "./dom.js";
import { Handles } from "./handles.js";
import { format, minus, nameElement, tick } from "./numbers.js";

const LEFT = 62, GRIP = 36, FONT = "11px Inter, system-ui, sans-serif", CURSOR = "certrack";
const magnitude = (value) => (value === null ? null : Math.abs(value)); // a gap stays one
const isDecade = (value) => Math.abs(Math.log10(value) - Math.round(Math.log10(value))) < 1e-9;

export class Plot {
  /**
   * `spec`: id, title, unit, kind, mode, modes, note, last, series [{label, color, dash, width, hidden}], bands,
   * limits() [{y, color, dash, label, below, fit, grip}], handles() see handles.js, ghosts() [{t, y, color, width}], range(lo, hi), end() time.
   * `on`: window(), zoom(low, high), time(t), redraw().
   */
  constructor(parent, spec, on) {
    this.spec = spec;
    this.on = on;
    this.mode = spec.mode ?? "linear";
    this.linear = 1e-3;
    this.data = null;
    this.small = element("small");
    this.legend = element("div", { class: "legend" });
    this.box = element("div", { class: "canvas", role: "img", tabindex: 0, "aria-label": `${spec.title} over time` });
    this.clock = spec.clock ? element("span", { class: "clock" }) : null;
    const head = element("header", {}, element("h2", {}, spec.title, this.small), this.clock, spec.modes ? this.switch() : null, this.legend);
    this.root = element("section", { class: `plot ${spec.kind ?? ""}`, "aria-label": [spec.title, spec.unit].filter(Boolean).join(", ") }, head, this.box);
    parent.append(this.root);
    this.box.addEventListener("keydown", (event) => this.key(event));
    this.box.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.box.addEventListener("pointerdown", (event) => event.shiftKey && this.pan(event), { capture: true });
    this.handles = new Handles(this);
    this.build();
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(this.box);
  }

  switch() {
    const group = element("div", { class: "segments", role: "group", "aria-label": "Axis of the error" });
    this.spec.modes.forEach(([mode, text, help], index) => {
      const button = element("button", { title: `${help}  ${index + 1}`, "aria-pressed": String(mode === this.mode) }, text);
      button.onclick = () => this.setMode(mode);
      button.dataset.mode = mode;
      group.append(button);
    });
    this.segments = group;
    return group;
  }

  setMode(mode) {
    this.mode = mode;
    this.segments.querySelectorAll("button").forEach((button) => button.setAttribute("aria-pressed", String(button.dataset.mode === mode)));
    this.build();
    this.on.redraw();
  }

  build() {
    this.plot?.destroy();
    this.drawn = null;
    const { spec } = this;
    this.colors = { muted: token("--muted"), line: token("--line"), grid: token("--grid"), panel: token("--panel"), tube: token("--tube") };
    this.legend.textContent = "";
    this.power = null;
    this.showUnit(0);
    this.values = spec.series.map((series) => (series.hidden ? null : this.entry(series)));
    const axis = { stroke: this.colors.muted, font: FONT, ticks: { stroke: this.colors.line, width: 1, size: 4 }, grid: { stroke: this.colors.grid, width: 1 } };
    const decades = (u, splits) => splits.map((value) => (isDecade(value) ? value : null));
    const logarithmic = this.mode === "log" ? { filter: decades, grid: { ...axis.grid, filter: decades }, space: 20 } : {};
    const signed = this.mode === "sym" ? { splits: (u, i, low, high) => this.signedSplits(low, high) } : {};
    this.plot = new uPlot(
      {
        width: Math.max(50, this.box.clientWidth),
        height: Math.max(40, this.box.clientHeight),
        padding: [8, 14, spec.last ? 0 : 4, 0],
        legend: { show: false },
        series: [{}, ...spec.series.map((series) => ({ stroke: token(series.color), width: series.width ?? 1.5, dash: series.dash, points: { show: false }, pxAlign: 0, scale: "y", paths: (u, k, first, last) => ({ stroke: line(u, u.data[0], u.data[k], first, last), flags: 0 }) }))],
        scales: { x: { time: false, range: () => this.on.window() }, y: this.scale() },
        axes: [
          { ...axis, size: spec.last ? 32 : 0, gap: 3, ticks: { ...axis.ticks, show: Boolean(spec.last) }, values: (u, splits) => (spec.last ? splits.map((value, i) => (i === splits.length - 1 ? `${tick(value)} s` : tick(value))) : []) },
          { ...axis, scale: "y", size: LEFT, gap: 6, space: (u, i, low, high, size) => Math.max(18, size / 12), values: (u, splits) => this.labels(splits), ...logarithmic, ...signed },
        ],
        cursor: { sync: { key: spec.alone ? `alone-${spec.id}` : CURSOR, setSeries: false, scales: ["x", null] }, points: { size: 5 }, y: false, drag: { x: !spec.alone, y: false, setScale: false } },
        hooks: {
          drawAxes: [(u) => this.behind(u)],
          draw: [(u) => this.above(u)],
          setCursor: [(u) => this.cursor(u)],
          setSelect: [(u) => this.selected(u)],
        },
      },
      this.data ?? [[0, 1], ...spec.series.map(() => [null, null])],
      this.box,
    );
    if (!spec.alone) this.plot.over.addEventListener("dblclick", () => this.on.zoom(null));
  }

  entry(series) {
    const line = drawing(16, "M0 8h16"), value = element("b");
    line.setAttribute("viewBox", "0 4 16 8");
    line.firstChild.style.stroke = `var(${series.color})`;
    if (series.dash) line.firstChild.setAttribute("stroke-dasharray", series.dash.map((d) => d * 0.8).join(" "));
    const name = series.name ? nameElement(series.label) : element("span", {}, series.label);
    if (series.renamed) this.renamed = name;
    this.legend.append(element("span", {}, line, name, value));
    return value;
  }

  scale() {
    if (this.mode === "log") return { distr: 3, log: 10, range: (u, low, high) => this.logRange(high) };
    if (this.mode === "sym") {
      return {
        distr: 4,
        asinh: this.linear,
        range: (u, low, high) => {
          const most = 1.15 * Math.max(Math.abs(low ?? 0), Math.abs(high ?? 0), 1e-12);
          return [-most, most];
        },
      };
    }
    return { range: (u, low, high) => this.linearRange(low, high) };
  }

  linearRange(low, high) {
    let least = low ?? -1, most = high ?? 1;
    for (const limit of this.spec.limits?.(this) ?? []) {
      if (limit.fit) [least, most] = [Math.min(least, limit.y), Math.max(most, limit.y)];
    }
    const own = this.spec.range?.(least, most, this.mode);
    if (own) return own;
    const margin = 0.08 * (most - least || Math.abs(most) || 1);
    return [least - margin, most + margin];
  }

  /** Full decades, from an eighth of the settled error or of the bound, the smaller, up to what is drawn and its limits. */
  logRange(high) {
    const floor = 10 ** Math.floor(Math.log10(Math.min(this.linear, this.settled || this.linear) / 8));
    const fitted = (this.spec.limits?.(this) ?? []).filter((limit) => limit.fit).map((limit) => limit.y);
    return [Math.max(floor, 1e-15), 10 ** Math.ceil(Math.log10(Math.max(high ?? 1, 10 * floor, ...fitted)) - 0.02)];
  }

  signedSplits(low, high) {
    const splits = [0];
    for (let k = Math.ceil(Math.log10(this.linear) - 1e-9); 10 ** k < high; k += 1) splits.push(10 ** k, -(10 ** k));
    return splits.sort((a, b) => a - b);
  }

  /** One power of ten for the whole axis, which the title names. */
  labels(splits) {
    if (this.mode === "log" || this.mode === "sym") return splits.map((value) => (value === null ? "" : tick(value)));
    const most = Math.max(...splits.map(Math.abs));
    const power = most && (most < 0.01 || most >= 1e4) ? 3 * Math.floor(Math.log10(most) / 3) : 0;
    if (power !== this.power) this.showUnit(power);
    return splits.map((value) => tick(Number((value / 10 ** power).toPrecision(6))));
  }

  showUnit(power) {
    this.power = power;
    const { unit, note } = this.spec;
    this.small.textContent = "";
    if (power) {
      const exponent = element("sup", {}, minus(String(power)));
      this.small.append("[10", exponent, unit ? ` ${unit}]` : "]");
    } else if (unit) this.small.append(`[${unit}]`);
    if (note) this.small.append(` ${note}`);
  }

  /** Regions, and curves of other runs. */
  behind(u) {
    const context = u.ctx, log = this.mode === "log";
    context.save();
    context.beginPath();
    context.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
    context.clip();
    for (const { of: [high, low], color } of this.spec.bands ?? []) {
      context.fillStyle = color ? token(color) : this.colors.tube;
      context.fill(strip(u, u.data[0], u.data[high], u.data[low]));
    }
    for (const { t, y, color, width = 1.5, dash = [] } of this.spec.ghosts?.(this) ?? []) {
      context.strokeStyle = token(color);
      context.lineWidth = width * devicePixelRatio;
      context.setLineDash(dash.map((d) => d * devicePixelRatio));
      context.stroke(line(u, t, log ? y.map(magnitude) : y));
    }
    context.restore();
  }

  above(u) {
    const context = u.ctx, ratio = devicePixelRatio, { left, top, width, height } = u.bbox;
    const taken = [];
    const limits = this.spec.limits?.(this) ?? [], gripped = limits.some((limit) => limit.grip);
    for (const { y, color, dash = [7, 4], label: name, below, grip } of limits) {
      let at = u.valToPos(y, "y", true);
      const beyond = at < top - 1 ? -1 : at > top + height + 1 ? 1 : 0;
      if (!Number.isFinite(at) || (beyond && !grip)) continue;
      if (beyond) at = beyond < 0 ? top : top + height;
      const label = name && beyond ? `${name} ${beyond < 0 ? "↑" : "↓"}` : name; // farther than the axis goes
      context.save();
      context.strokeStyle = token(color);
      context.lineWidth = 1.5 * ratio;
      context.setLineDash(dash.map((d) => d * ratio));
      context.beginPath();
      context.moveTo(left, at);
      context.lineTo(left + width, at);
      if (!beyond) context.stroke();
      if (label) {
        context.font = `${11 * ratio}px Inter, system-ui, sans-serif`;
        context.textAlign = "right";
        context.textBaseline = "middle";
        const right = left + width - (gripped ? GRIP : 6) * ratio, wide = context.measureText(label).width;
        let middle = at + (below ? 10 : -10) * ratio;
        if (beyond) middle = at - 10 * beyond * ratio;
        if (middle < top + 8 * ratio) middle = at + 10 * ratio;
        if (middle > top + height - 8 * ratio) middle = at - 10 * ratio;
        let step = (below ? 14 : -14) * ratio;
        while (taken.some((other) => Math.abs(other - middle) < 14 * ratio)) {
          middle += step;
          if (middle < top + 8 * ratio) step = 14 * ratio; // there is no room above: below the others
        }
        taken.push(middle);
        context.globalAlpha = 0.8;
        context.fillStyle = this.colors.panel;
        context.fillRect(right - wide - 3 * ratio, middle - 7 * ratio, wide + 6 * ratio, 14 * ratio);
        context.globalAlpha = 1;
        context.fillStyle = token(color);
        context.fillText(label, right, middle);
      }
      context.restore();
    }
    this.cross(u);
    this.handles.place(u);
  }

  /** A cross where the run ended early. */
  cross(u) {
    const end = this.spec.end?.();
    if (end === null || end === undefined || !this.data) return;
    const times = this.data[0], last = times.length - 1, context = u.ctx, size = 4 * devicePixelRatio;
    const x = u.valToPos(times[last], "x", true);
    const low = u.bbox.top, high = u.bbox.top + u.bbox.height;
    const y = Math.min(high - size, Math.max(low + size, u.valToPos(this.data[1][last] ?? 0, "y", true) || low + size));
    context.save();
    context.strokeStyle = token("--bad");
    context.lineWidth = 2 * devicePixelRatio;
    context.beginPath();
    context.moveTo(x - size, y - size);
    context.lineTo(x + size, y + size);
    context.moveTo(x - size, y + size);
    context.lineTo(x + size, y - size);
    context.stroke();
    context.restore();
  }

  cursor(u) {
    const { idx } = u.cursor, here = idx !== null && idx !== undefined && this.data;
    this.on.time(here ? u.data[0][idx] : null);
    this.values.forEach((value, k) => value && write(value, here && u.data[k + 1][idx] !== null ? format(u.data[k + 1][idx]) : ""));
  }

  selected(u) {
    const { left, width } = u.select;
    if (width <= 4) return;
    const low = u.posToVal(left, "x"), high = u.posToVal(left + width, "x");
    u.setSelect({ left: 0, width: 0 }, false);
    this.on.zoom(low, high);
  }

  key(event) {
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (by) {
      event.preventDefault();
      const width = this.plot.over.clientWidth, now = this.plot.cursor.left ?? -1;
      const left = Math.min(width, Math.max(0, (now < 0 ? width / 2 : now) + by * (event.shiftKey ? 10 : 1)));
      this.plot.setCursor({ left, top: this.plot.over.clientHeight / 2 });
    } else if (event.key === "+" || event.key === "=") this.zoomBy(0.5);
    else if (event.key === "-") this.zoomBy(2);
    else if (event.key === "Escape") this.on.zoom(null);
  }

  zoomBy(factor, center = null) {
    if (this.spec.alone) return;
    const [low, high] = this.on.window(), left = this.plot.cursor.left ?? -1;
    const at = center ?? (left >= 0 ? this.plot.posToVal(left, "x") : (low + high) / 2);
    this.on.zoom(at - (at - low) * factor, at + (high - at) * factor);
  }

  wheel(event) {
    if (!event.ctrlKey) return;
    event.preventDefault();
    const box = this.plot.over.getBoundingClientRect();
    this.zoomBy(event.deltaY > 0 ? 1.25 : 0.8, this.plot.posToVal(event.clientX - box.left, "x"));
  }

  pan(event) {
    if (this.spec.alone) return;
    event.preventDefault();
    event.stopPropagation();
    const [low, high] = this.on.window(), width = this.plot.over.clientWidth, from = event.clientX;
    const move = (drag) => {
      const by = ((from - drag.clientX) / width) * (high - low);
      this.on.zoom(low + by, high + by);
    };
    this.box.setPointerCapture(event.pointerId);
    this.box.addEventListener("pointermove", move);
    this.box.addEventListener("pointerup", () => this.box.removeEventListener("pointermove", move), { once: true });
  }

  set(data) {
    this.data = data;
    if (this.mode === "sym") this.plot.scales.y.asinh = this.linear;
    this.plot.setData(data, true);
  }

  resize() {
    const width = this.box.clientWidth, height = this.box.clientHeight;
    if (width > 40 && height > 20 && (width !== this.plot.width || height !== this.plot.height)) this.plot.setSize({ width, height });
  }

  describe(text) {
    this.box.setAttribute("aria-label", text);
  }

  destroy() {
    this.observer.disconnect();
    this.plot.destroy();
    this.root.remove();
  }
}
