// What the page says in a few words: a message for a while, and whether the server is there.
import { byId, style, write } from "./dom.js";

const NOTE_TIME = 6000;
let timer, kept = "";

function show(text) {
  const target = byId("note");
  write(target, text);
  target.title = text;
}

/** A message in the bottom bar. */
export function note(text) {
  show(text);
  clearTimeout(timer);
  timer = setTimeout(() => show(kept), NOTE_TIME);
}

/** What stands there between messages, as long as it is true. */
export function keepNote(text) {
  if (text === kept) return;
  if (text || byId("note").textContent === kept) show(text);
  kept = text;
}

/** The state of the connection, in the top bar. */
export function status(kind, text) {
  style(byId("link"), `link ${kind}`);
  write(byId("link").lastElementChild, text);
}
