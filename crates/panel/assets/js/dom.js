// @ts-check
// Elements of the page.

/**
 * @param {string} id
 * @returns {HTMLElement}
 */
export function at(id) {
  const element = document.getElementById(id);
  if (!element) throw new Error(`the page has no element ${id}`);
  return element;
}

/** @param {string} id */
export const button = (id) => /** @type {HTMLButtonElement} */ (at(id));
/** @param {string} id */
export const input = (id) => /** @type {HTMLInputElement} */ (at(id));
/** @param {string} id */
export const canvas = (id) => /** @type {HTMLCanvasElement} */ (at(id));

/**
 * @param {string} tag
 * @param {Record<string, string>} attributes
 * @param {string} [text]
 */
export function make(tag, attributes = {}, text) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

/**
 * Writes a text only if it changed, so that screen readers are not disturbed.
 * @param {Element} element
 * @param {string} text
 */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/**
 * A number with a fixed count of decimals; a dash without one.
 * @param {number|null|undefined} value
 * @param {number} decimals
 */
export function fixed(value, decimals) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? (0).toFixed(decimals) : text;
}

/**
 * The length of a vector, or null.
 * @param {number[]|null} vector
 */
export function norm(vector) {
  return vector ? Math.hypot(...vector) : null;
}
