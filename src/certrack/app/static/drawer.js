// The drawer over the lower part of the plots, where results of long computations are shown.
import { element, ownGesture } from "./dom.js";
import { worded } from "./numbers.js";

const LEAST = 120, MOST = 600, STEP = 20, USUAL = 240;

/** A table of texts and elements. */
export function table(heads, rows, name = "") {
  const body = element("tbody", {}, ...rows.map(([head, ...cells]) => element("tr", {}, element("th", { scope: "row" }, ...(typeof head === "string" ? worded(head) : [head])), ...cells.map((cell) => element("td", {}, cell)))));
  const top = heads.some(Boolean) ? element("thead", {}, element("tr", {}, ...heads.map((head) => (head ? element("th", { scope: "col" }, head) : element("td"))))) : "";
  return element("table", { class: `result ${name}` }, top, body);
}

export const sentence = (text) => element("p", { class: "sub" }, text);

export class Drawer {
  constructor(root) {
    this.root = root;
    this.leave = null;
  }

  /** Show a result; `leave` is called when it goes. */
  open(title, content, leave = null) {
    this.leave?.();
    Object.assign(this, { leave, title, made: null });
    this.root.textContent = "";
    const close = element("button", { class: "icon small", "aria-label": "Close the result", title: "Close  Esc", onclick: () => this.close() }, "×");
    this.body = element("div", { class: "drawer-body", tabindex: 0, role: "group", "aria-label": title }, ...content);
    this.origin = element("span", { class: "made", role: "status" });
    this.root.append(this.grip(), element("header", {}, element("h2", {}, title), this.origin, element("span", { class: "spacer" }), close), this.body);
    this.root.hidden = false;
  }

  /** Which design the result is of; `back(made)` shows that one again. */
  label(made, back) {
    if (this.root.hidden || !made) return;
    this.made = made;
    this.back = element("button", { class: "small", onclick: () => back(made) }, "Back to it");
    this.stale = null;
  }

  /** What became of the design: it is "present", has the gains of this result ("applied"), or has "changed". */
  outdated(state) {
    if (state === this.stale) return;
    this.stale = state;
    this.origin.textContent = "";
    this.origin.className = state === "changed" ? "made old" : "made";
    if (state === "present") this.origin.append("of the present design");
    else if (state === "applied") this.origin.append("its gains are in use ", this.back);
    else this.origin.append(`of the design as it was at ${this.made.at}: it has changed since `, this.back);
  }

  /** Something that is to be known beside the result. */
  remark(text) {
    this.body.prepend(element("p", { class: "remark", role: "alert" }, text));
  }

  /** Close it; whether it was open. */
  close() {
    const was = !this.root.hidden;
    this.leave?.();
    this.leave = null;
    this.title = null;
    this.made = null;
    this.root.hidden = true;
    this.root.textContent = "";
    return was;
  }

  /** The edge by which the drawer is made higher, by mouse and by keys. */
  grip() {
    const height = this.root.offsetHeight || USUAL;
    const grip = element("div", { class: "grip", role: "separator", tabindex: 0, "aria-orientation": "horizontal", "aria-label": "Height of the result", "aria-valuenow": height, "aria-valuemin": LEAST, "aria-valuemax": MOST });
    const set = (wanted) => {
      const value = Math.max(LEAST, Math.min(MOST, wanted));
      this.root.style.height = `${value}px`;
      grip.setAttribute("aria-valuenow", Math.round(value));
    };
    ownGesture(grip);
    grip.addEventListener("pointerdown", (event) => {
      grip.setPointerCapture(event.pointerId);
      const from = event.clientY, before = this.root.offsetHeight;
      const move = (drag) => set(before + from - drag.clientY);
      grip.addEventListener("pointermove", move);
      grip.addEventListener("pointerup", () => grip.removeEventListener("pointermove", move), { once: true });
    });
    grip.addEventListener("keydown", (event) => {
      const by = { ArrowUp: STEP, ArrowDown: -STEP }[event.key];
      if (by) {
        event.preventDefault();
        set(this.root.offsetHeight + by);
      }
    });
    return grip;
  }
}
