// What opens below a button of the top bar: files, exports, keys. None of them blocks the page.
import { byId, element } from "./dom.js";

const EXPORTS = [["toml", "System file (TOML)"], ["certificate", "Certificate (JSON)"], ["report", "Report (HTML)"], ["report-pdf", "Report (PDF)"], ["report-md", "Tables for papers (Markdown)"], ["report-tex", "Tables for papers (LaTeX)"], ["c", "C code with its test (ZIP)"], ["st", "Structured Text"], ["fmu", "FMU 2.0"], ["netcdf", "Run (NetCDF)"], ["svg", "Picture (SVG)"], ["png", "Picture (PNG)"], ["pdf", "Picture (PDF)"]];
export const KEYS = [["F E M U O C", "falsify, ensemble, margins, tune, optimum, compare"], ["P T L", "pin, theme, lock the focused gain"], ["1 2 3", "axis of the error"], ["Ctrl+Z, Ctrl+Shift+Z", "undo, redo"], ["Ctrl+S, Ctrl+O, Ctrl+E", "save, open, export"], ["arrows, PgUp, PgDn", "on a slider: 1 %, 10 %; with Shift a tenth"], ["Home, End, Delete", "on a slider: ends of the range, baseline"], ["arrows, + −, Esc", "on a plot: cursor, zoom, whole run"], ["arrows, PgUp, Delete", "on the grip of a limit: move it, take it away"], ["Shift, drag", "on a slider: fine; on a plot: move the window"], ["?", "this list"]];
export const TRY = [["Move ", "a slider", " and watch the bound."], ["Press ", "F", " to search the worst case."], ["Open ", "File", " and raise gamma."]];

const VISITED = "certrack-visited";

let closeOpen = null, relist = null;

/** The folder has been looked through again: an open menu of files tells. */
export const listFiles = (greeting) => relist?.(greeting);

/** Close what is open; whether something was. */
export function closeMenu() {
  if (!closeOpen) return false;
  closeOpen();
  return true;
}

function below(button, label, ...content) {
  const again = button.getAttribute("aria-expanded") === "true";
  closeMenu();
  if (again) return null;
  const panel = element("div", { class: "menu", role: "dialog", "aria-label": label, tabindex: -1 }, ...content);
  const box = button.getBoundingClientRect();
  panel.style.top = `${box.bottom + 6}px`;
  if (box.left < innerWidth / 2) panel.style.left = `${Math.max(8, box.left)}px`;
  else panel.style.right = `${Math.max(8, innerWidth - box.right)}px`;
  document.body.append(panel);
  button.setAttribute("aria-expanded", "true");
  const outside = (event) => !panel.contains(event.target) && !button.contains(event.target) && closeMenu();
  document.addEventListener("pointerdown", outside);
  closeOpen = () => {
    closeOpen = null;
    document.removeEventListener("pointerdown", outside);
    panel.remove();
    button.setAttribute("aria-expanded", "false");
    button.focus();
  };
  panel.addEventListener("keydown", (event) => arrows(event, panel));
  (panel.querySelector("input, button") ?? panel).focus();
  return panel;
}

function arrows(event, panel) {
  const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (!by) return;
  const items = [...panel.querySelectorAll("button:not(:disabled)")], now = items.indexOf(document.activeElement);
  event.preventDefault();
  items.at((now + by) % items.length)?.focus();
}

/** Enter in a field does it; it must not press the button as well that has the focus afterwards. */
const onEnter = (field, work) => field.addEventListener("keydown", (event) => event.key === "Enter" && (event.preventDefault(), work()));

const item = (text, detail, work) => element("button", { class: "item", onclick: () => { closeMenu(); work(); } }, element("span", {}, text), detail ? element("small", {}, detail) : null);

