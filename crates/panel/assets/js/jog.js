// @ts-check
// Small steps of the desired pose of the hand. The offset is absolute, so a repeated message changes nothing.
import "./types.js";
import { at, button, fixed, make, write } from "./dom.js";

/** @typedef {{offset_mm: number[], offset_deg: number[]}} Offset */
/** @typedef {{key: "offset_mm"|"offset_deg", axis: number, output: HTMLElement}} Row */

/** The server accepts at most 10 mm and 2 degrees per command. */
const STEPS = [
  { offset_mm: 1, offset_deg: 0.2 },
  { offset_mm: 5, offset_deg: 1 },
  { offset_mm: 10, offset_deg: 2 },
];
const USUAL_STEP = 1;
/** After this time without a command the offset of the server counts. */
const SETTLED_MS = 500;

export class Jog {
  /** @param {(offset: Offset) => Promise<import("./types.js").Answer>} send */
  constructor(send) {
    this.send = send;
    /** @type {Offset} */
    this.reported = { offset_mm: [0, 0, 0], offset_deg: [0, 0, 0] };
    /** What the newest command asked for: two quick clicks are two steps. @type {Offset|null} */
    this.requested = null;
    this.requested_ms = -Infinity;
    this.queue = Promise.resolve();
    this.step = document.createElement("select");
    this.step.id = "jog-step";
    STEPS.forEach(({ offset_mm, offset_deg }, index) => this.step.append(new Option(`${offset_mm} mm, ${offset_deg}°`, String(index))));
    this.step.value = String(USUAL_STEP);
    const label = make("label", { class: "wide" }, "step ");
    const zero = make("button", { type: "button", id: "jog-zero" }, "To zero");
    zero.addEventListener("click", () => this.toZero());
    label.append(this.step);
    const head = make("div", { class: "row wide" });
    head.append(label, zero);
    at("jog-rows").append(head);
    this.rows = ["x", "y", "z"].flatMap((name, axis) => [this.row("offset_mm", axis, name), this.row("offset_deg", axis, `r${name}`)]);
  }

  /** @param {Row["key"]} key @param {number} axis @param {string} name @returns {Row} */
  row(key, axis, name) {
    const element = make("div", { class: "axis" });
    const output = make("output");
    const less = make("button", { type: "button", "aria-label": `${name} minus one step` }, "\u2212");
    const more = make("button", { type: "button", "aria-label": `${name} plus one step` }, "+");
    less.addEventListener("click", () => this.add(key, axis, -1));
    more.addEventListener("click", () => this.add(key, axis, 1));
    element.append(make("span", {}, name), less, output, more);
    at("jog-rows").append(element);
    return { key, axis, output };
  }

  /** The offset from which the next step counts. */
  get base() {
    const isFresh = performance.now() - this.requested_ms < SETTLED_MS;
    return this.requested && isFresh ? this.requested : this.reported;
  }

  /** @param {Row["key"]} key @param {number} axis @param {number} sign */
  add(key, axis, sign) {
    const offset = copy(this.base);
    const step = STEPS[Number(this.step.value)][key];
    // Sums of 0.2 get no long fractions.
    offset[key][axis] = Math.round((offset[key][axis] + sign * step) * 1000) / 1000;
    void this.request(offset);
  }

  /** In as many commands as their limit needs; a refusal ends them. */
  async toZero() {
    const offset = copy(this.base);
    const most = STEPS[STEPS.length - 1];
    const isZero = () => [...offset.offset_mm, ...offset.offset_deg].every((value) => value === 0);
    while (!isZero()) {
      for (const key of /** @type {Row["key"][]} */ (["offset_mm", "offset_deg"])) {
        // The limit holds for the length of a change, so an axis gets its share of it.
        const share = Math.min(1, most[key] / Math.max(Math.hypot(...offset[key]), 1e-9));
        offset[key] = offset[key].map((value) => (share === 1 ? 0 : value * (1 - share)));
      }
      if (!(await this.request(copy(offset)))) return;
    }
  }

  /** One command after the other, so that none overtakes. @param {Offset} offset */
  request(offset) {
    this.requested = offset;
    this.requested_ms = performance.now();
    const sent = this.queue.then(async () => {
      const { ok } = await this.send(offset);
      if (ok) this.requested_ms = performance.now();
      else this.requested = null;
      return ok;
    });
    this.queue = sent.then(() => {});
    return sent;
  }

  /** @param {Offset} offset @param {boolean} isAllowed */
  show(offset, isAllowed) {
    this.reported = offset;
    for (const { key, axis, output } of this.rows) {
      write(output, key === "offset_mm" ? `${fixed(offset[key][axis], 0)} mm` : `${fixed(offset[key][axis], 1)}°`);
    }
    for (const one of at("jog").querySelectorAll("button")) one.disabled = !isAllowed;
    const isZero = [...offset.offset_mm, ...offset.offset_deg].every((value) => value === 0);
    if (isZero) button("jog-zero").disabled = true;
  }
}

/** @param {Offset} offset @returns {Offset} */
function copy({ offset_mm, offset_deg }) {
  return { offset_mm: [...offset_mm], offset_deg: [...offset_deg] };
}
