// Finds and makes elements of a page, and formats numbers with their units.

/**
 * Find an element by its id.
 * @template {HTMLElement} T
 * @param {string} id
 * @param {new () => T} kind
 * @returns {T}
 */
export function find(id, kind) {
  const found = document.getElementById(id);
  if (!(found instanceof kind)) throw new Error(`The page has no ${kind.name} #${id}.`);
  return found;
}

/**
 * Make an element with children and attributes. An attribute that is true gets no value; one that is false is left out.
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {Record<string, string | number | boolean>} [attributes]
 * @param {...(Node | string)} children
 * @returns {HTMLElementTagNameMap[T]}
 */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes))
    if (value !== false) element.setAttribute(name, value === true ? "" : String(value));
  element.append(...children);
  return element;
}

/** Write a text into an element if it has changed, so that screen readers read it only once. @param {HTMLElement} place @param {string} text */
export function write(place, text) {
  if (place.textContent !== text) place.textContent = text;
}

/** Write a text into an element, and hide the element while the text is empty. @param {HTMLElement} place @param {string} text */
export function say(place, text) {
  write(place, text);
  place.hidden = !text;
}

/** Fill a dl with terms and their values. @param {HTMLElement} list @param {[string, string][]} entries */
export function fillTerms(list, entries) {
  list.replaceChildren(...entries.map(([term, value]) => make("div", {}, make("dt", {}, term), make("dd", {}, value))));
}

/** @type {Record<string, [number, string][]>} */
const PREFIXES = {
  s: [[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]],
  Hz: [[1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"]],
  B: [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""]],
};

/**
 * Format a number with three digits and a unit; return a dash if there is no number.
 * @param {number | null | undefined} value
 * @param {string} unit
 */
export function amount(value, unit) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value) * (1 + 1e-9);
  const [scale, prefix] = value === 0 ? [1, ""] : PREFIXES[unit]?.find(([one]) => size >= one) ?? PREFIXES[unit]?.at(-1) ?? [1, ""];
  const scaled = value / scale;
  const far = scaled !== 0 && (Math.abs(scaled) >= 1e6 || Math.abs(scaled) < 1e-3);
  const digits = far ? scaled.toExponential(2).replace("e+", "e") : String(Number(scaled.toPrecision(3)));
  return `${digits} ${prefix}${unit}`.trim();
}
