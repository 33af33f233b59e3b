// The newest design on its way to the server: at most two runs at once, and the last is always sent.
import { state } from "./state.js";

const IN_FLIGHT = 2, LEAST_PIXELS = 200, MOST_PIXELS = 8000, MARGINS = 96;

export class Requests {
  /** `on`: send(message), values(), width(), law() whether the formulas are shown. */
  constructor(on) {
    this.on = on;
    this.flight = [];
    this.waiting = false;
    this.resting = false;
  }

  /** Send the newest design, or remember that it is to be sent. */
  submit(resting = false) {
    this.resting ||= resting;
    if (!state.system || !state.connected) return;
    if (this.flight.length >= IN_FLIGHT) {
      this.waiting = true;
      return;
    }
    this.waiting = false;
    const pixels = (this.on.width() - MARGINS) * Math.min(2, devicePixelRatio);
    this.flight.push([state.design, state.view]);
    this.on.send({ type: "set", revision: state.revision, design: state.design, view: state.view, gains: this.on.values(), window: state.window, pixels: Math.round(Math.min(MOST_PIXELS, Math.max(LEAST_PIXELS, pixels))), resting: this.resting, law: this.on.law() });
    this.resting = false;
  }

  /** An answer has come: it and all older ones are no longer on their way. */
  landed(design, view) {
    const at = this.flight.findLastIndex(([d, v]) => d === design && v === view);
    if (at >= 0) this.flight.splice(0, at + 1);
  }

  /** Send what had to wait. */
  goOn() {
    if (this.waiting) this.submit();
  }

  /** Another text, or a new connection: what was on its way is not answered any more. */
  forget() {
    this.flight.length = 0;
    this.waiting = false;
  }
}
