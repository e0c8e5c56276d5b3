// @ts-check
// The commands of the operator: lease, start, hold, resume, re-align, stop, reset, speed, and the offset of the desired pose.
import "./types.js";
import { writeWithCodes } from "./codes.js";
import { post, releaseWhileClosing } from "./connection.js";
import { at, button, fixed, input, make, write } from "./dom.js";
import { holdToRun } from "./hold_to_run.js";
import { Jog } from "./jog.js";

const COMMANDS = [
  { name: "start", text: "Start", needs: "start", path: "/api/start", seen: true },
  { name: "hold", text: "Hold", needs: null, path: "/api/hold", seen: false },
  { name: "hold-hand", text: "Hold hand", needs: null, path: "/api/hold", seen: false },
  { name: "resume", text: "Resume", needs: "resume", path: "/api/resume", seen: true },
  { name: "re-align", text: "Re-align", needs: "re-align", path: "/api/re-align", seen: true },
  { name: "reset", text: "Reset", needs: "reset", path: "/api/reset", seen: true },
];
/** Two presses of Escape within this time stop both arms. */
const STOP_KEYS_MS = 800;
/** A stop that nothing answers is sent again: it changes nothing if it arrives twice. */
const STOP_TRIES = 5;
const STOP_ANSWER_MS = 1000;
const STOP_AGAIN_MS = 300;
const HOLDER_ELSEWHERE = 409;

/** A value after a time. @template T @param {number} time_ms @param {T} value @returns {Promise<T>} */
const after = (time_ms, value) => new Promise((resolve) => setTimeout(() => resolve(value), time_ms));

export class Commands {
  /**
   * @param {import("./connection.js").Connection} connection
   * @param {import("./types.js").Info} info
   */
  constructor(connection, info) {
    this.connection = connection;
    this.info = info;
    /** @type {import("./types.js").State|null} */
    this.state = null;
    /** @type {number|null} */
    this.ownId = null;
    this.isSliding = false;
    this.isConnected = false;
    /** @type {Map<string, string>} */
    this.alerts = new Map();
    this.jog = new Jog((body) => this.send("/api/jog", { ...body, seen: this.seen() }, "offset of the hand"));
    this.build();
  }

  /** Whether this page holds the lease. */
  get leads() {
    return this.isConnected && this.connection.session !== null && this.state?.operator.holder?.id === this.ownId;
  }

  build() {
    for (const command of COMMANDS) {
      const element = make("button", { type: "button", id: `do-${command.name}`, "aria-describedby": "blocked" }, command.text);
      element.addEventListener("click", () => this.command(command));
      at("commands").append(element);
    }
    button("stop").addEventListener("click", () => this.stop());
    button("take").addEventListener("click", () => this.lease("take"));
    button("release").addEventListener("click", () => this.lease("release"));
    button("takeover-yes").addEventListener("click", () => this.lease("take-over"));
    button("takeover-no").addEventListener("click", () => (at("takeover").hidden = true));
    const name = input("operator-name");
    name.value = localStorage.getItem("operator-name") ?? "operator";
    name.addEventListener("change", () => localStorage.setItem("operator-name", name.value));
    const speed = input("speed");
    speed.addEventListener("input", () => {
      this.isSliding = true;
      write(at("speed-text"), `${speed.value} %`);
    });
    speed.addEventListener("change", async () => {
      await this.send("/api/speed", { percent: Number(speed.value), seen: this.seen() }, "speed");
      this.isSliding = false;
    });
    window.addEventListener("pagehide", () => {
      if (!this.connection.session || !this.leads) return;
      releaseWhileClosing(this.connection.session);
      this.connection.session = null;
    });
    this.listenForStop();
    if (this.info.hold_to_run) holdToRun(at("run"), (isPressed) => (this.connection.pressed = isPressed));
    at("command-card").hidden = false;
    const hasArms = this.info.arms.length > 0;
    for (const id of ["commands", "jog", "stop"]) at(id).hidden = !hasArms;
    at("speed").parentElement?.toggleAttribute("hidden", !hasArms);
  }

