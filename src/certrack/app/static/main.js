// The page: one state, what changes it, and what is drawn of it once per frame.
import { byId, element, settled, style, write } from "./dom.js";
import { Editor } from "./editor.js";
import { Form } from "./form.js";
import { Gains } from "./gains.js";
import { Guarantee } from "./guarantee.js";
import { KIND, Link, sessionKey } from "./link.js";
import { askUnsaved, closeMenu, exportMenu, fileMenu, helpMenu, startPage } from "./menus.js";
import { Paints } from "./paints.js";
import { Responses } from "./responses.js";
import { Tasks } from "./tasks.js";

const MOST_UNDO = 200, IN_FLIGHT = 2, NOTE_TIME = 6000, REST = 120, LATE = 400, RIGHT_MARGIN = 96, COMPILING = "compiling …";

const state = {
  system: null, base: "", text: "", name: "", saved: "", design: 0, view: 0, window: null,
  run: null, bound: null, worst: null, before: null, pins: [], connected: false, textProblem: null,
  greeting: null,
};
const flight = [];
const history = { undo: [], redo: [], present: null };
const paints = new Paints(new URLSearchParams(location.search).has("measure"));
const nextDesign = () => (state.design += 1);
let waiting = false, restoring = null, asked = false, resting = false;

const gains = new Gains(byId("gains"), {
  moved: (event) => moved(event),
  commit: () => commit(),
  problem: (text) => note(text),
  step: (path, value) => edit(path, value),
});
const editor = new Editor({ text: sendText });
const form = new Form(byId("form"), { edit });
const responses = new Responses(byId("plots"), state, { zoom });
const guarantee = new Guarantee(state, {});
const tasks = new Tasks(state, {
  start: (task, options) => link.send({ type: "task", task, options, ...shown() }),
  cancel: () => link.send({ type: "cancel" }),
  apply: applyGains,
  restore: (pin) => travelTo(pin.snapshot),
  redraw: frame,
  note,
});
const link = new Link(sessionKey(), { open: opened, closed, frame: received });

// the connection

function opened() {
  state.connected = true;
  document.body.classList.remove("stale");
  status("ok", "connected");
  flight.length = 0;
  if (state.system) {
    restoring = snapshot();
    link.send({ type: "text", design: nextDesign(), text: state.base, name: state.name });
  }
}

function closed() {
  state.connected = false;
  document.body.classList.add("stale");
  status("bad", "reconnecting");
  if (tasks.running) tasks.stop();
  guarantee.badge("stale");
}

function status(kind, text) {
  style(byId("link"), `link ${kind}`);
  write(byId("link").lastElementChild, text);
}

function note(text) {
  const target = byId("note");
  write(target, text);
  target.title = text;
  clearTimeout(note.timer);
  note.timer = setTimeout(() => write(target, ""), NOTE_TIME);
}

function received(message) {
  const { kind, header, design } = message;
  if (kind === KIND.RUN) run(message);
  else if (kind === KIND.BOUND) estimate(header, design);
  else if (kind === KIND.EXACT) exact(header, design);
  else if (kind === KIND.TASK) tasks.frame(message);
  else if (kind === KIND.SYSTEM) described(header, design);
  else if (kind === KIND.TEXT) newText(header.text, design);
  else if (kind === KIND.FILE) download(header.name, message.data);
  else if (kind === KIND.NOTE) noted(header);
  else if (kind === KIND.PROBLEM) problem(header, message);
}

function noted(header) {
  if (header.hello) greet(header);
  else if (header.saved) savedAs(header.saved);
  else if (header.note && header.note !== "ready") note(header.note);
}

