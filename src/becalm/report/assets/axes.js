// Configures the axes of figures: tick labels, width and range.

import { colour } from "./colours.js";
import { decade, even, logarithmic } from "./numbers.js";

const FINEST = 2 ** -46; // smallest range relative to the values: a smaller range would have equal tick labels
const FONT = "12px system-ui, sans-serif";

/**
 * @param {{ label: string, log?: boolean }} axis
 * @param {uPlot.Axis} more
 * @returns {uPlot.Axis}
 */
export function axisOf(axis, more) {
  const lines = { stroke: colour("grid"), width: 1 };
  /** @type {uPlot.Axis} */
  const numbers = axis.log
    ? { values: (u, splits) => splits.map(decade), splits: logarithmic, filter: (u, splits) => splits }
    : { values: (u, splits, i, space, step) => splits.map((value) => even(value, step)) };
  return { label: axis.label, labelFont: FONT, labelSize: 18, font: FONT, stroke: colour("ink"), grid: lines, ticks: lines, ...numbers, ...more };
}

/**
 * Return a function that computes the width of an axis from its tick labels.
 * @param {number} least smallest width in pixels, that of the axes to align with
 * @returns {uPlot.Axis.Size}
 */
export function roomFor(least) {
  return (u, values) => Math.max(least, 26 + 7.2 * Math.max(0, ...(values ?? []).map((value) => value.length)));
}

/** Return the width of an axis, which is a private field of uPlot. @param {uPlot} u @param {number} axis */
export function roomOf(u, axis) {
  return /** @type {{ _size: number }} */ (/** @type {unknown} */ (u.axes[axis]))._size;
}

/**
 * A y scale that shows even very small differences, which uPlot would treat as rounding errors.
 * @type {uPlot.Scale}
 */
export const roomy = {
  range: (u, least, most) => {
    if (least === null) return [0, 1];
    const finest = FINEST * Math.max(Math.abs(least), Math.abs(most));
    const room = Math.max(0.05 * (most - least) || 0.05 * Math.abs(most), finest) || 1;
    return [least - room, most + room];
  },
};
