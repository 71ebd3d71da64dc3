// Draws the figures of a report from the data in the page.

import { onTheme, readColours } from "./colours.js";
import { bytesOf, decode, draw } from "./figures.js";

/** Unpack the SVG figures for print. @param {HTMLElement} place */
async function unpack(place) {
  const stream = new Blob([bytesOf(place.dataset.svg ?? "")]).stream().pipeThrough(new DecompressionStream("gzip"));
  place.innerHTML = await new Response(stream).text();
}

/** Draw all figures; figures with the same data-together form a group that zooms together. */
function drawAll() {
  const { arrays: held, figures } = JSON.parse(document.getElementById("figures")?.textContent ?? "");
  const arrays = held.map(decode);
  /** @type {Map<string, NonNullable<Parameters<typeof draw>[3]>>} */
  const groups = new Map();
  /** @type {uPlot[]} */
  const plots = figures.map((/** @type {Parameters<typeof draw>[0]} */ figure) => {
    const place = /** @type {HTMLElement} */ (document.getElementById(figure.name));
    const key = place.dataset.together;
    if (key && !groups.has(key)) groups.set(key, { key, plots: [] });
    return draw(figure, arrays, place, groups.get(key ?? ""));
  });
  return plots;
}

readColours();
const plots = drawAll();
onTheme(() => plots.forEach((u) => u.redraw(false, true)));
document.querySelectorAll("[data-svg]").forEach((place) => unpack(/** @type {HTMLElement} */ (place)));
Object.assign(window, { becalmPlots: plots }); // for scripts that inspect the page, such as its tests