function greet(header) {
  const first = !state.greeting;
  state.greeting = header;
  if (!first || state.system) return;
  const kept = sessionStorage.getItem("certrack-design"), linked = /^#design=(.+)$/.exec(location.hash)?.[1];
  if (linked) {
    window.history.replaceState(null, "", location.pathname + location.search);
    openText(decoded(linked), "linked.toml");
  } else if (kept) {
    const { base, name, values, saved } = JSON.parse(kept);
    state.saved = saved;
    restoring = { base, name, values, before: null, keepSaved: true };
    link.send({ type: "text", design: nextDesign(), text: base, name });
  } else if (header.first) {
    const [source, ...name] = header.first.split(" ");
    open(source, name.join(" "));
  } else {
    byId("start").hidden = false;
    startPage(byId("start"), header, openAsked);
  }
}

function problem(header, { design, view }) {
  land(design, view);
  if (header.superseded) return;
  if (["task", "export"].includes(header.of)) tasks.stop();
  if (header.of === "bound" || header.of === "exact") {
    if (design !== state.design) return;
    state.bound = { bound: null, text: "none", reason: header.message, exact: header.of === "exact", premises: [], certificates: [] };
    frame();
    return;
  }
  if (header.message) note(header.message);
  if (waiting) submit();
}

// designs

function open(source, name) {
  status("ok", "connected");
  link.send({ type: "open", source, name, design: nextDesign() });
  restoring = { opening: true };
  state.openedFile = source === "file" ? name : "";
  clearTimeout(open.late);
  open.late = setTimeout(() => write(byId("note"), COMPILING), LATE);
}

function openAsked(source, name) {
  if (edited()) askUnsaved(state.name, () => open(source, name), () => save(state.name));
  else open(source, name);
}

function openText(text, name) {
  restoring = { opening: true };
  link.send({ type: "text", design: nextDesign(), text, name });
}

function sendText(text) {
  link.send({ type: "text", design: nextDesign(), text, name: state.name });
}

function edit(path, value) {
  link.send({ type: "edit", design: nextDesign(), text: state.text, name: state.name, entries: { [path]: value } });
}

function described(header, design) {
  if (design !== state.design) return;
  clearTimeout(open.late);
  if (byId("note").textContent === COMPILING) note("");
  const was = restoring;
  restoring = null;
  if (header.problem) {
    state.textProblem = header.problem;
    if (was?.opening || !state.system) {
      note(header.problem.message);
      if (!state.system) {
        editor.show(header.text);
        select("file");
      }
    }
    editor.mark(header.problem);
    form.mark(header.problem);
    guarantee.badge(state.system ? "text" : "waiting");
    return;
  }
  adopt(header, was);
}

/** A text that loads: the page shows it. */
function adopt(header, was) {
  const another = !state.system || was?.opening;
  const structure = JSON.stringify([header.states, header.units, header.estimates]);
  const changed = structure !== state.structure;
  state.structure = structure;
  Object.assign(state, { system: header, base: header.text, text: header.text, name: header.name, textProblem: null, worst: null });
  document.body.classList.remove("empty");
  byId("start").hidden = true;
  write(byId("title"), header.title);
  document.title = `${header.name.replace(/\.toml$/, "")} · certrack`;
  const bases = another ? null : gains.bases();
  gains.build(header);
  form.build(header.form);
  editor.show(header.text);
  editor.mark(null);
  form.mark(null);
  if (another) {
    Object.assign(state, { before: null, pins: [], window: null, run: null, bound: null });
    if (!was?.keepSaved) state.saved = header.text;
    Object.assign(history, { undo: [], redo: [] });
    guarantee.reset();
    if (state.openedFile) remember(state.openedFile);
  } else gains.rebase(bases);
  if (changed || another) {
    state.run = null;
    state.bound = null;
    state.before = null;
    responses.build(header);
  }
  if (was?.values) {
    gains.set(header, was.values);
    if (was.before !== undefined) state.before = was.before ?? state.before;
  }
  write(byId("file-name"), header.name);
  byId("file").title = `${state.greeting?.folder ?? ""}  Ctrl+O`;
  for (const id of ["pin", "export"]) byId(id).disabled = false;
  tasks.buttons();
  resting = true;
  outdate();
  submit();
  if (was?.travelling || another) history.present = snapshot();
  else commit();
  keep();
}

