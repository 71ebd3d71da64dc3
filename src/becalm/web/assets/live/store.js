// Stores the newest bins of one level in ring buffers.

/** @typedef {"raw_low" | "raw_high" | "clean_low" | "clean_high" | "sigma"} Field */

/** @type {Field[]} */
const FIELDS = ["raw_low", "raw_high", "clean_low", "clean_high", "sigma"];
export const HELD = 8192;

export class Store {
  /** @param {number} channels @param {number} modes of all channels @param {Store} [like] a store to copy */
  constructor(channels, modes, like) {
    this.channels = channels;
    this.modes = modes;
    /** Number of the bin in each place; -1 if it is empty. @type {Float64Array} */
    this.number = like ? like.number.slice() : new Float64Array(HELD).fill(-1);
    /** @type {Float64Array} */
    this.t = like ? like.t.slice() : new Float64Array(HELD);
    /** @type {Record<Field, Float64Array>} */
    this.values = /** @type {any} */ ({});
    for (const name of FIELDS) this.values[name] = like ? like.values[name].slice() : new Float64Array(HELD * channels);
    /** @type {Uint16Array} */
    this.verdicts = like ? like.verdicts.slice() : new Uint16Array(HELD * channels);
    /** @type {Float32Array} */
    this.probability = like ? like.probability.slice() : new Float32Array(HELD * modes);
  }

  /** Return whether a bin is stored. @param {number} bin */
  has(bin) {
    return bin >= 0 && this.number[bin % HELD] === bin;
  }

  /** Store the bins of a frame. @param {import("../frames.js").Frame} frame */
  put({ header, arrays }) {
    const m = this.channels;
    for (let k = 0; k < header.count; k += 1) {
      const place = (header.first + k) % HELD;
      this.number[place] = header.first + k;
      this.t[place] = arrays.t[k];
      for (const name of FIELDS) {
        const [from, to] = [arrays[name], this.values[name]];
        for (let c = 0; c < m; c += 1) to[place * m + c] = from[k * m + c] + (name === "sigma" ? 0 : header.offset[c]);
      }
      for (let c = 0; c < m; c += 1) this.verdicts[place * m + c] = arrays.verdicts[k * m + c];
      if (arrays.probability)
        for (let j = 0; j < this.modes; j += 1) this.probability[place * this.modes + j] = arrays.probability[k * this.modes + j];
    }
  }

  /** Return the first bin of a range that is not stored, or null. @param {number} first @param {number} stop */
  missing(first, stop) {
    for (let bin = first; bin < stop; bin += 1) if (!this.has(bin)) return bin;
    return null;
  }

  /** Return the minimum and maximum of a channel over some bins, and the minimum of sigma; null without bins. @param {number} channel @param {number} first @param {number} stop */
  range(channel, first, stop) {
    let [low, high, sigma] = [Infinity, -Infinity, Infinity];
    for (let bin = Math.max(0, first); bin < stop; bin += 1) {
      if (!this.has(bin)) continue;
      const at = (bin % HELD) * this.channels + channel;
      for (const name of /** @type {Field[]} */ (["raw_low", "clean_low"])) if (this.values[name][at] < low) low = this.values[name][at];
      for (const name of /** @type {Field[]} */ (["raw_high", "clean_high"])) if (this.values[name][at] > high) high = this.values[name][at];
      if (this.values.sigma[at] < sigma) sigma = this.values.sigma[at];
    }
    return low <= high ? { low, high, sigma: sigma < Infinity ? sigma : 0 } : null;
  }
}
