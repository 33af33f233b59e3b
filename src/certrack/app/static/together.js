// Responses wait a moment for the bound of their design: drawn at once, both cost one frame.

/** The longest wait, ms; none where the last bound came later than so after its responses. */
const LONGEST = 20;

export class Together {
  /** `draw` draws what has come. */
  constructor(draw) {
    this.draw = draw;
    this.late = 0;
  }

  /** The responses of a design have come, whose bound has come before or is on its way. */
  run(design, bounded) {
    this.came = { design, at: performance.now() };
    if (bounded || this.late > LONGEST) this.draw();
    else this.timer ??= setTimeout(() => this.now(), LONGEST);
  }

  /** The bound of a design has come. */
  bound(design) {
    this.answered(design);
    this.now();
  }

  /** It has come, or there is none: so late, or after the responses of a newer design. */
  answered(design) {
    if (this.came?.design === design) this.late = performance.now() - this.came.at;
    else if (this.came?.design > design) this.late = Infinity;
  }

  /** Draw what has come: nothing is waited for any more. */
  now() {
    clearTimeout(this.timer);
    this.timer = null;
    this.draw();
  }
}
