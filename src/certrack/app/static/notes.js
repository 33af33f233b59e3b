// What the page says in a few words: a message for a while, and whether the server is there.
import { byId, style, write } from "./dom.js";

const NOTE_TIME = 6000;
let timer;

/** A message in the bottom bar. */
export function note(text) {
  const target = byId("note");
  write(target, text);
  target.title = text;
  clearTimeout(timer);
  timer = setTimeout(() => write(target, ""), NOTE_TIME);
}

/** The state of the connection, in the top bar. */
export function status(kind, text) {
  style(byId("link"), `link ${kind}`);
  write(byId("link").lastElementChild, text);
}
