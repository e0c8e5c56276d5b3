// @ts-check
// The commands of the operator: lease, start, hold, resume, stop, reset, speed, and the offset of the desired pose.
import "./types.js";
import { post } from "./connection.js";
import { at, button, fixed, input, make, write } from "./dom.js";

const COMMANDS = [
  { name: "start", text: "Start", needs: "start", path: "/api/start", seen: true },
  { name: "hold", text: "Hold", needs: null, path: "/api/hold", seen: false },
  { name: "hold-hand", text: "Hold hand", needs: null, path: "/api/hold", seen: false },
  { name: "resume", text: "Resume", needs: "resume", path: "/api/resume", seen: true },
  { name: "reset", text: "Reset", needs: "reset", path: "/api/reset", seen: true },
];
const AXES = ["x", "y", "z"];
const STEP_MM = 5;
const STEP_DEG = 1;
/** Two presses of Escape within this time stop both arms. */
const STOP_KEYS_MS = 800;
const HOLDER_ELSEWHERE = 409;

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
    this.jogs = /** @type {HTMLElement[]} */ ([]);
    this.isSliding = false;
    this.build();
  }

  /** Whether this page holds the lease. */
  get leads() {
    return this.connection.session !== null && this.state?.operator.holder?.id === this.ownId;
  }

  build() {
    for (const command of COMMANDS) {
      const element = make("button", { type: "button", id: `do-${command.name}` }, command.text);
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
    this.buildJog();
    this.listenForStop();
    if (this.info.hold_to_run) this.buildHoldToRun();
    at("command-card").hidden = false;
    const hasArms = this.info.arms.length > 0;
    for (const id of ["commands", "jog", "stop"]) at(id).hidden = !hasArms;
    at("speed").parentElement?.toggleAttribute("hidden", !hasArms);
  }

  buildJog() {
    AXES.forEach((axis, index) => {
      for (const [kind, step, unit] of /** @type {const} */ ([["mm", STEP_MM, "mm"], ["deg", STEP_DEG, "°"]])) {
        const row = make("div", { class: "axis" });
        const output = make("output");
        const less = make("button", { type: "button", "aria-label": `${axis} minus ${step} ${unit}` }, "−");
        const more = make("button", { type: "button", "aria-label": `${axis} plus ${step} ${unit}` }, "+");
        less.addEventListener("click", () => this.jog(kind, index, -step));
        more.addEventListener("click", () => this.jog(kind, index, step));
        row.append(make("span", {}, kind === "mm" ? axis : `r${axis}`), less, output, more);
        at("jog").append(row);
        this.jogs.push(output);
      }
    });
  }

  buildHoldToRun() {
    const run = at("run");
    run.hidden = false;
    const press = (/** @type {boolean} */ pressed) => {
      this.connection.pressed = pressed;
      run.setAttribute("aria-pressed", String(pressed));
    };
    run.addEventListener("pointerdown", (event) => {
      run.setPointerCapture(event.pointerId);
      press(true);
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) {
      run.addEventListener(name, () => press(false));
    }
    run.addEventListener("keydown", (event) => {
      if (event.key === " ") press(true);
    });
    run.addEventListener("keyup", () => press(false));
    window.addEventListener("blur", () => press(false));
    let wasPressed = false;
    setInterval(() => {
      const isPressed = navigator.getGamepads().some((pad) => pad?.buttons.some((one) => one.pressed));
      if (isPressed !== wasPressed) press(isPressed);
      wasPressed = isPressed;
    }, 50);
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
    const answer = await post("/api/stop", {}, this.connection.session);
    this.tell("stop", answer);
    if (!answer.ok) this.alert(`STOP WAS NOT OBEYED: ${answer.body.error} - use the emergency stop`);
  }

  /** @param {typeof COMMANDS[number]} command */
  async command(command) {
    const body = command.seen ? { seen: this.seen() } : command.name === "hold-hand" ? { hand_only: true } : {};
    await this.send(command.path, body, command.name);
  }

  /** @param {"mm"|"deg"} kind @param {number} axis @param {number} step */
  async jog(kind, axis, step) {
    const jog = this.state?.control.jog;
    if (!jog) return;
    const offset_mm = [...jog.offset_mm];
    const offset_deg = [...jog.offset_deg];
    (kind === "mm" ? offset_mm : offset_deg)[axis] += step;
    await this.send("/api/jog", { offset_mm, offset_deg, seen: this.seen() }, "move");
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
    this.tell(action, answer);
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
    const { body } = answer;
    const code = body.code ? ` [${body.code}: pb3dp explain ${body.code}]` : "";
    at("answer").classList.toggle("refused", !answer.ok);
    write(at("answer"), answer.ok ? body.line ?? `${what}: done` : `${what} refused: ${body.error}${code}`);
  }

  /** @param {string|null} text */
  alert(text) {
    at("alert").hidden = text === null;
    write(at("alert"), text ?? "");
  }

  /** @param {import("./types.js").State} state */
  show(state) {
    this.state = state;
    const { holder } = state.operator;
    const heard = state.operator.heard_ms_ago;
    const leads = this.leads;
    write(
      at("holder"),
      leads ? `You lead. Last heartbeat ${fixed(heard, 0)} ms ago.` : holder ? `${holder.name} leads.` : "Nobody leads: take the command to choose targets and to start.",
    );
    button("take").hidden = leads;
    button("release").hidden = !leads;
    for (const { name, needs } of COMMANDS) {
      const allowed = leads && (needs === null || state.state.may.includes(needs));
      const element = button(`do-${name}`);
      element.disabled = !allowed;
      element.title = allowed ? "" : leads ? `not possible in the state ${state.state.name}` : "take the command first";
    }
    const speed = input("speed");
    speed.disabled = !leads;
    if (!this.isSliding) {
      speed.value = String(state.control.speed_percent);
      write(at("speed-text"), `${fixed(state.control.speed_percent, 0)} %`);
    }
    const { offset_mm, offset_deg } = state.control.jog;
    this.jogs.forEach((output, index) => {
      const axis = index >> 1;
      write(output, index % 2 === 0 ? `${fixed(offset_mm[axis], 0)} mm` : `${fixed(offset_deg[axis], 1)}°`);
      output.parentElement?.querySelectorAll("button").forEach((one) => (one.disabled = !leads));
    });
  }
}
