// @ts-check
// Controls of one camera: a row each, with name, value, range, unit, and who sets it. A row under somebody's hand is not touched.
import "./types.js";
import { at, fixed, make, write } from "./dom.js";

/** @typedef {import("./types.js").Control} Control */
/** @typedef {{control: Control, fields: (HTMLInputElement|HTMLSelectElement|HTMLButtonElement)[], text: HTMLElement, wrong: HTMLElement}} Row */

/** A value with its unit. @param {Control} control @param {number} value */
function inWords(control, value) {
  if (control.kind === "menu") return control.menu.find((item) => item.value === value)?.text ?? String(value);
  if (control.kind === "boolean") return value ? "on" : "off";
  if (!control.unit) return String(value);
  const { name, factor } = control.unit;
  return factor === 1 ? `${value} ${name}` : `${value} (${fixed(value * factor, 2)} ${name})`;
}

/** The value beside a field that does not show it in words itself. @param {Control} control @param {number} value */
const beside = (control, value) => (control.kind === "menu" ? "" : inWords(control, value));

/** Keys of a setup by the number of the control in V4L2, each with the size of its unit in that of the driver. @type {[number, string, number][]} */
const SETUP_KEYS = [
  [0x009a0902, "exposure_millis", 0.1],
  [0x00980913, "gain", 1],
  [0x0098091a, "white_balance_kelvin", 1],
];

/** The lines of a setup that set a camera as it is set now. @param {"left"|"right"} side @param {Control[]} controls */
function setupLines(side, controls) {
  const lines = SETUP_KEYS.flatMap(([id, key, factor]) => {
    const control = controls.find((one) => one.id === id);
    if (!control || control.value === null) return [];
    const number = factor === 1 ? String(control.value) : fixed(control.value * factor, 1);
    return [`${key} = ${control.mode === "auto" ? '"auto"' : number}`];
  });
  return [`[camera.${side}]`, ...lines].join("\n");
}

/** Range, default, and why a row has its present state. @param {Control} control */
function facts(control) {
  if (control.kind === "button") return "";
  const range = ["menu", "boolean"].includes(control.kind) ? "" : `${control.min} to ${control.max}${control.step > 1 ? ` in steps of ${control.step}` : ""}, `;
  const locked = control.mode === "auto" ? ", set by the camera" : ", locked by another control";
  const lens = control.moves_the_lens ? ", calibrate again after a change" : "";
  return `${range}default ${inWords(control, control.default)}${control.mode === "manual" ? ", manual" : ""}${control.is_locked || control.mode === "auto" ? locked : ""}${lens}`;
}

export class ControlList {
  /**
   * @param {HTMLElement} place
   * @param {"left"|"right"} side
   * @param {(side: "left"|"right", id: number, value: number) => Promise<string|null>} set answers why not, or null
   */
  constructor(place, side, set) {
    this.place = place;
    this.side = side;
    this.set = set;
    /** @type {Map<number, Row>} */
    this.rows = new Map();
    this.kinds = "";
    /** Values that wait until the one before is set. @type {Map<number, number>} */
    this.waiting = new Map();
    this.isSetting = false;
    this.isBlocked = true;
  }

  /** @param {Control[]} controls @param {boolean} isBlocked */
  show(controls, isBlocked) {
    this.isBlocked = isBlocked;
    const kinds = JSON.stringify(controls.map(({ id, name, kind, min, max, step, menu }) => [id, name, kind, min, max, step, menu]));
    if (kinds !== this.kinds) {
      this.kinds = kinds;
      this.rows.clear();
      this.place.replaceChildren(...controls.map((control) => this.build(control)));
    }
    for (const control of controls) this.update(control);
    write(at(`setup-lines-${this.side}`), setupLines(this.side, controls));
  }

  /** @param {boolean} isBlocked */
  block(isBlocked) {
    this.isBlocked = isBlocked;
    for (const row of this.rows.values()) this.enable(row);
  }

