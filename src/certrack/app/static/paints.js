// Behind ?measure: how long from an input event to the task after the frame that paints its answer.

export class Paints {
  constructor(enabled) {
    this.enabled = enabled;
    this.events = [];
    this.times = [];
    this.last = 0;
    this.channel = new MessageChannel();
    this.channel.port1.onmessage = () => this.painted();
  }

  /** An input event has become a design. */
  event(event, design) {
    if (this.enabled && event?.timeStamp) this.events.push([event.timeStamp, design]);
  }

  /** The answer to a design is being painted. */
  frame(design) {
    if (!this.enabled) return;
    this.design = design;
    this.channel.port2.postMessage(0);
  }

  painted() {
    const now = performance.now();
    this.decreased ||= this.design < this.last;
    this.last = this.design;
    this.events = this.events.filter(([at, design]) => design > this.design || !this.times.push(now - at));
  }
}
