// @ts-check
// The token of a panel that other computers can reach. The tab keeps it; it is never part of an address.

const KEY = "panel-token";

/** The token, or null where none was needed yet. */
export function token() {
  return sessionStorage.getItem(KEY);
}

/**
 * Headers of a request, with the token.
 * @param {Record<string, string>} [others]
 * @returns {Record<string, string>}
 */
export function headers(others = {}) {
  const known = token();
  return known === null ? others : { ...others, Authorization: `Bearer ${known}` };
}

/** Asks for the token until one is given. @param {HTMLFormElement} form */
export function askForToken(form) {
  const wasWrong = token() !== null;
  form.querySelector("p")?.toggleAttribute("hidden", !wasWrong);
  form.hidden = false;
  const field = /** @type {HTMLInputElement} */ (form.querySelector("input"));
  field.focus();
  return new Promise((resolve) => {
    form.addEventListener(
      "submit",
      (event) => {
        event.preventDefault();
        sessionStorage.setItem(KEY, field.value.trim());
        field.value = "";
        form.hidden = true;
        resolve(undefined);
      },
      { once: true },
    );
  });
}
