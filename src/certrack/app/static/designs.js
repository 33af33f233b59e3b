// The design on the page: what the server says of a text, and what becomes of it here.
import { byId, write } from "./dom.js";
import { remember } from "./files.js";
import { startPage } from "./menus.js";
import { note } from "./notes.js";
import { nextDesign, state } from "./state.js";
import { select } from "./tabs.js";

const LINKED_NAME = "linked.toml";

export class Designs {
  /** `parts`: gains, editor, form, files, texts, opening, requests, responses, guarantee, history, tasks; snapshot(), outdate(), changed(), tabShown(name). */
  constructor(parts) {
    Object.assign(this, parts);
  }

  /** The connection is new: the server must hear of the design, then of what was on its way. */
  connected() {
    this.requests.forget();
    const { pending } = this.texts;
    if (state.system) this.again(pending && pending.restoring?.source !== "again" ? pending : null);
    else if (pending) this.texts.ask(pending.message, pending.restoring, pending.ancestor);
  }

  again(pending) {
    const then = pending && (() => this.texts.ask(pending.message, pending.restoring, pending.ancestor));
    const kept = this.snapshot();
    this.texts.ask({ type: "text", text: state.base, name: state.name }, { ...kept, source: "again", then });
    this.unknown = true;
  }

  greet(header) {
    const first = !state.greeting;
    state.greeting = header;
    if (!first || state.system || this.texts.pending) return;
    const { files, opening, texts } = this, linked = files.linked(), kept = files.kept();
    const follow = linked === null ? null : () => this.follow(linked);
    if (kept && (!follow || kept.edited)) {
      state.saved = kept.saved;
      const restoring = { ...kept, opening: true, before: null, keepSaved: true, then: follow };
      texts.ask({ type: "text", text: kept.base, name: kept.name }, restoring);
    } else if (follow) follow();
    else if (header.first) {
      const [source, ...name] = header.first.split(" ");
      opening.open(source, name.join(" "));
    } else {
      byId("start").hidden = false;
      startPage(byId("start"), header, (source, name) => opening.ask(() => opening.open(source, name)));
    }
  }

  /** The design of a link, unless the user wants to keep what is not saved. */
  follow(text) {
    if (text !== null) this.opening.ask(() => this.opening.text(text, LINKED_NAME));
  }

  /** An answer to a text: only that to the newest counts. */
  described(header, revision) {
    if (!this.texts.answered(revision)) return;
    this.opening.arrived();
    const was = state.restoring;
    state.restoring = null;
    if (!header.problem) {
      state.revision = revision;
      this.adopt(header, was);
      if (was?.then) was.then();
      else if (was?.source === "again" && this.editor.draft !== null) this.texts.text(this.editor.draft);
      return;
    }
    if (was?.source === "form") this.unfinished(header.text, was);
    if (was?.opening) this.refusedOpening(header);
    else this.marked(header.problem);
    if (this.unknown && was?.source !== "again" && state.system) this.again(null);
  }

  /** What was to be opened cannot be: all stays as it was. With nothing open, its text is shown to be mended. */
  refusedOpening({ problem, text, file }) {
    note(problem.message);
    if (state.system) {
      if (this.editor.draft !== null) this.texts.text(this.editor.draft);
      return;
    }
    Object.assign(state, { name: file?.name ?? "mended.toml", file, saved: file ? text : "" });
    this.editor.show(text);
    this.marked(problem);
    select("file", this.tabShown);
  }

  /** An edit of the form that is refused: the next one goes on from it. */
  unfinished(text, { sent, entries }) {
    if (text === sent) this.texts.entries = entries; // what was typed is no value at all
    else this.editor.draw(text, this.texts.ancestor);
  }

  /** Back to the last text that loads. */
  discard() {
    this.editor.show(state.text, this.gains.all());
    this.texts.text(state.text);
  }

  marked(problem) {
    state.textProblem = problem;
    this.editor.mark(problem);
    this.form.mark(problem);
    this.responses.undrag();
    this.guarantee.badge(state.system ? "text" : "waiting");
    this.files.showEdited();
    this.files.keep();
  }

  /** A text could not be read, or not be sent: the page stays as it is, and says so. */
  lost(message, revision) {
    if (!this.texts.answered(revision)) return;
    const was = state.restoring;
    state.restoring = null;
    this.opening.arrived();
    note(message);
    if (this.unknown && state.system && was?.source !== "again") this.again(null);
    else if (was?.opening && this.editor.draft !== null) this.texts.text(this.editor.draft);
  }

  /** A text that loads: the page shows it. */
  adopt(header, was) {
    const { gains, form, editor, files, guarantee, history, responses, texts } = this;
    const another = !state.system || Boolean(was?.opening), mine = gains.all();
    const draft = ["editor", "again"].includes(was?.source) && editor.draft !== header.text ? editor.draft : null;
    const structure = JSON.stringify([header.states, header.units, header.estimates]);
    const changed = structure !== state.structure;
    this.unknown = false;
    Object.assign(state, { structure, system: header, base: header.text, text: header.text, name: header.name, textProblem: null, worst: null, optima: null });
    document.body.classList.remove("empty");
    byId("start").hidden = true;
    write(byId("title"), header.title);
    document.title = `${header.name.replace(/\.toml$/, "")} · certrack`;
    const bases = another ? null : gains.bases();
    if (another) gains.same = null;
    gains.build(header);
    form.build(header);
    if (draft === null) editor.show(header.text, gains.all());
    editor.mark(null);
    form.mark(null);
    if (another) this.begin(header, was);
    else gains.rebase(bases);
    if (changed || another) {
      Object.assign(state, { run: null, bound: null, before: null });
      responses.build(header);
    }
    if (was?.values) {
      gains.set(header, was.values);
      if (was.before !== undefined) state.before = was.before ?? state.before;
    }
    const moved = another ? {} : texts.moved(header.gains, was?.values ?? {}, mine);
    if (Object.keys(moved).length) gains.set(header, { ...was?.values, ...moved });
    write(byId("file-name"), header.name);
    byId("file").title = `${state.greeting?.folder ?? ""}  Ctrl+O`;
    for (const id of ["pin", "export"]) byId(id).disabled = false;
    this.tasks.buttons();
    state.textOf = nextDesign();
    if (Object.keys(gains.values(header)).length) state.textOf = 0;
    this.outdate();
    this.requests.forget();
    this.requests.submit(true);
    if (was?.travelling || another) history.settle();
    else history.commit();
    if (was?.draft && another) this.drafted(was.draft);
    this.changed();
  }

  /** Another design: nothing of the one before is left. */
  begin(header, was) {
    const mended = was?.source === "editor"; // of a file that could not be opened as it was
    Object.assign(state, { before: null, pins: [], window: null, run: null, bound: null });
    if (was?.keepSaved) state.file = was.file ?? null;
    else if (!mended) Object.assign(state, { file: header.file, saved: header.text });
    document.querySelector(".right").scrollTop = 0;
    this.history.clear();
    this.guarantee.reset();
    if (header.file) remember(header.file.name);
  }

  /** What was typed before the page was loaded again. */
  drafted(text) {
    this.editor.area.value = text;
    this.texts.text(text);
  }

  /** The text with the present gains. */
  text(text, design) {
    if (design !== state.design) return;
    Object.assign(state, { text, textOf: design });
    if (this.editor.draft === null) this.editor.show(text, this.gains.all());
    this.changed();
    this.files.came();
  }
}
