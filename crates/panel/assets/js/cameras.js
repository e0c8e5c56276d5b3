// @ts-check
// The cameras: their controls, checks of their images, and their calibration. Asked for only while the card is open.
import "./types.js";
import { post } from "./connection.js";
import { ControlList } from "./controls.js";
import { at, fixed, make, write } from "./dom.js";
import { headers } from "./token.js";

/** @typedef {import("./types.js").Controls} Controls */

const ASK_MS = 1000;
const ANSWER_MS = 4000;
const DAY_MS = 86_400_000;
const SIDES = /** @type {const} */ (["left", "right"]);

/** @param {string} path @returns {Promise<any>} */
async function get(path) {
  try {
    const response = await fetch(path, { headers: headers(), signal: AbortSignal.timeout(ANSWER_MS) });
    return response.ok ? await response.json() : null;
  } catch {
    return null;
  }
}

export class Cameras {
  /**
   * @param {import("./connection.js").Connection} connection
   * @param {import("./commands.js").Commands} commands
   * @param {import("./types.js").Info} info
   */
  constructor(connection, commands, info) {
    this.connection = connection;
    this.commands = commands;
    /** @type {Controls|null} */
    this.controls = null;
    this.isMoving = false;
    this.isAsking = false;
    /** Answers in a row with a problem: a single damaged pair needs no alarm. */
    this.problems = 0;
    /** State number at the last question. @type {number|null} */
    this.number = null;
    this.details = /** @type {HTMLDetailsElement} */ (at("camera-details"));
    this.lists = SIDES.map((side) => new ControlList(at(`controls-${side}`), side, (...change) => this.set(...change)));
    showCalibrations(info.cameras);
    this.details.addEventListener("toggle", () => {
      // What is not asked for any more is not known any more.
      this.alarm(null);
      void this.ask();
    });
    // Without arms this page is there to set up the cameras.
    this.details.open = info.arms.length === 0;
    setInterval(() => void this.ask(), ASK_MS);
  }

  async ask() {
    if (!this.details.open || document.hidden || this.isAsking) return;
    this.isAsking = true;
    const [controls, answer] = await Promise.all([get("/api/controls"), get("/api/cameras")]);
    this.isAsking = false;
    if (controls) this.take(controls);
    if (answer?.check) showCheck(answer.check);
  }

  /** @param {Controls} controls */
  take(controls) {
    this.controls = controls;
    write(at("camera-problem"), controls.problem ?? "");
    this.alarm(controls.problem);
    SIDES.forEach((side, index) => {
      const camera = controls.cameras[index];
      at(`camera-${side}`).hidden = !camera;
      write(at(`camera-${side}-name`), camera ? `${side}: ${camera.name}` : "");
      write(at(`camera-${side}-losses`), camera ? `images left out: ${losses(camera.losses)}` : "");
      this.lists[index].show(camera?.controls ?? [], this.whyNot() !== null);
    });
    this.showWhyNot();
  }

  /** The images above are not live: that must not be overlooked. @param {string|null} problem */
  alarm(problem) {
    this.problems = problem === null ? 0 : this.problems + 1;
    this.commands.alert("cameras", problem !== null && this.problems > 1 ? `No live images: ${problem}` : null);
  }

  /** Why nothing can be set now, or null. */
  whyNot() {
    if (!this.controls) return "not read yet";
    if (this.controls.cameras.length > 0 && this.isMoving) return "an arm moves; use Hold first";
    if (!this.controls.may_change) return this.controls.why_not ?? "not now";
    return this.commands.leads ? null : "take the command first";
  }

  showWhyNot() {
    const why = this.whyNot();
    write(at("controls-why"), why === null ? "" : `Controls: ${why}.`);
    for (const list of this.lists) list.block(why !== null);
  }

  /** @param {import("./types.js").State} state */
  show({ state }) {
    this.isMoving = state.is_moving;
    if (!this.details.open) return;
    if (state.number !== this.number) {
      this.number = state.number;
      void this.ask();
    }
    if (this.controls) this.showWhyNot();
  }

  /** @param {"left"|"right"} side @param {number} id @param {number} value */
  async set(side, id, value) {
    const answer = await post("/api/controls", { side, id, value }, this.connection.session, ANSWER_MS);
    if (answer.ok) this.take(answer.body);
    else await this.ask();
    return answer.ok ? null : String(answer.body.error);
  }
}

/** @param {Record<string, number>} counts */
function losses(counts) {
  const parts = Object.entries(counts).filter(([, count]) => count > 0);
  return parts.length === 0 ? "none" : parts.map(([name, count]) => `${count} ${name.replaceAll("_", " ")}`).join(", ");
}

/** @param {import("./types.js").Finding} finding */
function limit({ limit_min, limit_max }) {
  if (limit_min !== null && limit_max !== null) return `${limit_min} to ${limit_max}`;
  return limit_max !== null ? `at most ${limit_max}` : limit_min !== null ? `at least ${limit_min}` : "";
}

/** @param {import("./types.js").CameraCheck} check */
function showCheck(check) {
  write(at("camera-skew"), `exposure of the right camera: ${fixed(check.skew_ms, 2)} ms after the left one, at worst ${fixed(check.skew_worst_ms, 2)} ms`);
  const rows = check.findings.map((finding) => {
    const word = finding.passed === null ? "not checked" : finding.passed ? "good" : "bad";
    const row = make("tr", { class: `finding-${word.replace(" ", "-")}` });
    const value = finding.value === null ? "–" : `${fixed(finding.value, 2)} ${finding.unit}`;
    const found = [finding.found, finding.advice].filter(Boolean).join("; ");
    row.append(make("th", { scope: "row" }, finding.check), ...[word, value, limit(finding), found].map((text) => make("td", {}, text)));
    return row;
  });
  at("findings").replaceChildren(...rows);
}

/** @param {import("./types.js").Info["cameras"]} cameras */
function showCalibrations({ calibrated, calibration, calibrations }) {
  const lines = calibrations.map(({ table, source, date, gates }) => {
    const days = date === null ? NaN : Math.floor((Date.now() - Date.parse(date)) / DAY_MS);
    const age = date === null ? "no date stated" : `made ${date}${Number.isFinite(days) ? `, ${days} days ago` : ""}`;
    const results = gates.map((gate) => `${gate.name} ${fixed(gate.measured, 3)} (limit ${gate.refused}, ${gate.grade})`);
    return `${table}: ${source}, ${age}; ${results.length ? results.join(", ") : "the file states no quality"}`;
  });
  if (lines.length === 0) lines.push(calibrated ? calibration || "not stated" : "none: calibrate the cameras before targets can be chosen");
  at("calibrations").replaceChildren(...lines.map((line) => make("li", {}, line)));
}
