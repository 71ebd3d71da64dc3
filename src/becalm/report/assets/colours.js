// The colours of figures, as the reader's light or dark theme has them.

const OTHERS = 6;
/** @type {Map<string, string>} */
const palette = new Map();

/** Read the colours again, as the reader's light or dark theme has them. */
export function readColours() {
  const style = getComputedStyle(document.documentElement);
  const others = Array.from({ length: OTHERS }, (_, i) => `other-${i}`);
  for (const name of ["paper", "ink", "faint", "grid", "readings", "clean", "truth", "limit", ...others])
    palette.set(name, style.getPropertyValue(`--${name}`).trim());
}

/** Call when the theme has changed, with colours read anew. @param {() => void} redraw */
export function onTheme(redraw) {
  for (const asked of ["(prefers-color-scheme: dark)", "print"])
    matchMedia(asked).addEventListener("change", () => {
      readColours();
      redraw();
    });
}

/** The colour of a role, in the theme of now. @param {string} role */
export const colour = (role) => () => palette.get(role) ?? "";
/** The same, through which what is behind shows. @param {string} role */
export const translucent = (role) => () => `${palette.get(role)}40`;
/** @param {number} number */
export const other = (number) => `other-${number % OTHERS}`;
