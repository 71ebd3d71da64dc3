// The axes of figures: their numbers, their room, their heights.

import { colour } from "./colours.js";
import { decade, even, logarithmic } from "./numbers.js";

const FINEST = 2 ** -46; // of a height: nearer, ticks of an axis would fall on one number
const FONT = "12px system-ui, sans-serif";

/**
 * @param {{ label: string, log?: boolean }} axis
 * @param {uPlot.Axis} more
 * @returns {uPlot.Axis}
 */
export function axisOf(axis, more) {
  const lines = { stroke: colour("grid"), width: 1 };
  /** @type {uPlot.Axis} */
  const told = axis.log
    ? { values: (u, splits) => splits.map(decade), splits: logarithmic, filter: (u, splits) => splits }
    : { values: (u, splits, i, space, step) => splits.map((value) => even(value, step)) };
  return { label: axis.label, labelFont: FONT, labelSize: 18, font: FONT, stroke: colour("ink"), grid: lines, ticks: lines, ...told, ...more };
}

/**
 * The room that numbers beside an axis take, and its label; never less than others have with which it lies in line.
 * @param {number} least
 * @returns {uPlot.Axis.Size}
 */
export function roomFor(least) {
  return (u, values) => Math.max(least, 26 + 7.2 * Math.max(0, ...(values ?? []).map((value) => value.length)));
}

/** How much room an axis has taken, which uPlot keeps to itself. @param {uPlot} u @param {number} axis */
export function roomOf(u, axis) {
  return /** @type {{ _size: number }} */ (/** @type {unknown} */ (u.axes[axis]))._size;
}

/**
 * Keep the heights in sight however little they differ: what uPlot takes for rounding may be all there is.
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
