// Curves as paths on the canvas of a plot, without the points that nobody would miss.

/** A point so near the line that is drawn without it, in pixels of the canvas, is left out. */
const UNSEEN = 0.1;

/** Draws a line through points from left to right, or back: all since its last corner lie in a cone of slopes. */
class Pen {
  path = new Path2D();
  down = false;

  to(x, y) {
    if (!this.down) {
      this.path.moveTo(x, y);
      this.corner(x, y);
    } else {
      const slope = (y - this.fromY) / Math.abs(x - this.fromX);
      if (x === this.fromX || !(slope >= this.least && slope <= this.most)) {
        this.path.lineTo(this.x, this.y);
        this.corner(this.x, this.y);
      }
    }
    this.x = x;
    this.y = y;
    const far = Math.abs(x - this.fromX);
    this.least = Math.max(this.least, (y - UNSEEN - this.fromY) / far);
    this.most = Math.min(this.most, (y + UNSEEN - this.fromY) / far);
  }

  corner(x, y) {
    this.down = true;
    this.fromX = x;
    this.fromY = y;
    this.least = -Infinity;
    this.most = Infinity;
  }

  lift() {
    if (this.down) this.path.lineTo(this.x, this.y);
    this.down = false;
  }
}

/** Where numbers stand on the canvas of a uPlot. */
function positions(u) {
  return ["x", "y"].map((scale) => (value) => u.valToPos(value, scale, true));
}

const drawn = (value) => value !== null && Number.isFinite(value);

/** The line through the points `first` to `last`, with a gap where a value is missing. */
export function line(u, t, values, first = 0, last = t.length - 1) {
  const [across, up] = positions(u), pen = new Pen();
  for (let i = first; i <= last; i += 1) {
    if (drawn(values[i])) pen.to(across(t[i]), up(values[i]));
    else pen.lift();
  }
  pen.lift();
  return pen.path;
}

/** What lies between two curves, wherever there are both. */
export function strip(u, t, high, low) {
  const [across, up] = positions(u), pen = new Pen(), both = (i) => drawn(high[i]) && drawn(low[i]);
  for (let i = 0, end; i < t.length; i = end + 1) {
    for (end = i; end < t.length && both(end); ) end += 1;
    for (let k = i; k < end; k += 1) pen.to(across(t[k]), up(high[k]));
    for (let k = end - 1; k >= i; k -= 1) pen.to(across(t[k]), up(low[k]));
    pen.lift();
  }
  return pen.path;
}