/** Shipped systems and files; `on`: open(source, name), saveAs(name), upload(text, name), link(address), recent(). */
export function fileMenu(greeting, state, on) {
  const name = element("input", { "aria-label": "Name to save as", value: (state.name || "my-drive.toml").replace(/^.*\//, ""), autocomplete: "off", spellcheck: "false" });
  const save = () => { closeMenu(); on.saveAs(name.value); };
  onEnter(name, save);
  const pick = element("input", { type: "file", accept: ".toml,text/plain", class: "vh", tabindex: -1, "aria-hidden": "true" });
  pick.onchange = async () => pick.files[0] && (closeMenu(), on.upload(await pick.files[0].text(), pick.files[0].name));
  const linked = element("input", { "aria-label": "From a link", placeholder: "From a link: paste it here", autocomplete: "off", spellcheck: "false" });
  const follow = () => { closeMenu(); on.link(linked.value); };
  onEnter(linked, follow);
  const folder = element("div"), list = (names) => names.map((file) => item(file, "", () => on.open("file", file)));
  let shown;
  const fill = ({ files }) => {
    if (String(shown) === String(files)) return; // a press would miss
    shown = files;
    const recent = on.recent().filter((file) => files.includes(file));
    folder.replaceChildren(...(recent.length ? [element("h3", {}, "Recent")] : []), ...list(recent), element("h3", {}, "Files in this folder"), element("p", { class: "sub path" }, greeting.folder), ...(files.length ? list(files) : [element("p", { class: "sub" }, "none yet")]));
  };
  fill(greeting);
  relist = fill;
  below(
    byId("file"), "Files",
    state.system ? element("div", { class: "save" }, name, element("button", { onclick: save }, "Save")) : null,
    folder,
    item("From elsewhere on this computer …", "a copy of the text", () => pick.click()), pick,
    element("div", { class: "save" }, linked, element("button", { onclick: follow }, "Open")),
    item("Empty plant", "a commented file to begin with", () => on.open("empty", "")),
    element("h3", {}, "Shipped systems"), ...Object.entries(greeting.catalog).map(([key, title]) => item(key, title, () => on.open("catalog", key))),
  );
}

/** Formats; `on`: export(format), copyLink(). */
export function exportMenu(state, on) {
  below(byId("export"), "Export", ...EXPORTS.map(([format, text]) => item(text, state.system.drive || !["c", "st", "fmu"].includes(format) ? "" : "at 1 kHz: the file has no drive", () => on.export(format))), item("Link with the whole design", "to the clipboard", on.copyLink));
}

/** Keys and hints. */
export function helpMenu(on) {
  const keys = element("dl", { class: "keys" }, ...KEYS.flatMap(([key, what]) => [element("dt", {}, element("kbd", {}, key)), element("dd", {}, what)]));
  const single = element("input", { type: "checkbox", id: "single-keys", checked: on.singleKeys() });
  single.onchange = () => on.setSingleKeys(single.checked);
  below(byId("help"), "Keys and hints", element("h3", {}, "Three things to try"), tryList(), element("h3", {}, "Keys"), keys, element("label", { class: "inline" }, single, " keys of a single letter"));
}

export function tryList() {
  return element("ol", { class: "try" }, ...TRY.map(([before, what, after]) => element("li", {}, before, element("b", {}, what), after)));
}

/** Beside the gains until they were read once: what one may try first. */
export function firstVisit(box) {
  if (localStorage.getItem(VISITED)) return;
  const done = () => {
    localStorage.setItem(VISITED, "yes");
    box.hidden = true;
  };
  box.append(tryList(), element("button", { class: "small", onclick: done }, "Hide this"));
  box.hidden = false;
}

/** What a page shows that has nothing open. */
export function startPage(parent, greeting, open) {
  parent.textContent = "";
  const list = Object.entries(greeting.catalog).map(([name, title]) => element("li", {}, element("button", { class: "item", onclick: () => open("catalog", name) }, element("span", {}, name), element("small", {}, title))));
  const files = greeting.files.map((file) => element("li", {}, element("button", { class: "item", onclick: () => open("file", file) }, element("span", {}, file))));
  parent.append(
    element("div", { class: "start-side" }, element("h2", {}, "Begin with"), element("button", { class: "item strong", onclick: () => open("empty", "") }, element("span", {}, "Empty plant"), element("small", {}, "a commented drive of second order, to be replaced by yours: all keys at once under File, or one by one under System")), files.length ? element("h2", {}, "Files in this folder") : null, element("ul", {}, ...files), element("h2", {}, "Three things to try, once a system is open"), tryList()),
    element("div", {}, element("h2", {}, "Shipped systems"), element("ul", {}, ...list)),
  );
}

/** Another file lies where the design is to be saved; `on`: replace(), open(), other(). */
export function askConflict({ name, reason }, on) {
  closeMenu();
  const choice = (text, work, kind = null) => element("button", { class: kind, onclick: () => { closeMenu(); work(); } }, text);
  below(byId("file"), "Not saved", element("p", {}, `Not saved: ${name} ${reason}.`), element("div", { class: "actions" }, choice("Save under another name", on.other, "primary"), choice("Replace it", on.replace), choice("Open what is there", on.open)));
}

/** Ask about unsaved changes beside the file's name; `leave` goes on without saving. */
export function askUnsaved(name, leave, save) {
  closeMenu();
  below(byId("file"), "Unsaved changes", element("p", {}, `${name} has unsaved changes.`), element("div", { class: "actions" }, element("button", { class: "primary", onclick: () => { closeMenu(); save(); } }, "Save"), element("button", { onclick: () => { closeMenu(); leave(); } }, "Discard them"), element("button", { onclick: closeMenu }, "Stay")));
}