  listenForStop() {
    let before_ms = -Infinity;
    document.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || event.repeat) return;
      const now_ms = performance.now();
      if (now_ms - before_ms < STOP_KEYS_MS) void this.stop();
      before_ms = now_ms;
    });
  }

  /** What the operator sees, so that a command for another state is refused. */
  seen() {
    const { state } = this;
    if (!state) return null;
    return { state: state.state.number, target: state.target.id, time_ms: state.time_ms };
  }

  async stop() {
    this.connection.isStopping = true;
    for (let attempt = 1; attempt <= STOP_TRIES; attempt++) {
      // Two ways: one connection may be held up, the other one refused.
      const bySocket = this.connection.stop();
      let answer = await Promise.race([bySocket, post("/api/stop", {}, this.connection.session, STOP_ANSWER_MS)]);
      if (answer.status === 0) answer = await Promise.race([bySocket, after(STOP_AGAIN_MS, answer)]);
      this.tell("stop", answer);
      this.alert("stop", answer.ok ? null : `Stop ${answer.status === 0 ? "" : "was refused: "}${answer.body.error}. Use the emergency stop.`);
      if (answer.status !== 0) {
        this.connection.isStopping = false;
        return;
      }
    }
  }

  /** @param {typeof COMMANDS[number]} command */
  async command(command) {
    const body = command.seen ? { seen: this.seen() } : command.name === "hold-hand" ? { hand_only: true } : {};
    await this.send(command.path, body, command.name);
  }

  /** @param {string} path @param {object} body @param {string} name */
  async send(path, body, name) {
    const answer = await post(path, body, this.connection.session);
    this.tell(name, answer);
    return answer;
  }

  /** @param {"take"|"take-over"|"release"} action */
  async lease(action) {
    at("takeover").hidden = true;
    const body = action === "release" ? { action } : { action, name: input("operator-name").value.trim() || "operator" };
    const answer = await post("/api/lease", body, action === "release" ? this.connection.session : null);
    const done = { take: "You lead now.", "take-over": "You lead now; every arm holds.", release: "Released; every arm holds." }[action];
    this.tell(action, answer.ok ? { ...answer, body: { line: done, ...answer.body } } : answer);
    if (answer.status === HOLDER_ELSEWHERE && action === "take") {
      const holder = this.state?.operator.holder;
      write(at("takeover-text"), `${holder ? holder.name : "somebody"} has the command. Ask first.`);
      at("takeover").hidden = false;
    }
    if (!answer.ok) return;
    this.connection.session = action === "release" ? null : answer.body.session;
    this.ownId = action === "release" ? null : answer.body.holder.id;
    this.connection.hello();
  }

  /** @param {string} what @param {import("./types.js").Answer} answer */
  tell(what, answer) {
    const { body, ok, status } = answer;
    const code = body.code && !body.error.includes(body.code) ? ` [${body.code}]` : "";
    at("answer").classList.toggle("refused", !ok);
    const failure = status === 0 ? `${what} ${body.error}` : `${what} refused: ${body.error}${code}`;
    writeWithCodes(at("answer"), ok ? body.line ?? `${what}: done` : failure);
  }

  /**
   * Shows a danger until it is over. Each cause has its own line.
   * @param {"link"|"stop"|"cameras"} cause
   * @param {string|null} text
   */
  alert(cause, text) {
    if (text === null) this.alerts.delete(cause);
    else this.alerts.set(cause, text);
    at("alert").hidden = this.alerts.size === 0;
    write(at("alert"), [...this.alerts.values()].join(" "));
  }

  /** @param {boolean} isConnected */
  link(isConnected) {
    this.isConnected = isConnected;
    this.alert("link", isConnected ? null : "No connection to pb3dp: what you see is old, and commands do not arrive. Arms that move hold or stop by themselves.");
    if (this.state) this.show(this.state);
  }

  /**
   * Why a command is not possible now, or null.
   * @param {typeof COMMANDS[number]} command
   * @param {import("./types.js").State} state
   */
  blocked({ name, needs }, { state, why }) {
    if (!this.isConnected) return "no connection";
    if (!this.leads) return "take the command first";
    if (needs === null || state.may.includes(needs)) return null;
    if (name === "reset") return "only after a stop or a fault";
    if (name === "re-align") return "only while the hand follows";
    if (state.is_moving) return "the arm moves already";
    if (state.is_latched) return "use Reset first";
    if (name === "start" && state.name === "idle") return "select a target first, also after Reset";
    if (name === "start" && state.name === "selecting") return why.line;
    return `not in the state ${state.name}`;
  }

  /** Disables the commands that are not possible and writes the reasons. @param {import("./types.js").State} state */
  showBlocked(state) {
    /** @type {Map<string, string[]>} */
    const reasons = new Map();
    for (const command of COMMANDS) {
      const reason = this.blocked(command, state);
      button(`do-${command.name}`).disabled = reason !== null;
      if (reason !== null) reasons.set(reason, [...(reasons.get(reason) ?? []), command.text]);
    }
    writeWithCodes(at("blocked"), [...reasons].map(([reason, names]) => `${names.join(", ")}: ${reason}`).join(". "));
  }

  /** @param {import("./types.js").State} state */
  show(state) {
    this.state = state;
    const { holder } = state.operator;
    const heard = state.operator.heard_ms_ago;
    const leads = this.leads;
    write(
      at("holder"),
      leads ? `You lead. Last heartbeat: ${fixed(heard, 0)} ms ago.` : holder ? `${holder.name} leads.` : "Nobody leads: take the command to choose targets and to start.",
    );
    button("take").hidden = leads;
    button("release").hidden = !leads;
    if (state.state.is_latched) {
      this.alert("stop", null);
      this.connection.isStopping = false;
    }
    this.showBlocked(state);
    const speed = input("speed");
    speed.disabled = !leads;
    if (!this.isSliding) {
      speed.value = String(state.control.speed_percent);
      write(at("speed-text"), `${fixed(state.control.speed_percent, 0)} %`);
    }
    this.jog.show(state.control.jog, leads);
  }
}
