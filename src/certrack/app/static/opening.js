// Another design: a shipped one, a file, or a text; unsaved changes are asked about first.
import { byId, write } from "./dom.js";
import { askUnsaved } from "./menus.js";
import { note, status } from "./notes.js";
import { state } from "./state.js";

const LATE = 400, COMPILING = "compiling …";

export class Opening {
  /** `on`: ask(message, restoring) of the texts; `files` tells what is unsaved. */
  constructor(on, files) {
    this.on = on;
    this.files = files;
    this.late = 0;
  }

  /** Ask about unsaved changes, then go on. */
  ask(work) {
    if (this.files.edited) askUnsaved(state.name, work, () => this.files.save(state.name, work));
    else work();
  }

  open(source, name) {
    status("ok", "connected");
    this.on.ask({ type: "open", source, name }, { opening: true });
    clearTimeout(this.late);
    this.late = setTimeout(() => write(byId("note"), COMPILING), LATE);
  }

  text(text, name) {
    this.on.ask({ type: "text", text, name }, { opening: true });
  }

  /** The server knows the design now. */
  arrived() {
    clearTimeout(this.late);
    if (byId("note").textContent === COMPILING) note("");
  }
}