/** The text with the present gains, from the server. */
function newText(text, design) {
  if (design !== state.design || state.textProblem) return;
  state.text = text;
  if (document.activeElement !== editor.area) editor.show(text);
  showEdited();
  keep();
}

const shown = () => ({ design: state.design, gains: gains.values(state.system) });

/** Nothing that was proven is of the new design. */
function outdate() {
  if (state.bound) state.bound = { ...state.bound, exact: false, contradicted: [] };
  frame();
}

function moved(event) {
  nextDesign();
  outdate();
  paints.event(event, state.design);
  state.lastMove = performance.now();
  showEdited();
  submit();
  rest();
}

const rest = settled(() => {
  resting = true;
  submit();
}, REST);

/** Send the newest design; at most two runs are on their way. */
function submit() {
  if (!state.system || !state.connected) return;
  if (flight.length >= IN_FLIGHT) {
    waiting = true;
    return;
  }
  waiting = false;
  const pixels = Math.round(Math.min(8000, Math.max(200, (byId("plots").clientWidth - RIGHT_MARGIN) * Math.min(2, devicePixelRatio))));
  flight.push([state.design, state.view]);
  link.send({ type: "set", design: state.design, view: state.view, gains: gains.values(state.system), window: state.window, pixels, resting });
  resting = false;
}

/** An answer has come: it and all older ones are no longer on their way. */
function land(design, view) {
  const at = flight.findIndex(([d, v]) => d === design && v === view);
  if (at >= 0) flight.splice(0, at + 1);
}

function run({ header, rows, design, view }) {
  land(design, view);
  const newest = state.run;
  const older = newest && (design < newest.design || (design === newest.design && view < newest.view));
  const coarser = newest && design === newest.design && view === newest.view && newest.header.sampled && !header.sampled;
  if (!older && !coarser && rows[0].length) {
    const times = Float64Array.from(rows[0], (t) => t + header.t0);
    state.run = { header, rows, times, design, view };
    const { before } = state;
    if (before && !before.byUser && before.design === design && header.sampled && !before.run.header.sampled) pinned(false);
    frame();
  }
  if (waiting) submit();
}

function estimate(header, design) {
  if (state.bound?.exact && state.bound.design >= design) return;
  state.bound = { ...header, design, exact: false };
  state.boundTime = header.ms;
  frame();
}

function exact(header, design) {
  if (design !== state.design) return;
  state.bound = { ...header, design, exact: true, refining: header.effort === "fast" };
  if (!header.shares.length && state.shares?.design === design) state.bound.shares = state.shares.of;
  state.exactTime = header.ms;
  state.exactDelay = performance.now() - (state.lastMove ?? 0);
  guarantee.proven(header, state.system);
  if (state.before && !state.before.bound && state.before.design === design) state.before.bound = state.bound;
  write(byId("announce"), header.bound ? `Certified bound ${header.text} ${state.system.units[0]}, exact` : header.reason);
  if (state.run) responses.describe(state.system, state.run, state.bound);
  frame();
}

function zoom(low, high = null) {
  const { duration } = state.system;
  if (low === null) state.window = null;
  else {
    const from = Math.max(0, low), to = Math.min(duration, high);
    if (to - from < duration * 1e-6) return;
    state.window = from <= 0 && to >= duration ? null : [from, to];
  }
  state.view = (state.view + 1) % 65536;
  submit();
}

// painting, once per frame

function frame() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    draw();
    if (state.run) paints.frame(state.run.design);
  });
}

