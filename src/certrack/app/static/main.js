// The page: what changes the design, and what is drawn of it once per frame.
import { Designs } from "./designs.js";
import { byId, settled, spaced, write } from "./dom.js";
import { Editor } from "./editor.js";
import { Files, recent } from "./files.js";
import { Form } from "./form.js";
import { Gains } from "./gains.js";
import { Guarantee } from "./guarantee.js";
import { History } from "./history.js";
import { bindKeys, setSingleKeys, singleKeys } from "./keys.js";
import { showLaw } from "./law.js";
import { KIND, Link, sessionKey } from "./link.js";
import { askConflict, closeMenu, exportMenu, fileMenu, firstVisit, helpMenu, listFiles } from "./menus.js";
import { keepNote, note, status } from "./notes.js";
import { hasBound } from "./numbers.js";
import { Opening } from "./opening.js";
import { Paints } from "./paints.js";
import { Requests } from "./requests.js";
import { Responses } from "./responses.js";
import { nextDesign, nextView, state } from "./state.js";
import { bindTabs } from "./tabs.js";
import { Tasks } from "./tasks.js";
import { Texts } from "./texts.js";
import { beginTheme, switchTheme } from "./theme.js";
import { Together } from "./together.js";

const REST = 120, RESIZED = 200, READABLE = 100;

const paints = new Paints(new URLSearchParams(location.search).has("measure"));
const together = new Together(frame);
let asked = false, plotsWidth = 0;

beginTheme();
const send = (message) => link.send(message);
const values = () => (state.system ? gains.values(state.system) : {});
const gains = new Gains(byId("gains"), {
  moved: (event) => moved(event),
  commit: () => history.commit(),
  problem: (text) => note(text),
  step: (path, value) => edit(path, value),
});
const requests = new Requests({ send, values, width: () => (plotsWidth ||= byId("plots").clientWidth || responses.plots[0]?.box.clientWidth || 0), // a narrow page has the plots without their box
  law: () => byId("law-card").open });
const history = new History({ snapshot, show: (target) => travelTo(target, true), changed: showHistory });
const texts = new Texts({ send, values, all: () => gains.all(), editor: () => editor });
const edit = (path, value) => texts.edit(path, value);
const files = new Files({ send, values, note, draft: () => editor.draft, rest: () => requests.submit(true), conflict });
const opening = new Opening({ ask: (message, restoring) => texts.ask(message, restoring) }, files);
const openAsked = (source, name) => opening.ask(() => opening.open(source, name));
const editor = new Editor({ text: (text) => texts.text(text), typed: () => files.showEdited() });
const form = new Form(byId("form"), { edit, discard: () => designs.discard() });
const responses = new Responses(byId("plots"), state, { zoom, edit, limit: (name, value) => tasks.tuning.limit(name, value) });
const guarantee = new Guarantee(state, { edit });
const tasks = new Tasks(state, {
  start: (task, options) => send({ type: "task", task, options, ...shown() }),
  snapshot,
  goBack: (made) => travelTo(made),
  cancel: () => send({ type: "cancel" }),
  apply: applyGains,
  restore: (pin) => travelTo(pin.snapshot),
  edit,
  behind: (pin) => {
    state.before = pin.before;
    history.commit();
    frame();
  },
  openText: (text, name) => opening.ask(() => opening.text(text, name)),
  download: (name, text) => files.download(name, text),
  redraw: () => (responses.redraw(), frame()),
  note,
});
const designs = new Designs({ gains, editor, form, files, texts, opening, requests, responses, guarantee, history, tasks, snapshot, outdate, changed: showHistory, tabShown });
const link = new Link(sessionKey(), { open: opened, closed, frame: received });

// the connection

function opened() {
  state.connected = true;
  document.body.classList.remove("stale");
  status("ok", "connected");
  designs.connected();
}

function closed() {
  state.connected = false;
  document.body.classList.add("stale");
  status("bad", "reconnecting");
  if (tasks.running) tasks.stop();
  guarantee.badge("stale");
}

function received(message) {
  const { kind, header, design, revision } = message;
  if (kind === KIND.SYSTEM) designs.described(header, revision);
  else if (kind === KIND.TASK) tasks.frame(message);
  else if (kind === KIND.FILE) {
    tasks.stop();
    files.download(header.name, message.data);
  }
  else if (kind === KIND.NOTE) noted(header);
  else if (kind === KIND.PROBLEM) problem(header, message);
  else if (revision !== state.revision) return; // of another text
  else if (kind === KIND.RUN) run(message);
  else if (kind === KIND.BOUND) estimate(header, design);
  else if (kind === KIND.EXACT) exact(header, design);
  else if (kind === KIND.TEXT) designs.text(header.text, design);
  else if (kind === KIND.LAW && design === state.design) showLaw(header);
}

