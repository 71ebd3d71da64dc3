// Chooses, formats and draws the times on the axis of the live page.

import { colour } from "../colours.js";
import { HELD } from "./store.js";

const STEPS_S = [1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600, 43200, 86400];
const APART = 95; // smallest distance of two labels in CSS pixels
const EPOCH_S = 1e8; // larger stamps are seconds since 1970

const LATE = 1.5; // two bins have a gap between them if their stamps differ by more than this many durations of a bin

/** @typedef {import("./store.js").Store} Store */

/**
 * Compute the stamp of a row from the stamp of the last stored bin before it; null if no such bin is near.
 * @param {Store} store @param {number} each @param {number} row @param {number} rate
 */
export function timeOf(store, each, row, rate) {
  for (let bin = Math.floor(row / each), left = 200; left > 0 && bin >= 0; bin -= 1, left -= 1)
    if (store.has(bin)) return store.t[bin % HELD] + (row - bin * each) / rate;
  return null;
}

/**
 * Return the round times in view: for each its device pixels from the left, and its text. Times are interpolated between
 * the stamps of neighbouring bins, because time may jump between bins.
 * @param {Store} store @param {number} each @param {number} rate
 * @param {number} left row @param {number} right row @param {number} width device pixels
 * @returns {[number, string][]}
 */
export function ticksOf(store, each, rate, left, right, width) {
  const apart = APART * devicePixelRatio;
  const rough = ((right - left) / rate) * (apart / width);
  const step = STEPS_S.find((one) => one >= rough) ?? Math.ceil(rough / 86400) * 86400;
  const lasts = each / rate;
  /** @type {[number, string][]} */
  const ticks = [];
  for (let bin = Math.max(0, Math.floor(left / each)); bin * each < right; bin += 1) {
    if (!store.has(bin)) continue;
    const begin = store.t[bin % HELD];
    const passed = store.has(bin + 1) ? store.t[(bin + 1) % HELD] - begin : lasts;
    const end = begin + (passed > 0 && passed < LATE * lasts ? passed : lasts);
    for (let k = Math.ceil(begin / step - 1e-9); k * step < end - 1e-9 * step && ticks.length < 60; k += 1) {
      const x = (((bin + (k * step - begin) / (end - begin)) * each - left) / (right - left)) * width;
      if (x >= -0.5 && x <= width && !(x - (ticks.at(-1)?.[0] ?? -apart) < 0.7 * apart)) ticks.push([x, clock(k * step, step)]);
    }
  }
  return ticks;
}

/** Format a time with as many digits as a step needs. @param {number} t seconds @param {number} step seconds */
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
