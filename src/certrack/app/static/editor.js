// The text of the file, with numbers of lines, and the line of an error marked.
import { byId, element, settled, style, write } from "./dom.js";

const DELAY = 250;

export class Editor {
  /** `on`: text(text) when it has come to rest, typed(). */
  constructor(on) {
    this.area = byId("text");
    this.lines = byId("lines");
    this.check = byId("check");
    this.problem = null;
    this.shown = "";
    this.numbers = {};
    this.held = false;
    const send = settled(() => !this.held && on.text(this.area.value), DELAY);
    this.area.addEventListener("input", () => {
      this.held = false;
      this.number();
      write(this.check, "…");
      on.typed();
      send();
    });
    this.area.addEventListener("scroll", () => (this.lines.scrollTop = this.area.scrollTop));
  }

  /** What the user has typed and the page does not show yet, or cannot because of its errors; else null. */
  get draft() {
    return this.area.value === this.shown ? null : this.area.value;
  }

  /** What was typed is on its way with something else. */
  hold() {
    this.held = true;
  }

  /** Another text from elsewhere, with the numbers of its gains; the place of the cursor stays. */
  show(text, numbers = {}) {
    Object.assign(this, { shown: text, numbers, held: true });
    if (this.area.value !== text) {
      const { selectionStart, selectionEnd, scrollTop } = this.area;
      this.area.value = text;
      this.area.setSelectionRange(selectionStart, selectionEnd);
      this.area.scrollTop = scrollTop;
    }
    this.number();
  }

  /** A text that has errors, as if it had been typed. */
  draw(text, numbers) {
    Object.assign(this, { numbers, held: true });
    this.area.value = text;
    this.number();
  }

  /** What is wrong with the text; null if nothing is. */
  mark(problem) {
    this.problem = problem;
    style(this.check, problem ? "check bad" : "check");
    write(this.check, problem ? problem.message : "No errors.");
    if (problem?.line) this.check.append(" ", element("button", { onclick: () => this.goTo(problem.line) }, "Go to the line"));
    this.area.setAttribute("aria-invalid", String(Boolean(problem)));
    this.number();
  }

  /** Put the cursor on a line, in the middle of the view. */
  goTo(line) {
    const before = this.area.value.split("\n").slice(0, line - 1).join("\n").length, height = this.area.scrollHeight / this.area.value.split("\n").length;
    const from = line > 1 ? before + 1 : 0, to = this.area.value.indexOf("\n", from);
    this.area.focus();
    this.area.setSelectionRange(from, to < 0 ? this.area.value.length : to);
    this.area.scrollTop = height * line - this.area.clientHeight / 2;
  }

  number() {
    const count = this.area.value.split("\n").length, wrong = this.problem?.line;
    if (this.lines.childElementCount !== count) {
      this.lines.textContent = "";
      for (let k = 1; k <= count; k += 1) this.lines.append(element("span", {}, String(k)));
    }
    [...this.lines.children].forEach((line, k) => style(line, k + 1 === wrong ? "wrong" : ""));
    this.lines.scrollTop = this.area.scrollTop;
  }
}
