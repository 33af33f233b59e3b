// Behind ?measure: how long from an input event to the task after the frame that paints its answer.

/** The events that are not answered yet; the others leave their time. */
const waiting = (events, design, times, now) => events.filter(([at, of]) => of > design || !times.push(now - at));

export class Paints {
  constructor(enabled) {
    this.enabled = enabled;
    this.events = { run: [], bound: [] };
    this.times = []; // until the responses are painted
    this.withBound = []; // until the float bound is, too
    this.last = 0;
    this.channel = new MessageChannel();
    this.channel.port1.onmessage = () => this.painted();
  }

  /** An input event has become a design. */
  event(event, design) {
    if (!this.enabled || !event?.timeStamp) return;
    for (const events of Object.values(this.events)) events.push([event.timeStamp, design]);
  }

  /** The responses of a design are being painted, and the bound of one. */
  frame(run, bound) {
    if (!this.enabled) return;
    this.shown = { run, bound };
    this.channel.port2.postMessage(0);
  }

  painted() {
    const now = performance.now(), { run, bound } = this.shown;
    this.decreased ||= run < this.last;
    this.last = run;
    this.events.run = waiting(this.events.run, run, this.times, now);
    this.events.bound = waiting(this.events.bound, Math.min(run, bound), this.withBound, now);
  }
}
