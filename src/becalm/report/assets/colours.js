// The colours of figures in the browser's light or dark theme.

const OTHERS = 6;
/** @type {Map<string, string>} */
const palette = new Map();

/** Read the colours of the current theme. */
export function readColours() {
  const style = getComputedStyle(document.documentElement);
  const others = Array.from({ length: OTHERS }, (_, i) => `other-${i}`);
  for (const name of ["paper", "ink", "faint", "grid", "readings", "clean", "truth", "limit", ...others])
    palette.set(name, style.getPropertyValue(`--${name}`).trim());
}

/** Call a function after each change of the theme, when the new colours are read. @param {() => void} redraw */
export function onTheme(redraw) {
  for (const query of ["(prefers-color-scheme: dark)", "print"])
    matchMedia(query).addEventListener("change", () => {
      readColours();
      redraw();
    });
}

/** Return the colour of a role in the current theme. @param {string} role */
export const colour = (role) => () => palette.get(role) ?? "";
/** Return the same colour, translucent. @param {string} role */
export const translucent = (role) => () => `${palette.get(role)}40`;
/** Return the colour name of a layer with the role "other". @param {number} number its number among these layers */
export const other = (number) => `other-${number % OTHERS}`;
