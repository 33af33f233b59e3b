// The design as a file: saved, unsaved, recent, downloaded, in a link, and over a reload of the page.
import { byId, element, write } from "./dom.js";
import { state } from "./state.js";

const KEPT = "certrack-design", RECENT = "certrack-recent", MOST_RECENT = 5, LINKED = /^#design=(.+)$/;

const encoded = (text) => btoa(String.fromCharCode(...new TextEncoder().encode(text))).replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
const decoded = (text) => new TextDecoder().decode(Uint8Array.from(atob(text.replaceAll("-", "+").replaceAll("_", "/")), (c) => c.charCodeAt(0)));

export const recent = () => JSON.parse(localStorage.getItem(RECENT) ?? "[]");

/** A file was opened or saved. */
export function remember(name) {
  localStorage.setItem(RECENT, JSON.stringify([name, ...recent().filter((file) => file !== name)].slice(0, MOST_RECENT)));
}

export class Files {
  /** `on`: send(message), values(), note(text). */
  constructor(on) {
    this.on = on;
    this.saving = "";
  }

  /** Whether the design is not what the file says; the server's text may be on its way. */
  get edited() {
    return Boolean(state.system) && (state.text !== state.saved || (state.text === state.base && Object.keys(this.on.values()).length > 0));
  }

  showEdited() {
    byId("edited").hidden = !this.edited;
  }

  /** Keep the design in the page, over a reload and a restart of the server. */
  keep() {
    if (!state.system) return;
    const { base, name, saved } = state;
    sessionStorage.setItem(KEPT, JSON.stringify({ base, name, saved, values: this.on.values() }));
  }

  kept() {
    const text = sessionStorage.getItem(KEPT);
    return text ? JSON.parse(text) : null;
  }

  save(name, overwrite = name === state.openedFile) {
    this.saving = state.text;
    this.on.send({ type: "save", name, text: state.text, overwrite });
  }

  saved(name) {
    Object.assign(state, { saved: this.saving, name, openedFile: name });
    write(byId("file-name"), name);
    remember(name);
    this.on.send({ type: "files" });
    this.on.note(`${name} saved`);
    this.showEdited();
    this.keep();
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

  /** The text that the address carries, which then no longer does; null if it carries none. */
  linked() {
    const code = LINKED.exec(location.hash)?.[1];
    if (!code) return null;
    history.replaceState(null, "", location.pathname + location.search);
    try {
      return decoded(code);
    } catch {
      this.on.note("The design in the address is damaged: copy the link again.");
      return null;
    }
  }

  async copyLink() {
    const hash = `#design=${encoded(state.text)}`;
    try {
      await navigator.clipboard.writeText(`${location.origin}/${hash}`);
      this.on.note("Link copied: it carries the whole design.");
    } catch {
      history.replaceState(null, "", hash);
      this.on.note("The address bar now carries the whole design.");
    }
  }
}