  /** @param {Control} control */
  build(control) {
    const id = `control-${this.side}-${control.id}`;
    const row = make("div", { class: "control" });
    const fields = this.fields(control);
    fields.forEach((field, index) => {
      field.id = index === 0 ? id : `${id}-number`;
      field.setAttribute("aria-describedby", `${id}-facts ${id}-wrong controls-why`);
      if (index > 0) field.setAttribute("aria-label", `${control.name}, ${this.side} camera, as a number`);
      const event = control.kind === "button" ? "click" : "change";
      field.addEventListener(event, () => this.ask(control, valueOf(field)));
    });
    const text = make("output", { for: id });
    const wrong = make("p", { id: `${id}-wrong`, class: "wrong", role: "status" });
    row.append(make("label", { for: id }, control.name), ...fields, text, make("p", { id: `${id}-facts`, class: "facts" }), wrong);
    fields[0].addEventListener("input", () => {
      if (fields[1]) fields[1].value = fields[0].value;
      if (control.kind !== "button") write(text, beside(control, valueOf(fields[0])));
    });
    this.rows.set(control.id, { control, fields, text, wrong });
    return row;
  }

  /** @param {Control} control @returns {Row["fields"]} */
  fields(control) {
    if (control.kind === "menu") {
      const select = document.createElement("select");
      select.append(...control.menu.map((item) => new Option(item.text, String(item.value))));
      return [select];
    }
    if (control.kind === "button") return [/** @type {HTMLButtonElement} */ (make("button", { type: "button" }, "Do it"))];
    if (control.kind === "boolean") return [/** @type {HTMLInputElement} */ (make("input", { type: "checkbox" }))];
    const limits = { min: String(control.min), max: String(control.max), step: String(Math.max(control.step, 1)) };
    const types = control.kind === "integer" ? ["range", "number"] : ["number"];
    return types.map((type) => /** @type {HTMLInputElement} */ (make("input", { type, ...limits })));
  }

  /** @param {Control} control */
  update(control) {
    const row = this.rows.get(control.id);
    if (!row) return;
    row.control = control;
    write(at(`control-${this.side}-${control.id}-facts`), facts(control));
    this.enable(row);
    const isInHand = row.fields.some((field) => field.matches(":active") || (field.matches(":focus") && field.type === "number"));
    if (isInHand || this.isSetting || this.waiting.size > 0) return;
    const { value } = control;
    if (value === null) return;
    write(row.text, beside(control, value));
    for (const field of row.fields) {
      if (field instanceof HTMLInputElement && field.type === "checkbox") field.checked = value !== 0;
      else field.value = String(value);
    }
  }

  /** @param {Row} row */
  enable({ control, fields }) {
    for (const field of fields) field.disabled = this.isBlocked || control.is_locked || control.kind === "other";
  }

  /** One change after the other; of those that wait for one control the newest counts. @param {Control} control @param {number} value */
  async ask(control, value) {
    if (!Number.isSafeInteger(value)) return this.tell(control.id, "enter a whole number");
    this.waiting.set(control.id, value);
    if (this.isSetting) return;
    this.isSetting = true;
    for (let next = first(this.waiting); next; next = first(this.waiting)) {
      this.waiting.delete(next[0]);
      this.tell(next[0], "");
      const why = await this.set(this.side, ...next);
      if (why !== null) this.tell(next[0], why);
    }
    this.isSetting = false;
    for (const row of this.rows.values()) this.update(row.control);
  }

  /** @param {number} id @param {string} text */
  tell(id, text) {
    const row = this.rows.get(id);
    if (row) write(row.wrong, text);
  }
}

/** @param {Row["fields"][number]} field */
function valueOf(field) {
  if (field instanceof HTMLInputElement && field.type === "checkbox") return Number(field.checked);
  return field instanceof HTMLButtonElement ? 1 : field.value === "" ? NaN : Number(field.value);
}

/** @param {Map<number, number>} map */
function first(map) {
  const { value, done } = map.entries().next();
  return done ? null : value;
}
