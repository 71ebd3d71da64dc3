// The plot of a strip: each pixel column is drawn once, into a ring buffer; every frame shows a window of this buffer.

import { colour, other, translucent } from "../colours.js";
import { HELD } from "./store.js";

/** @typedef {import("./store.js").Store} Store */
/**
 * @typedef {object} Look the data and scales of the plot; after a change of one of them the whole plot is drawn again
 * @property {Store} store
 * @property {number} each rows of a bin
 * @property {number} perRow device pixels of a row
 * @property {number} low value at the bottom
 * @property {number} high value at the top
 */

const LANE = 9; // CSS pixels of the lanes of modes and verdicts
const NARROW = 1.6; // device pixels; wider bins are joined by lines

export class Tape {
  /** @param {number} channel @param {number[]} modes indices of the probabilities of its modes */
  constructor(channel, modes) {
    this.channel = channel;
    this.modes = modes;
    this.paper = document.createElement("canvas");
    this.pen = /** @type {CanvasRenderingContext2D} */ (this.paper.getContext("2d"));
    /** @type {Look | null} */
    this.look = null;
    this.first = this.stop = 0; // range of bins that are drawn
  }

  /** Draw everything again at the next frame. */
  forget() {
    this.look = null;
  }

  /**
   * Draw new bins, and copy the columns left of `right` (device pixels since row 0) onto a canvas.
   * @param {CanvasRenderingContext2D} onto @param {{ left: number, width: number, height: number }} box device pixels
   * @param {Look} look @param {number} right @param {number} newest end of the bins that may be drawn
   */
  show(onto, box, look, right, newest) {
    const span = look.each * look.perRow; // of a bin
    const [first, stop] = [Math.max(0, Math.floor((right - box.width) / span) - 1), Math.min(newest, Math.ceil(right / span) + 1)];
    if (!this.#fits(look, box) || first < this.first || first > this.stop) {
      this.#begin(look, box, first);
    }
    for (; this.stop < stop; this.stop += 1) this.#draw(this.stop, span);
    this.first = Math.max(this.first, Math.ceil(this.stop - this.paper.width / span));
    const from = mod(right - box.width, this.paper.width);
    const whole = Math.min(box.width, this.paper.width - from);
    onto.drawImage(this.paper, from, 0, whole, box.height, box.left, 0, whole, box.height);
    if (whole < box.width) onto.drawImage(this.paper, 0, 0, box.width - whole, box.height, box.left + whole, 0, box.width - whole, box.height);
  }

