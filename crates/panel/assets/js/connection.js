// @ts-check
// The WebSocket of the page: states, images and log lines in, heartbeats out. It connects again by itself.
import "./types.js";
import { headers as withToken, token } from "./token.js";

const PROTOCOL = 1;
const AGAIN_MS = 700;
/** Without any message for this long the connection counts as broken. */
const SILENT_MS = 1500;
/** A connection that was silent for this long is given up. */
const GIVEN_UP_MS = 4000;
const HEADER_BYTES = 32;
const RECTIFIED_FLAG = 1;
/** Without an answer for this long a command counts as not sent. */
const ANSWER_MS = 3000;

export class Connection {
  constructor() {
    /** @type {string|null} */
    this.session = null;
    /** Whether the button of hold-to-run is pressed. */
    this.pressed = false;
    this.onState = (/** @type {import("./types.js").State} */ _state) => {};
    this.onImage = (/** @type {import("./types.js").CameraImage} */ _image) => {};
    this.onLog = (/** @type {import("./types.js").LogLine[]} */ _lines) => {};
    this.onLink = (/** @type {boolean} */ _isOpen) => {};
    /** @type {object|null} */
    this.asked = null;
    /** @type {WebSocket|null} */
    this.socket = null;
    this.heard_ms = 0;
    this.isOpen = false;
    /** Images that are being decoded; more are dropped. */
    this.decoding = [0, 0, 0];
    /** Images dropped because the page is too slow: left, right, heat. */
    this.dropped = [0, 0, 0];
    /** Whether a stop waits for its answer. */
    this.isStopping = false;
    /** @type {(answer: {accepted: boolean, error?: string, code?: string}) => void} */
    this.onStopAnswer = () => {};
    this.connect();
    setInterval(() => this.watch(), 250);
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(`${scheme}//${location.host}/api/events`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.heard_ms = performance.now();
    socket.onopen = () => {
      this.hello();
      if (this.asked) this.send(this.asked);
      this.heard_ms = performance.now();
      this.setOpen(true);
    };
    socket.onmessage = (event) => this.take(event.data);
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.setOpen(false);
      setTimeout(() => {
        if (this.socket === socket) this.connect();
      }, AGAIN_MS);
    };
  }

  /** @param {boolean} isOpen */
  setOpen(isOpen) {
    if (this.isOpen === isOpen) return;
    this.isOpen = isOpen;
    this.onLink(isOpen);
  }

  watch() {
    const silent_ms = performance.now() - this.heard_ms;
    const dead = this.socket;
    if (dead?.readyState === WebSocket.OPEN) this.setOpen(silent_ms <= SILENT_MS);
    // A line that fell silent without an end may never tell one.
    if (dead && silent_ms > GIVEN_UP_MS) {
      this.connect();
      dead.close();
    }
  }

  hello() {
    this.send({ type: "hello", protocol: PROTOCOL, session: this.session, token: token() });
  }

  /** @param {object} message */
  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** @param {object} images */
  ask(images) {
    this.asked = { type: "images", ...images };
    this.send(this.asked);
  }

  /** @param {string|ArrayBuffer} data */
  take(data) {
    this.heard_ms = performance.now();
    this.setOpen(true);
    if (data instanceof ArrayBuffer) {
      void this.takeImage(data);
      return;
    }
    const message = JSON.parse(data);
    switch (message.type) {
      case "heartbeat":
        // Somebody whose stop nobody answers is no operator who wants motion.
        this.send({ type: "heartbeat", nonce: message.nonce, visible: !document.hidden && !this.isStopping, pressed: this.pressed });
        break;
      case "state":
        this.onState(message);
        break;
      case "log":
        this.onLog(message.lines);
        break;
      case "answer":
        if (!message.accepted && message.to === "hello" && this.session) this.session = null;
        if (message.to === "stop") this.onStopAnswer(message);
        break;
    }
  }

  /**
   * Stops both arms over the connection that is open already; the promise waits for the answer, however long.
   * @returns {Promise<import("./types.js").Answer>}
   */
  stop() {
    this.send({ type: "stop" });
    return new Promise((resolve) => {
      this.onStopAnswer = ({ accepted, error, code }) =>
        resolve({ ok: accepted, status: accepted ? 200 : 409, body: accepted ? { line: "stop: done" } : { error, code: code ?? null } });
    });
  }

  /** @param {ArrayBuffer} data */
  async takeImage(data) {
    const view = new DataView(data);
    if (data.byteLength < HEADER_BYTES || view.getUint32(0, false) !== 0x50424931) return;
    const side = view.getUint8(4) === 0 ? 0 : 1;
    const isHeat = view.getUint8(5) === 1;
    const queue = isHeat ? 2 : side;
    if (this.decoding[queue] > 1) {
      this.dropped[queue] += 1;
      return;
    }
    this.decoding[queue] += 1;
    try {
      const bitmap = await createImageBitmap(new Blob([data.slice(HEADER_BYTES)], { type: isHeat ? "image/png" : "image/jpeg" }));
      const number = (/** @type {number} */ offset) => view.getUint16(offset, true);
      const [sequence, time_ms] = [Number(view.getBigUint64(8, true)), view.getFloat64(16, true)];
      const isRectified = (number(6) & RECTIFIED_FLAG) !== 0;
      this.onImage({ side, isHeat, isRectified, sequence, time_ms, size_px: [number(24), number(26)], place_px: [number(28), number(30)], bitmap });
    } finally {
      this.decoding[queue] -= 1;
    }
  }
}

/**
 * Sends a command or a question. Status 0: nothing answered, so the command may not have arrived.
 * @param {string} path
 * @param {object} body
 * @param {string|null} session
 * @param {number} [answer_ms]
 * @returns {Promise<import("./types.js").Answer>}
 */
export async function post(path, body, session, answer_ms = ANSWER_MS) {
  const headers = withToken({ "Content-Type": "application/json" });
  if (session) headers["PB3DP-Session"] = session;
  try {
    const signal = AbortSignal.timeout(answer_ms);
    const response = await fetch(path, { method: "POST", headers, body: JSON.stringify(body), signal });
    return { ok: response.ok, status: response.status, body: await response.json() };
  } catch (error) {
    const isLate = error instanceof DOMException && error.name === "TimeoutError";
    const cause = isLate ? `no answer within ${answer_ms} ms` : "no connection to pb3dp";
    return { ok: false, status: 0, body: { error: `could not be sent: ${cause}`, code: null } };
  }
}

/**
 * Gives the lease back while the page closes; every arm holds.
 * @param {string} session
 */
export function releaseWhileClosing(session) {
  const headers = withToken({ "Content-Type": "application/json", "PB3DP-Session": session });
  void fetch("/api/lease", { method: "POST", headers, body: '{"action":"release"}', keepalive: true }).catch(() => {});
}