function noted(header) {
  if (header.hello) {
    designs.greet(header);
    listFiles(header);
  }
  else if (header.saved) files.saved(header.saved, header.digest);
  else if (header.conflict) files.conflict(header.conflict);
  else if (header.note && header.note !== "ready") note(header.note);
}

function problem(header, { design, view, revision }) {
  const { of: what, message } = header;
  if (["open", "text", "edit"].includes(what)) return designs.lost(message, revision);
  if (what === "save") return files.failed(message);
  if (["task", "export"].includes(what)) {
    tasks.failed(message);
    return note(message);
  }
  if (revision && revision !== state.revision) return null;
  if (["run", "set"].includes(what)) requests.landed(design, view);
  if (what === "run" && !header.superseded) {
    state.failed = design;
    frame();
  }
  if (["bound", "exact"].includes(what)) return unproven(header, design);
  if (message) note(message);
  return requests.goOn();
}

/** No bound: what is proven already stays, with the reason why there is nothing finer. */
function unproven({ of: what, message, effort, superseded }, design) {
  if (what === "bound") together.answered(design);
  if (superseded || design !== state.design) return;
  const { bound } = state, proven = bound?.exact && bound.design === design;
  if (proven && (what === "bound" || effort !== "fast")) {
    if (what === "exact") state.bound = { ...bound, refining: false, unrefined: message };
  } else state.bound = { bound: null, text: "none", reason: message, design, exact: what === "exact", premises: [], certificates: [] };
  together.now();
}

/** The user chooses what becomes of another file where the design was to be saved. */
function conflict(change, on) {
  askConflict(change, { ...on, open: () => opening.open("file", change.name), other: () => actions.file() });
}

const shown = () => ({ design: state.design, revision: state.revision, gains: values() });

/** Nothing that was proven is of the new design. */
function outdate() {
  const { bound } = state;
  if (bound?.exact || bound?.contradicted?.length) state.bound = { ...bound, exact: false, contradicted: [] }; // else what it shows stays drawn
  frame();
}

function moved(event) {
  nextDesign();
  outdate();
  paints.event(event, state.design);
  state.lastMove = performance.now();
  files.showEdited();
  requests.submit();
  rest();
}

const rest = settled(() => requests.submit(true), REST);

function run({ header, rows, design, view }) {
  requests.landed(design, view);
  const newest = state.run;
  const older = newest && (design < newest.design || (design === newest.design && view < newest.view));
  const coarser = newest && design === newest.design && view === newest.view && newest.header.sampled && !header.sampled;
  if (!older && !coarser && rows[0].length) {
    const times = Float64Array.from(rows[0], (t) => t + header.t0);
    state.run = { header, rows, times, design, view };
    const { before } = state;
    if (before && !before.byUser && before.design === design && header.sampled && !before.run.header.sampled) pinned(false);
    together.run(design, (state.bound?.design ?? 0) >= design);
  }
  requests.goOn();
}

function estimate(header, design) {
  if (state.bound?.exact && state.bound.design >= design) return; // proven already
  const { shares = [], shares_of, shares_nominal } = state.bound ?? {}; // of the design before, until the proof tells
  const causes = header.shares.length ? {} : { shares, shares_of, shares_nominal, sharesBefore: true };
  state.bound = { ...header, ...causes, design, exact: false };
  state.boundTime = header.ms;
  together.bound(design);
}

function exact(header, design) {
  if (design !== state.design) return;
  state.bound = { ...header, design, exact: true, refining: header.effort === "fast" };
  state.exactTime = header.ms;
  state.exactDelay = performance.now() - (state.lastMove ?? 0);
  guarantee.proven(header, state.system);
  if (header.effort === "fast") state.fast = state.bound;
  if (state.before?.design === design) Object.assign(state.before, { bound: state.bound, fast: fastOf(design) });
  write(byId("announce"), header.contradicted.length ? "A premise is contradicted: no certified bound" : hasBound(header) ? `Certified bound ${header.text} ${state.system.units[0]}, exact` : header.reason);
  if (state.run) responses.describe(state.system, state.run, state.bound);
  together.now();
}

function zoom(low, high = null) {
  const { duration } = state.system;
  if (low === null) state.window = null;
  else {
    const from = Math.max(0, low), to = Math.min(duration, high);
    if (to - from < duration * 1e-6) return;
    state.window = from <= 0 && to >= duration ? null : [from, to];
  }
  nextView();
  requests.submit();
}

// painting, once per frame

function frame() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    draw();
    if (state.run) paints.frame(state.run.design, state.bound?.design ?? 0);
  });
}

