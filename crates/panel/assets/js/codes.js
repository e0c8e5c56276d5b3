// @ts-check
// Codes of messages: links to the page of all messages if the server has it, else the command that explains them.
import { make } from "./dom.js";

const CODE = /(PB3DP-[A-Z]+-\d+)/;
const MESSAGES = "/docs/reference/messages.html";

/** @type {Promise<boolean>|null} */
let hasDocs = null;

/** Asks once, when the first code is shown. */
function docs() {
  hasDocs ??= fetch(MESSAGES, { method: "HEAD" }).then(({ ok }) => ok, () => false);
  return hasDocs;
}

/** The element of a code. @param {string} code */
function explained(code) {
  const place = make("span", { class: "code", title: `pb3dp explain ${code}` }, code);
  void docs().then((ok) => {
    if (!ok) return;
    const link = make("a", { href: `${MESSAGES}#:~:text=${code.replaceAll("-", "%2D")}`, target: "_blank", rel: "noopener" }, code);
    place.replaceChildren(link);
  });
  return place;
}

/** A text whose codes can be looked up. @param {string} text @returns {(string|HTMLElement)[]} */
export function withCodes(text) {
  return text.split(CODE).map((part, index) => (index % 2 === 0 ? part : explained(part)));
}

/** Writes a text with codes if it changed. @param {Element} element @param {string} text */
export function writeWithCodes(element, text) {
  if (element.textContent !== text) element.replaceChildren(...withCodes(text));
}
