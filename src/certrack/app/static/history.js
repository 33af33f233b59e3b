// Undo and redo: one step for each gesture.

const MOST_UNDO = 200;

const same = (a, b) => a && b && a.base === b.base && a.before === b.before && JSON.stringify(a.values) === JSON.stringify(b.values);

export class History {
  /** `on`: snapshot(), show(snapshot), changed(). */
  constructor(on) {
    this.on = on;
    this.clear();
  }

  clear() {
    Object.assign(this, { undo: [], redo: [], present: null });
  }

  /** What is shown now is where the next step begins. */
  settle(snapshot = this.on.snapshot()) {
    this.present = snapshot;
  }

  /** A gesture is over. */
  commit() {
    const now = this.on.snapshot();
    if (same(now, this.present)) return;
    if (this.present) this.undo.push(this.present);
    if (this.undo.length > MOST_UNDO) this.undo.shift();
    this.redo = [];
    this.settle(now);
    this.on.changed();
  }

  back() {
    this.travel(this.undo, this.redo);
  }

  forth() {
    this.travel(this.redo, this.undo);
  }

  travel(from, to) {
    if (!from.length) return;
    to.push(this.present);
    this.settle(from.pop());
    this.on.show(this.present);
    this.on.changed();
  }
}
