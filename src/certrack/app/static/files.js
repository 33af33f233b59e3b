// The design as a file: saved, unsaved, recent, downloaded, in a link, and over a reload of the page.
import { byId, element, write } from "./dom.js";
import { state } from "./state.js";

const KEPT = "certrack-design", RECENT = "certrack-recent", MOST_RECENT = 5, LINKED = /^#design=(.+)$/;

const encoded = (text) => btoa(String.fromCharCode(...new TextEncoder().encode(text))).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
const decoded = (text) => new TextDecoder("utf-8", { fatal: true }).decode(Uint8Array.from(atob(text.replaceAll("-", "+").replaceAll("_", "/")), (c) => c.charCodeAt(0)));

export const recent = () => JSON.parse(localStorage.getItem(RECENT) ?? "[]");

/** A file was opened or saved. */
export function remember(name) {
  localStorage.setItem(RECENT, JSON.stringify([name, ...recent().filter((file) => file !== name)].slice(0, MOST_RECENT)));
}

const KEPT_LINK = "certrack-linked", LONGEST_LINK = 64_000;
const named = (name) => (name.endsWith(".toml") ? name : `${name}.toml`);

export class Files {
  /** `on`: send(message), values(), note(text), draft() of the editor, rest() asks for the newest text, conflict(change, choices). */
  constructor(on) {
    this.on = on;
    this.saving = [];
    this.late = null;
  }

  /** The text as the user sees it, errors included. */
  get text() {
    return this.on.draft() ?? state.text;
  }

  /** Whether the text does not have the present gains yet. */
  get lagging() {
    return this.on.draft() === null && state.connected && state.textOf !== state.design;
  }

  /** Whether the design is not what the file says; the server's text may be on its way. */
  get edited() {
    return Boolean(state.system) && (this.text !== state.saved || (state.text === state.base && Object.keys(this.on.values()).length > 0));
  }

  showEdited() {
    byId("edited").hidden = !this.edited;
  }

  /** Keep the design in the page, over a reload and a restart of the server. */
  keep() {
    if (!state.system) return;
    const { base, name, saved, file } = state;
    sessionStorage.setItem(KEPT, JSON.stringify({ base, name, saved, file, draft: this.on.draft(), edited: this.edited, values: this.on.values() }));
  }

  kept() {
    const text = sessionStorage.getItem(KEPT);
    return text ? JSON.parse(text) : null;
  }

  /** Save what is shown, over the file `known` or where there is none; then go on with `then`. */
  save(as, then = null, known = null) {
    const name = named(as);
    if (this.lagging) {
      this.late = () => this.save(name, then, known);
      this.on.rest();
      return;
    }
    const text = this.text;
    if (!this.on.send({ type: "save", name, text, known: known ?? (name === state.file?.name ? state.file.digest : "") })) return this.on.note("Not saved: the server is not there.");
    this.saving.push({ text, then });
  }

  /** The text with the newest gains has come. */
  came() {
    const { late } = this;
    this.late = null;
    late?.();
  }

  saved(name, digest) {
    const { text, then } = this.saving.shift() ?? {};
    Object.assign(state, { saved: text, name, file: { name, digest } });
    write(byId("file-name"), name);
    remember(name);
    this.on.send({ type: "files" });
    this.on.note(state.textProblem ? `${name} saved, with its error` : `${name} saved`);
    this.showEdited();
    this.keep();
    then?.();
  }

  /** There is another file on the disk than the page knows: the user chooses. */
  conflict(change) {
    const { then } = this.saving.shift() ?? {};
    this.on.conflict(change, { replace: () => this.save(change.name, then, change.digest) });
  }

  failed(message) {
    this.saving.shift();
    this.on.note(message);
  }

  download(name, data) {
    const address = URL.createObjectURL(new Blob([data]));
    const anchor = element("a", { href: address, download: name });
    document.body.append(anchor);
    anchor.click();
    anchor.remove();
    setTimeout(() => URL.revokeObjectURL(address), 10_000);
    this.on.note(`${name} exported`);
  }

  /** The text that the address carries, which then no longer does, or one that came before there was a key; null if none. */
  linked() {
    const code = LINKED.exec(location.hash)?.[1] ?? LINKED.exec(localStorage.getItem(KEPT_LINK) ?? "")?.[1];
    localStorage.removeItem(KEPT_LINK);
    if (!code) return null;
    if (location.hash) history.replaceState(null, "", location.pathname + location.search);
    return this.unpacked(code);
  }

  /** The text of a link; null, and a message, if it is damaged or too long. */
  unpacked(link) {
    const code = link.trim().replace(/^.*#design=/, ""), most = state.greeting?.most ?? Infinity;
    if (0.75 * code.length > most) this.on.note(`The design in this link has more than ${most / 1024} kB: open it as a file.`);
    else {
      try {
        return decoded(code);
      } catch {
        this.on.note("The design in this link is damaged: copy the link again.");
      }
    }
    return null;
  }

  async copyLink() {
    const hash = `#design=${encoded(this.text)}`;
    if (hash.length > LONGEST_LINK) return this.on.note(`Too long for a link (${Math.ceil(hash.length / 1024)} kB): export the system file.`);
    try {
      await navigator.clipboard.writeText(`${location.origin}/${hash}`);
      this.on.note("Link copied: it carries the whole design.");
    } catch {
      history.replaceState(null, "", hash);
      this.on.note("The address bar now carries the whole design.");
    }
    return null;
  }
}
