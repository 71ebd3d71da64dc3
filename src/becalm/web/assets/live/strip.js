// The strip of a channel: its plot, its figures, its dial.

import { colour, other } from "../colours.js";
import { make, fillTerms } from "../dom.js";
import { even } from "../numbers.js";
import { Dial } from "../tuner/dial.js";
import { VERDICTS } from "../tuner/lanes.js";
import { HELD } from "./store.js";
import { Tape } from "./tape.js";

export const GUTTER = 54; // CSS pixels left of a tape, for numbers

/**
 * Format a number with the digits that its uncertainty allows, and the uncertainty with two digits.
 * @param {number} value @param {number} spread
 */
export function about(value, spread) {
  const [size, fine] = [Math.abs(value), spread > 0 && Number.isFinite(spread)];
  const places = fine ? 1 - Math.floor(Math.log10(spread)) : size >= 1e-3 ? 4 : 4 - Math.floor(Math.log10(size || 1));
  const far = places > 9 || Math.max(size, fine ? spread : 0) >= 1e12;
  const written = (/** @type {number} */ one) => {
    const digits = far ? Math.floor(Math.log10(Math.abs(one) || 1)) + places : places;
    const words = far && one ? one.toExponential(Math.max(0, Math.min(20, digits))).replace("e+", "e") : one.toFixed(far ? 0 : Math.max(0, places));
    return words.replaceAll("-", "−");
  };
  return [Number.isFinite(value) ? written(value) : "–", Number.isFinite(spread) ? ` ± ${written(spread)}` : ""];
}

/** @typedef {import("./store.js").Store} Store */
/** @typedef {{ store: Store, each: number, perRow: number, right: number, newest: number, ticks: [number, string][] }} Scene */

export class Strip {
  /**
   * @param {number} number @param {string} name @param {string} unit
   * @param {[string, number][]} modes names of the modes, and the places of their probabilities
   * @param {(density: number) => number | null} requestDensity requests a density; returns the number of the request
   */
  constructor(number, name, unit, modes, requestDensity) {
    this.number = number;
    this.unit = unit;
    this.name = unit && name.endsWith(` (${unit})`) ? name.slice(0, -unit.length - 3) : name;
    this.modes = modes;
    const [value, met] = [`value-${number}`, `met-${number}`]; // screen readers would repeat a changing label without end
    this.canvas = make("canvas", { tabindex: 0, role: "img", "aria-label": this.name, "aria-describedby": `${value} ${met}`, "aria-keyshortcuts": String(number + 1) });
    this.pen = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    this.tape = new Tape(number, modes.map(([, place]) => place));
    this.value = make("output", { id: value, "aria-live": "off" });
    this.figures = make("dl");
    this.met = make("p", { id: met, class: "met" });
    const range = make("input", { type: "range", min: 0, step: "any", "aria-label": `${this.name}: from faster to smoother`, disabled: true });
    /** Number of the last change while it has no answer; messages before the answer describe older settings. @type {number | null} */
    this.pending = null;
    /** @type {[any, any]} */
    this.known = [null, null];
    const turn = (/** @type {number} */ density, /** @type {boolean} */ final) => {
      if (!final) return;
      this.pending = requestDensity(density);
      if (this.pending === null) this.dropChange();
    };
    this.dial = new Dial(turn, range, this.figures);
    this.ends = make("div", { class: "ends" }, make("span", {}, "faster"), make("span", {}, "smoother"));
    const title = make("h2", { id: `name-${number}`, title: this.name }, this.name);
    const side = make("div", {}, make("header", {}, title, this.value), this.figures, range, this.ends, this.met);
    this.element = make("section", { class: "strip", "aria-labelledby": title.id }, this.canvas, side);
    /** @type {{ low: number, high: number } | null} */
    this.scale = null;
    /** Position of the pointer in CSS pixels from the left. @type {number | null} */
    this.pointed = null;
  }

  /** Fit the canvas to its element. */
  fit() {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((one) => Math.max(1, Math.round(one * devicePixelRatio)));
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
  }

  /** Set the limits of the y axis: widen them at once, narrow them only if the signal fills less than half. @param {Scene} scene */
  rescale({ store, each, perRow, right, newest }) {
    const rows = (this.canvas.width - GUTTER * devicePixelRatio) / perRow;
    const found = store.range(this.number, Math.floor((right - rows) / each), Math.min(newest, Math.ceil(right / each)));
    if (!found) return;
    const size = Math.max(found.high - found.low, 4 * found.sigma, 1e-9 * Math.max(Math.abs(found.low), Math.abs(found.high))) || 1;
    const mine = this.scale;
    if (mine && found.low >= mine.low && found.high <= mine.high && size > 0.45 * (mine.high - mine.low)) return;
    const [middle, half] = [(found.low + found.high) / 2, 0.65 * size];
    this.scale = { low: middle - half, high: middle + half };
  }

