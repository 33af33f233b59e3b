// Texts on their way to the server. Each has a number: what is of an older one is dropped, and the newest wins.
import { note } from "./notes.js";
import { state } from "./state.js";

const KB = 1024, ROUNDING = 1e-9;
const near = (a, b) => a === b || Math.abs(a - b) <= ROUNDING * Math.abs(a);

export class Texts {
  /** `on`: send(message), all() numbers of the sliders by path, values() those that differ from the text, editor(). */
  constructor(on) {
    this.on = on;
    this.entries = {};
    this.ancestor = {};
    this.pending = null;
  }

  /** Send a text; `restoring` says what else belongs to it, `ancestor` which numbers it was made from. */
  ask(message, restoring = null, ancestor = this.on.all()) {
    const most = state.greeting?.most ?? Infinity, size = new TextEncoder().encode(message.text ?? "").length;
    if (size > most) return note(`This text has ${Math.ceil(size / KB)} kB, and at most ${most / KB} kB are read: use the command line.`);
    if (message.type !== "edit") this.entries = {};
    state.asked += 1;
    state.restoring = restoring;
    this.ancestor = ancestor;
    this.pending = { message, restoring, ancestor };
    return this.on.send({ ...message, revision: state.asked });
  }

  /** The text as the user has it in the editor. */
  text(text) {
    return this.ask({ type: "text", text, name: state.name }, { source: "editor" }, this.on.editor().numbers);
  }

  /** An entry of the form, with those that are still on their way; a text that has errors is the one to mend. */
  edit(path, value) {
    this.entries[path] = value;
    const { draft } = this.on.editor(), gains = draft === null ? this.on.values() : {};
    this.on.editor().hold();
    const sent = draft ?? state.base, entries = { ...this.entries };
    return this.ask({ type: "edit", text: sent, name: state.name, entries, gains }, { source: "form", sent, entries });
  }

  /** Whether an answer is that to the newest text. */
  answered(revision) {
    if (revision !== state.asked) return false;
    this.pending = null;
    this.entries = {};
    return true;
  }

  /** Numbers that were moved while the text was read, where the text itself has left them as they were. */
  moved(gains, values, mine) {
    const kept = {};
    for (const { path, value } of gains) {
      const target = values[path] ?? value, before = this.ancestor?.[path];
      if (before !== undefined && mine[path] !== undefined && near(target, before) && !near(mine[path], before)) kept[path] = mine[path];
    }
    return kept;
  }
}