function draw() {
  if (!state.system) return;
  if (!state.before) pinned(false);
  responses.draw();
  guarantee.draw();
  tasks.freshen();
  showTables(state.bound?.exact);
}

/** Numbers that change faster than they are read cost a layout of the page each time. */
const showTables = spaced(tables, READABLE);

function tables() {
  if (!state.system) return;
  guarantee.tables();
  const header = state.run?.header;
  keepNote(header && header.outcome !== "finished" ? `stopped at t = ${header.end.toPrecision(4)} s: ${header.message}` : "");
  if (!header) return write(byId("cost"), "");
  const parts = [`run ${header.ms.toFixed(1)} ms`];
  if (state.boundTime !== undefined) parts.push(`bound ${Math.round(state.boundTime)} ms`);
  if (state.exactTime !== undefined) parts.push(`exact ${Math.round(state.exactTime)} ms`);
  return write(byId("cost"), [...parts, `${header.steps} steps`].join(" · "));
}

// undo and redo, pins

function snapshot() {
  const { base, name, before } = state;
  return { base, name, before, values: values(), bases: gains.bases() };
}

function showHistory() {
  byId("undo").disabled = !history.undo.length;
  byId("redo").disabled = !history.redo.length;
  files.showEdited();
  files.keep();
}

/** Show what a snapshot has; a step of the history, or a change like any other. */
function travelTo(target, travelling = false) {
  state.before = target.before;
  if (target.base === state.base) {
    gains.set(state.system, target.values);
    gains.rebase(target.bases);
    nextDesign();
    outdate();
    requests.submit(true);
    if (!travelling) history.commit();
  } else {
    texts.ask({ type: "text", text: target.base, name: target.name }, { ...target, travelling });
  }
}

function applyGains(values) {
  const known = Object.fromEntries(Object.entries(values).filter(([path]) => gains.sliders.has(path)));
  gains.set(state.system, known, { keepLocked: true });
  moved(null);
  history.commit();
}

/** What the fast proof had of a design, by the same method as an estimate. */
const fastOf = (design) => (state.fast?.design === design ? state.fast : null);

function pinned(byUser) {
  const { run: now, bound, system } = state, n = system.states.length;
  if (!now) return;
  state.before = { run: now, design: now.design, t: now.times, e: now.rows[1 + n], u: now.rows[3 + n], bound: bound?.exact ? bound : null, fast: fastOf(now.design), byUser };
  if (!byUser) {
    history.settle();
    return;
  }
  gains.rebase();
  state.pins.push({ name: `pin ${state.pins.length + 1}`, run: now, before: state.before, snapshot: snapshot() });
  history.commit();
  frame();
}

// buttons and keys

function tabShown(name) {
  if (name === "file") editor.number();
}

function exportAs(format) {
  if (tasks.running) return note("One long computation at a time: wait for it or cancel it.");
  send({ type: "export", format, ...shown() });
  return tasks.begin("export");
}

const actions = {
  file: () => {
    if (!state.greeting) return;
    send({ type: "files" }); // others may have come
    fileMenu(state.greeting, state, { open: openAsked, saveAs: (name) => files.save(name), upload: (text, name) => opening.ask(() => opening.text(text, name)), link: (address) => designs.follow(files.unpacked(address)), recent });
  },
  export: () => state.system && exportMenu(state, { export: exportAs, copyLink: () => files.copyLink() }),
  help: () => helpMenu({ singleKeys, setSingleKeys }),
  undo: () => history.back(),
  redo: () => history.forth(),
  pin: () => state.run && pinned(true),
  theme: () => {
    switchTheme();
    responses.recolor();
    tasks.recolor();
  },
};
for (const [id, work] of Object.entries(actions)) byId(id).onclick = work;
bindTabs(tabShown);
firstVisit(byId("first"));
bindKeys({
  ...actions,
  save: () => state.system && files.save(state.name),
  escape: () => closeMenu() || tasks.close() || (state.window && zoom(null)),
  task: (name) => tasks.press(name),
  lock: () => gains.lockFocused(),
  mode: (name) => responses.error?.setMode(name),
});

byId("law-card").addEventListener("toggle", ({ target }) => {
  byId("law").textContent = ""; // of an older design: nobody asked for it while the card was folded
  if (target.open) requests.submit(true);
});

addEventListener("resize", settled(() => {
  plotsWidth = 0;
  nextView();
  requests.submit();
}, RESIZED));

new ResizeObserver(() => (plotsWidth = 0)).observe(byId("plots")); // to ask for it at each move would lay out the page in between

addEventListener("hashchange", () => state.greeting && designs.follow(files.linked()));
document.fonts?.ready.then(() => responses.plots.forEach((plot) => plot.plot.redraw(false)));
window.lab = { state, texts, tasks, received, paints, gains, history, flight: requests.flight, responses };