  /** @param {Look} look @param {{ width: number, height: number }} box */
  #fits(look, box) {
    const mine = this.look;
    return (
      mine && this.paper.height === box.height && this.paper.width === roomFor(box.width, look) && mine.store === look.store &&
      mine.each === look.each && mine.perRow === look.perRow && mine.low === look.low && mine.high === look.high
    );
  }

  /** @param {Look} look @param {{ width: number, height: number }} box @param {number} first */
  #begin(look, box, first) {
    const width = roomFor(box.width, look);
    if (this.paper.width !== width || this.paper.height !== box.height) Object.assign(this.paper, { width, height: box.height });
    else this.pen.clearRect(0, 0, width, box.height);
    this.look = { ...look };
    this.first = this.stop = first;
  }

  /** Draw a bin, joined to the bin before it; bins may share a column. @param {number} bin @param {number} span device pixels of a bin */
  #draw(bin, span) {
    const { store } = /** @type {Look} */ (this.look);
    const begin = Math.floor(bin * span);
    const end = Math.max(begin + 1, Math.floor((bin + 1) * span));
    const shared = bin > this.first && Math.floor((bin - 1) * span) === begin ? 1 : 0;
    const x = mod(begin, this.paper.width);
    const places = x + end - begin > this.paper.width ? [x, x - this.paper.width] : [x]; // a bin at the end of the ring also begins it
    for (const place of places) this.pen.clearRect(place + shared, 0, end - begin - shared, this.paper.height);
    if (!store.has(bin)) return;
    const [now, before] = [bin % HELD, store.has(bin - 1) ? (bin - 1) % HELD : -1];
    for (const place of places) {
      this.#band(now, place + shared, end - begin - shared);
      for (const [kind, role] of /** @type {["raw" | "clean", string][]} */ ([["raw", "readings"], ["clean", "clean"]])) {
        this.pen.fillStyle = this.pen.strokeStyle = colour(role)();
        if (span > NARROW) this.#line(kind, now, before, place, span);
        else this.#column(kind, now, before, place, end - begin);
      }
      this.#lanes(now, place, end - begin);
    }
  }

  /** @param {number} value */
  #y(value) {
    const { low, high } = /** @type {Look} */ (this.look);
    return this.plain(this.paper.height) * (1 - (value - low) / (high - low));
  }

  /** Return the height without the lanes. @param {number} height device pixels */
  plain(height) {
    return height - LANE * devicePixelRatio * (this.modes.length ? 2 : 1);
  }

  /** Draw two standard deviations around the clean values. @param {number} now @param {number} x @param {number} width */
  #band(now, x, width) {
    const { values, channels } = /** @type {Look} */ (this.look).store;
    const at = now * channels + this.channel;
    const top = this.#y(values.clean_high[at] + 2 * values.sigma[at]);
    const height = this.#y(values.clean_low[at] - 2 * values.sigma[at]) - top;
    if (!width || !Number.isFinite(height)) return;
    this.pen.fillStyle = translucent("clean")();
    this.pen.fillRect(x, top, width, Math.max(1, height));
  }

  /** Draw from minimum to maximum, extended to the range of the bin before. @param {"raw" | "clean"} kind @param {number} now @param {number} before @param {number} x @param {number} width */
  #column(kind, now, before, x, width) {
    const { values, channels } = /** @type {Look} */ (this.look).store;
    const at = now * channels + this.channel;
    let [low, high] = [values[`${kind}_low`][at], values[`${kind}_high`][at]];
    if (!(low <= high)) return;
    if (before >= 0) {
      const [below, above] = [values[`${kind}_low`][before * channels + this.channel], values[`${kind}_high`][before * channels + this.channel]];
      if (above < low) low = above;
      if (below > high) high = below;
    }
    const top = this.#y(high);
    const thick = (kind === "clean" ? 2 : 1) * devicePixelRatio;
    const height = Math.max(thick, this.#y(low) - top);
    this.pen.fillRect(x, top - (height === thick ? thick / 2 : 0), width, height);
  }

  /** @param {"raw" | "clean"} kind @param {number} now @param {number} before @param {number} x @param {number} span */
  #line(kind, now, before, x, span) {
    const { values, channels } = /** @type {Look} */ (this.look).store;
    const [lows, highs, at] = [values[`${kind}_low`], values[`${kind}_high`], now * channels + this.channel];
    const [low, high] = [this.#y(lows[at]), this.#y(highs[at])];
    const was = before >= 0 ? this.#y((lows[before * channels + this.channel] + highs[before * channels + this.channel]) / 2) : NaN;
    this.pen.lineWidth = (kind === "clean" ? 2 : 1) * devicePixelRatio;
    for (const shift of x - span < 0 ? [0, this.paper.width] : x + span > this.paper.width ? [0, -this.paper.width] : [0]) {
      this.pen.beginPath();
      if (Number.isFinite(was)) {
        this.pen.moveTo(x + shift - span / 2, was);
        this.pen.lineTo(x + shift + span / 2, (low + high) / 2);
      }
      this.pen.moveTo(x + shift + span / 2, low + 0.5);
      this.pen.lineTo(x + shift + span / 2, high - 0.5);
      this.pen.stroke();
    }
  }

  /** Draw the most probable mode, and the verdicts. @param {number} now @param {number} x @param {number} width */
  #lanes(now, x, width) {
    const { store } = /** @type {Look} */ (this.look);
    const [lane, bits] = [LANE * devicePixelRatio, store.verdicts[now * store.channels + this.channel]];
    for (const [k, place] of this.modes.entries()) {
      const share = store.probability[now * store.modes + place];
      if (!(share > 0.5)) continue;
      this.pen.globalAlpha = share;
      this.pen.fillStyle = colour(other(k))();
      this.pen.fillRect(x, this.paper.height - 2 * lane, width, lane - devicePixelRatio);
      this.pen.globalAlpha = 1;
    }
    if (!bits) return;
    this.pen.fillStyle = colour(other(31 - Math.clz32(bits)))();
    this.pen.fillRect(x, this.paper.height - lane, Math.max(width, 2 * devicePixelRatio), lane);
  }
}

/** @param {number} a @param {number} b */
const mod = (a, b) => ((a % b) + b) % b;
/** Return the width for the view and for bins that extend beyond it on both sides. @param {number} width @param {Look} look */
const roomFor = (width, look) => width + 4 * Math.ceil(look.each * look.perRow) + 8;