function draw() {
  if (!state.system || !state.run) return;
  if (!state.before) pinned(false);
  responses.draw();
  guarantee.draw();
  if (state.bound?.shares?.length) guarantee.budget(state.bound.shares);
  else guarantee.budget([]);
  const { header } = state.run, parts = [`run ${header.ms.toFixed(1)} ms`];
  if (state.boundTime !== undefined) parts.push(`bound ${Math.round(state.boundTime)} ms`);
  if (state.exactTime !== undefined) parts.push(`exact ${Math.round(state.exactTime)} ms`);
  write(byId("cost"), [...parts, `${header.steps} steps`].join(" · "));
  if (header.outcome !== "finished") write(byId("note"), `stopped at t = ${header.end.toPrecision(4)} s: ${header.message}`);
}

// undo and redo, pins

const snapshot = () => ({ base: state.base, name: state.name, values: state.system ? gains.values(state.system) : {}, before: state.before, bases: gains.bases() });
const same = (a, b) => a && b && a.base === b.base && a.before === b.before && JSON.stringify(a.values) === JSON.stringify(b.values);

function commit() {
  const now = snapshot();
  if (same(now, history.present)) return;
  if (history.present) history.undo.push(history.present);
  if (history.undo.length > MOST_UNDO) history.undo.shift();
  Object.assign(history, { redo: [], present: now });
  showHistory();
  keep();
}

function showHistory() {
  byId("undo").disabled = !history.undo.length;
  byId("redo").disabled = !history.redo.length;
  showEdited();
}

function travel(from, to) {
  if (!from.length) return;
  to.push(history.present);
  travelTo(from.pop(), true);
}

function travelTo(target, travelling = false) {
  state.before = target.before;
  if (target.base === state.base) {
    gains.set(state.system, target.values);
    gains.rebase(target.bases);
    nextDesign();
    outdate();
    resting = true;
    submit();
    if (travelling) history.present = target;
    else commit();
  } else {
    restoring = { ...target, travelling };
    link.send({ type: "text", design: nextDesign(), text: target.base, name: target.name });
    if (travelling) history.present = target;
  }
  showHistory();
}

function applyGains(values) {
  const known = Object.fromEntries(Object.entries(values).filter(([path]) => gains.sliders.has(path)));
  gains.set(state.system, known, { keepLocked: true });
  moved(null);
  commit();
}

function pinned(byUser) {
  const { run: now, bound, system } = state, n = system.states.length;
  if (!now) return;
  state.before = { run: now, design: now.design, t: now.times, e: now.rows[1 + n], u: now.rows[3 + n], bound: bound?.exact ? bound : null, byUser };
  if (!byUser) {
    history.present = snapshot();
    return;
  }
  gains.rebase();
  state.pins.push({ name: `pin ${state.pins.length + 1}`, run: now, bound: state.before.bound, snapshot: snapshot() });
  commit();
  frame();
}

// files

const edited = () => Boolean(state.system) && (state.text !== state.saved || Object.keys(gains.values(state.system)).length > 0 && state.text === state.base);

function showEdited() {
  byId("edited").hidden = !edited();
}

function keep() {
  if (!state.system) return;
  const { base, name, values } = snapshot();
  sessionStorage.setItem("certrack-design", JSON.stringify({ base, name, values, saved: state.saved }));
}

function save(name, overwrite = name === state.openedFile) {
  state.saving = state.text;
  link.send({ type: "save", name, text: state.text, overwrite });
}

function savedAs(name) {
  state.saved = state.saving;
  state.name = name;
  state.openedFile = name;
  write(byId("file-name"), name);
  remember(name);
  link.send({ type: "files" });
  note(`${name} saved`);
  showEdited();
  keep();
}

const recent = () => JSON.parse(localStorage.getItem("certrack-recent") ?? "[]");
const remember = (name) => localStorage.setItem("certrack-recent", JSON.stringify([name, ...recent().filter((file) => file !== name)].slice(0, 5)));

function download(name, data) {
  tasks.stop();
  const address = URL.createObjectURL(new Blob([data]));
  const anchor = element("a", { href: address, download: name });
  document.body.append(anchor);
  anchor.click();
  anchor.remove();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
  note(`${name} exported`);
}

