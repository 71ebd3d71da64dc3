// When things were: ticks at even times, and words for them.

import { colour } from "../colours.js";
import { HELD } from "./store.js";

const STEPS_S = [1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600, 43200, 86400];
const APART = 95; // CSS pixels, at least
const EPOCH_S = 1e8; // stamps beyond are seconds since 1970

/** @typedef {{ row: number, t: number, rate: number }} Anchor a row whose stamp is known */

/**
 * The stamp of the last bin before a row that is held.
 * @param {import("./store.js").Store} store @param {number} each @param {number} row @param {number} rate
 * @returns {Anchor | null}
 */
export function anchorOf(store, each, row, rate) {
  for (let bin = Math.floor(row / each), left = 200; left > 0 && bin >= 0; bin -= 1, left -= 1)
    if (store.has(bin)) return { row: bin * each, t: store.t[bin % HELD], rate };
  return null;
}

/** The stamp of a row. @param {Anchor} anchor @param {number} row */
export const timeOf = (anchor, row) => anchor.t + (row - anchor.row) / anchor.rate;

/**
 * Even times in view, as device pixels from the left and words.
 * @param {Anchor | null} anchor @param {number} left row @param {number} right row @param {number} width device pixels
 * @returns {[number, string][]}
 */
export function ticksOf(anchor, left, right, width) {
  if (!anchor) return [];
  const [begin, end] = [timeOf(anchor, left), timeOf(anchor, right)];
  const rough = ((end - begin) * APART * devicePixelRatio) / width;
  const step = STEPS_S.find((one) => one >= rough) ?? Math.ceil(rough / 86400) * 86400;
  /** @type {[number, string][]} */
  const ticks = [];
  for (let k = Math.ceil(Math.max(begin, timeOf(anchor, 0)) / step - 1e-9); k * step <= end && ticks.length < 60; k += 1)
    ticks.push([((k * step - begin) / (end - begin)) * width, clock(k * step, step)]);
  return ticks;
}

/** Say when something was, in digits that tell a step. @param {number} t seconds @param {number} step */
export function clock(t, step) {
  const digits = Math.max(0, Math.min(6, Math.ceil(-Math.log10(step) - 1e-9)));
  if (t < EPOCH_S) return `${Number(t.toFixed(digits)).toFixed(digits).replace("-", "−")} s`;
  const when = new Date(Math.floor(t + 1e-9) * 1000);
  const clocked = when.toLocaleTimeString([], { hour12: false, hour: "2-digit", minute: "2-digit", second: "2-digit" });
  return digits ? `${clocked}.${(t - Math.floor(t + 1e-9)).toFixed(digits).slice(2)}` : clocked;
}

/** @param {HTMLCanvasElement} canvas @param {[number, string][]} ticks @param {number} left */
export function drawAxis(canvas, ticks, left) {
  const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
  pen.fillStyle = colour("faint")();
  pen.textBaseline = "top";
  for (const [x, words] of ticks) {
    const half = pen.measureText(words).width / 2;
    pen.fillText(words, Math.max(0, Math.min(canvas.width - 2 * half, left + x - half)), 4 * devicePixelRatio);
  }
}
