// @ts-check
// Hold to run: arms move only while a button, a key or a button of a gamepad is pressed.

const KEY = "h";
const GAMEPAD_MS = 50;

/** @typedef {"button"|"key"|"gamepad"} Source */

/** Whether keys go into a text. @param {EventTarget|null} target */
function isText(target) {
  return target instanceof HTMLInputElement && !["checkbox", "range", "button"].includes(target.type);
}

/**
 * @param {HTMLElement} button
 * @param {(isPressed: boolean) => void} changed
 */
export function holdToRun(button, changed) {
  /** @type {Set<Source>} */
  const pressed = new Set();
  const set = (/** @type {Source} */ source, /** @type {boolean} */ isPressed) => {
    if (isPressed) pressed.add(source);
    else pressed.delete(source);
    button.setAttribute("aria-pressed", String(pressed.size > 0));
    changed(pressed.size > 0);
  };
  button.hidden = false;
  button.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    button.setPointerCapture(event.pointerId);
    set("button", true);
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(name, () => set("button", false));
  // A long press of a finger would open a menu, which takes the pointer away.
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  document.addEventListener("keydown", (event) => {
    const isKey = event.key.toLowerCase() === KEY && !event.ctrlKey && !event.metaKey && !event.altKey && !isText(event.target);
    if (isKey && !event.repeat) set("key", true);
  });
  document.addEventListener("keyup", (event) => {
    // With Shift or Ctrl released first the key has another name; any doubt ends the motion.
    if (pressed.has("key") && event.key !== "Shift") set("key", false);
  });
  const all = () => /** @type {Source[]} */ (["button", "key", "gamepad"]).forEach((source) => set(source, false));
  window.addEventListener("blur", all);
  document.addEventListener("visibilitychange", () => document.hidden && all());
  setInterval(() => {
    const isPressed = document.hasFocus() && navigator.getGamepads().some((pad) => pad?.buttons.some((one) => one.pressed));
    if (isPressed !== pressed.has("gamepad")) set("gamepad", isPressed);
  }, GAMEPAD_MS);
}
