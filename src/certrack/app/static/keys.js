// Keys of the whole page. Single letters work outside of fields only, and can be switched off.

const LETTERS = { f: "falsify", e: "ensemble", m: "margins", u: "tune", o: "optimum", c: "compare" };
const SINGLE = "certrack-single-keys", MODES = ["log", "sym", "zoom"];

export const singleKeys = () => localStorage.getItem(SINGLE) !== "off";
export const setSingleKeys = (on) => localStorage.setItem(SINGLE, on ? "on" : "off");

/** `on`: save, file, export, undo, redo, escape, task(name), pin, theme, lock, mode(name), help. */
export function bindKeys(on) {
  addEventListener("keydown", (event) => {
    const key = event.key.toLowerCase(), inField = /INPUT|TEXTAREA|SELECT/.test(document.activeElement?.tagName);
    if (event.ctrlKey || event.metaKey) {
      const work = { s: on.save, o: on.file, e: on.export, z: inField ? null : event.shiftKey ? on.redo : on.undo }[key];
      if (work) {
        event.preventDefault();
        work();
      }
      return;
    }
    if (key === "escape") on.escape();
    else if (inField || event.altKey || !singleKeys()) return;
    else if (LETTERS[key]) on.task(LETTERS[key]);
    else if ("123".includes(key)) on.mode(MODES[Number(key) - 1]);
    else ({ p: on.pin, t: on.theme, l: on.lock, "?": on.help })[key]?.();
  });
}