  /** @param {Scene} scene */
  draw({ store, each, perRow, right, newest, ticks }) {
    const { pen, canvas } = this;
    const left = Math.round(GUTTER * devicePixelRatio);
    const box = { left, width: canvas.width - left, height: canvas.height };
    pen.clearRect(0, 0, canvas.width, canvas.height);
    if (!this.scale || box.width < 1) return;
    pen.fillStyle = colour("grid")();
    for (const [x] of ticks) pen.fillRect(left + Math.round(x), 0, 1, canvas.height);
    this.#values(left);
    this.tape.show(pen, box, { store, each, perRow, ...this.scale }, Math.floor(right * perRow), newest);
    if (this.pointed === null) return;
    pen.fillStyle = colour("faint")();
    pen.fillRect(Math.round(this.pointed * devicePixelRatio), 0, 1, canvas.height);
  }

  /** Draw lines and numbers at round values. @param {number} left */
  #values(left) {
    const { low, high } = /** @type {{ low: number, high: number }} */ (this.scale);
    const { pen, canvas } = this;
    const plain = this.tape.plain(canvas.height);
    const rough = ((high - low) * 34 * devicePixelRatio) / plain;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * ([1, 2, 5, 10].find((times) => times * power >= rough) ?? 10);
    pen.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let k = Math.ceil(low / step); k * step <= high; k += 1) {
      const y = plain * (1 - (k * step - low) / (high - low));
      pen.fillStyle = colour("grid")();
      pen.fillRect(left, Math.round(y), canvas.width - left, 1);
      pen.fillStyle = colour("faint")();
      if (y > 7 * devicePixelRatio && y < canvas.height - 7 * devicePixelRatio)
        pen.fillText(even(k * step, step).replaceAll("-", "−"), left - 6 * devicePixelRatio, y, left - 8 * devicePixelRatio); // long numbers are narrowed, not cut
    }
  }

  /** Show the numbers of a bin. @param {Store} store @param {number} bin */
  showNumbers(store, bin) {
    if (!store.has(bin)) {
      if (this.pointed !== null) this.value.textContent = "–";
      return;
    }
    const at = (bin % HELD) * store.channels + this.number;
    const [clean, sigma] = [(store.values.clean_low[at] + store.values.clean_high[at]) / 2, 2 * store.values.sigma[at]];
    const [words, spread] = about(clean, sigma);
    this.value.replaceChildren(words, make("small", { title: "twice the standard uncertainty" }, `${spread} ${this.unit}`));
    const shares = this.modes.map(([name, place]) => `${name} ${Math.round(100 * store.probability[(bin % HELD) * store.modes + place])} %`);
    for (const [k, place] of this.met.querySelectorAll("[data-mode]").entries()) place.textContent = shares[k];
  }

  /** Show the status of the channel. @param {{ verdicts: Record<string, number>, nis: number | null, alarms: string[] }} health */
  showHealth({ verdicts, nis, alarms }) {
    /** @param {string} role @param {string} words @param {boolean} [mode] */
    const swatch = (role, words, mode = false) => {
      const mark = make("i");
      mark.style.setProperty("--mark", `var(--${role})`);
      return make("span", {}, mark, make("span", mode ? { "data-mode": true } : {}, words));
    };
    const met = VERDICTS.map((name, bit) => ({ name, bit, count: verdicts[name] ?? 0 })).filter(({ bit, count }) => bit && count);
    const parts = [
      ...this.modes.map(([name], k) => swatch(other(k), name, true)),
      ...alarms.map((words) => make("span", { class: "bad" }, words)),
      make("span", { title: "normalised innovation squared; 1 is right" }, `NIS ${nis === null ? "–" : nis.toFixed(2)}`),
      ...met.map(({ name, bit, count }) => swatch(other(bit), `${count.toLocaleString("en")} ${name}`)),
    ];
    this.met.replaceChildren(...parts);
  }

  /** Drop the last change, and show the last known filter. */
  dropChange() {
    this.pending = null;
    this.tune(...this.known);
  }

  /** Handle the answer to a change. @param {number | null} number @param {boolean} taken whether the change was accepted */
  answered(number, taken) {
    if (this.pending === null || number === null || number < this.pending) return;
    if (taken) this.pending = null;
    else this.dropChange();
  }

  /** Show the filter and its dial. @param {any} filter @param {any} dial */
  tune(filter, dial) {
    this.known = [filter, dial];
    if (this.pending !== null) return;
    this.dial.lay(dial ?? null, this.unit);
    this.dial.input.hidden = this.ends.hidden = !dial;
    if (dial) this.dial.point(dial.at);
    if (!filter) return;
    if (dial) this.dial.show(filter);
    else fillTerms(this.figures, [["filter", filter.says]]);
  }
}

