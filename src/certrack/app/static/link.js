// The connection: frames in, messages out; it comes back by itself.

export const KIND = { RUN: 1, BOUND: 2, EXACT: 3, TASK: 4, PROBLEM: 5, SYSTEM: 6, TEXT: 7, FILE: 8, NOTE: 9, LAW: 10 };
const MAGIC = 0x31525443, PROTOCOL = 2, PREFIX = 20, FIRST_WAIT = 250, LONGEST_WAIT = 4000;

/** The key of this session: from the address, which then hides it, or from before; a link opened in another tab finds it. */
export function sessionKey() {
  const key = new URLSearchParams(location.search).get("t");
  if (key) {
    sessionStorage.setItem("certrack-key", key);
    localStorage.setItem("certrack-key", key);
    const query = new URLSearchParams(location.search);
    query.delete("t");
    history.replaceState(null, "", `/${query.size ? `?${query}` : ""}${location.hash}`);
  }
  return key ?? sessionStorage.getItem("certrack-key") ?? "";
}

/** Kind, counters, header, curves and file of a frame; curves are views, not copies. */
export function readFrame(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < PREFIX || view.getUint32(0, true) !== MAGIC) return null;
  const length = view.getUint32(12, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, PREFIX, length)));
  let at = PREFIX + length;
  const rows = (header.lengths ?? []).map((count) => {
    const row = new Float32Array(buffer, at, count);
    at += 4 * count;
    return row;
  });
  const data = header.bytes ? new Uint8Array(buffer, at, header.bytes) : null;
  return { kind: view.getUint16(4, true), view: view.getUint16(6, true), design: view.getUint32(8, true), revision: view.getUint32(16, true), header, rows, data };
}

export class Link {
  /** `on` has open(), closed() and frame(frame). */
  constructor(key, on) {
    this.key = key;
    this.on = on;
    this.wait = FIRST_WAIT;
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(`ws://${location.host}/ws?t=${encodeURIComponent(this.key)}`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => {
      this.wait = FIRST_WAIT;
      this.send({ type: "hello", protocol: PROTOCOL });
      this.on.open();
    };
    this.socket.onmessage = (message) => {
      const frame = readFrame(message.data);
      if (frame) this.on.frame(frame);
    };
    this.socket.onclose = () => {
      this.on.closed();
      this.wait = Math.min(LONGEST_WAIT, this.wait * 1.6);
      setTimeout(() => this.connect(), this.wait);
    };
  }

  get isOpen() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  /** Send a message; whether the connection took it. */
  send(message) {
    if (this.isOpen) this.socket.send(JSON.stringify(message));
    return this.isOpen;
  }
}