const encoded = (text) => btoa(String.fromCharCode(...new TextEncoder().encode(text))).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
const decoded = (text) => new TextDecoder().decode(Uint8Array.from(atob(text.replaceAll("-", "+").replaceAll("_", "/")), (c) => c.charCodeAt(0)));

async function copyLink() {
  const address = `${location.origin}/#design=${encoded(state.text)}`;
  try {
    await navigator.clipboard.writeText(address);
    note("Link copied: it carries the whole design.");
  } catch {
    window.history.replaceState(null, "", `#design=${encoded(state.text)}`);
    note("The address bar now carries the whole design.");
  }
}

// tabs, theme, keys

function select(name) {
  for (const tab of document.querySelectorAll("[role=tab]")) {
    const chosen = tab.id === `tab-${name}`;
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
    byId(tab.getAttribute("aria-controls")).hidden = !chosen;
  }
  if (name === "file") editor.number();
}

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  localStorage.setItem("certrack-theme", theme);
  responses.recolor();
  tasks.fan?.build();
}

const singleKeys = () => localStorage.getItem("certrack-single-keys") !== "off";
const actions = {
  file: () => state.greeting && fileMenu(state.greeting, state, { open: openAsked, saveAs: (name) => save(name), upload: openText, recent }),
  export: () => exportMenu(state, { export: exportAs, copyLink }),
  help: () => helpMenu({ singleKeys, setSingleKeys: (on) => localStorage.setItem("certrack-single-keys", on ? "on" : "off") }),
  undo: () => travel(history.undo, history.redo),
  redo: () => travel(history.redo, history.undo),
  pin: () => pinned(true),
  theme: () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"),
};

function exportAs(format) {
  if (tasks.running) return note("One long computation at a time: wait for it or cancel it.");
  link.send({ type: "export", format, ...shown() });
  return tasks.begin("export");
}

for (const [id, work] of Object.entries(actions)) byId(id).onclick = work;
for (const tab of document.querySelectorAll("[role=tab]")) {
  tab.onclick = () => select(tab.id.replace("tab-", ""));
  tab.onkeydown = (event) => {
    const tabs = [...document.querySelectorAll("[role=tab]")], by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!by) return;
    const next = tabs.at((tabs.indexOf(tab) + by) % tabs.length);
    next.click();
    next.focus();
  };
}

const LETTERS = { f: "falsify", e: "ensemble", m: "margins", u: "tune", c: "compare" };
addEventListener("keydown", (event) => {
  const key = event.key.toLowerCase(), inField = /INPUT|TEXTAREA|SELECT/.test(document.activeElement?.tagName);
  if (event.ctrlKey || event.metaKey) {
    const work = { s: () => (state.system ? save(state.name) : null), o: actions.file, e: () => byId("export").disabled || actions.export(), z: inField ? null : event.shiftKey ? actions.redo : actions.undo }[key];
    if (work) {
      event.preventDefault();
      work();
    }
    return;
  }
  if (key === "escape") {
    if (!closeMenu() && !tasks.close() && state.window) zoom(null);
    return;
  }
  if (inField || event.altKey || !singleKeys()) return;
  if (LETTERS[key]) tasks.press(LETTERS[key]);
  else if (key === "p" && state.run) pinned(true);
  else if (key === "t") actions.theme();
  else if (key === "l") gains.lockFocused();
  else if ("123".includes(key) && responses.error) responses.error.setMode(["log", "sym", "zoom"][Number(key) - 1]);
  else if (key === "?") actions.help();
});

const resized = settled(() => state.system && zoomSame(), 200);
function zoomSame() {
  state.view = (state.view + 1) % 65536;
  submit();
}
addEventListener("resize", resized);

document.documentElement.dataset.theme = localStorage.getItem("certrack-theme") ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
document.fonts?.ready.then(() => responses.plots.forEach((plot) => plot.plot.redraw(false)));
window.lab = { state, paints, gains, history, flight, responses };
