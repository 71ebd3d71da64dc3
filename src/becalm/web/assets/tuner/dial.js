// The dial from faster to smoother: it sets the process noise density, and shows the bandwidth, lag and noise.

import { amount, find, fillTerms } from "../dom.js";

/**
 * @typedef {{ process_noise_density: ArrayLike<number>, bandwidth_hz: ArrayLike<number>, lag_s: ArrayLike<number>, noise_left: ArrayLike<number> }} Positions
 * @typedef {{ bandwidth_hz?: number | null, lag_s?: number | null, noise_left?: number | null, noise_std?: number | null }} Filter
 */

export class Dial {
  /**
   * @param {(density: number, final: boolean) => void} turned
   * @param {HTMLInputElement} input @param {HTMLElement} figures element for the figures
   */
  constructor(turned, input = find("dial", HTMLInputElement), figures = find("dial-says", HTMLElement)) {
    this.input = input;
    this.figures = figures;
    this.turned = turned;
    this.unit = "";
    this.held = false;
    this.otherNoise = 0; // noise variance that passes through tones and other components; the positions do not include it
    this.noise = 0; // standard deviation of the noise of a reading
    /** @type {Positions | null} */
    this.positions = null;
    let repeats = false; // whether a key is held down, so that the browser repeats its event
    this.release = (/** @type {Event} */ event) => {
      if (event instanceof KeyboardEvent && event.repeat) return;
      repeats = false;
      if (this.held) this.#turn(true);
    };
    this.input.addEventListener("keydown", ({ repeat }) => {
      repeats = repeat;
      if (repeat) this.#hold();
    });
    this.input.addEventListener("input", () => this.#turn(false));
    this.input.addEventListener("change", () => this.#turn(!repeats));
  }

  /**
   * Set the positions of the dial; null for a channel without a kinematic model.
   * @param {Positions | null} positions
   * @param {string} unit
   */
  lay(positions, unit) {
    this.positions = positions;
    this.unit = unit;
    this.input.disabled = !positions;
    this.input.max = String(positions ? positions.process_noise_density.length - 1 : 1);
    if (positions) return;
    this.otherNoise = 0;
    this.say({});
  }

  /** Show the position of a tuning, unless the person holds the dial. @param {number | null} density */
  point(density) {
    if (this.held || !this.positions || !density) return;
    const all = Array.from(this.positions.process_noise_density, Math.log);
    const wanted = Math.log(density);
    const after = all.findIndex((one) => one <= wanted); // densities fall from fast to smooth
    const place = after > 0 ? after - 1 + (all[after - 1] - wanted) / (all[after - 1] - all[after]) : after === 0 ? 0 : all.length - 1;
    this.input.value = String(place);
    this.#sayHere();
  }

  /** Turn by some positions for a pressed key; the change is final when the key is released. @param {number} by */
  step(by) {
    if (this.input.matches(":disabled")) return;
    this.input.value = String(Number(this.input.value) + by);
    this.#turn(false);
    this.#hold();
  }

  /** Make the change final when the key is released, before another key acts. */
  #hold() {
    for (const event of ["keydown", "keyup", "blur"]) addEventListener(event, this.release, { once: true, capture: true });
  }

  /**
   * Show the figures of the filter in the picture, with the bandwidth at the dial's position.
   * @param {Filter} filter
   */
  show(filter) {
    if (this.held) return;
    const { noise_left, noise_std } = filter;
    this.noise = noise_std ?? 0;
    if (this.positions) {
      this.otherNoise = Math.max(0, (noise_left ?? 0) ** 2 - this.#at(this.positions.noise_left) ** 2);
      this.say({ ...filter, bandwidth_hz: this.#at(this.positions.bandwidth_hz) });
    } else this.say(filter);
  }

  /** @param {Filter} filter */
  say({ bandwidth_hz, lag_s, noise_left }) {
    const down = noise_left && this.noise ? -20 * Math.log10(noise_left / this.noise) : null;
    const words = { bandwidth: amount(bandwidth_hz, "Hz"), lag: lag_s === 0 ? "none" : amount(lag_s, "s"), "noise left": amount(noise_left, this.unit), "noise down": amount(down, "dB") };
    fillTerms(this.figures, Object.entries(words));
    this.input.setAttribute("aria-valuetext", Object.entries(words).map(([term, value]) => `${term} ${value}`).join(", "));
  }

  /** @param {boolean} final */
  #turn(final) {
    if (!this.positions) return;
    this.held = !final;
    this.#sayHere();
    this.turned(this.#at(this.positions.process_noise_density), final);
  }

  #sayHere() {
    if (!this.positions) return;
    const { bandwidth_hz, lag_s, noise_left } = this.positions;
    this.say({ bandwidth_hz: this.#at(bandwidth_hz), lag_s: this.#at(lag_s), noise_left: Math.hypot(this.#at(noise_left), Math.sqrt(this.otherNoise)) });
  }

  /** Interpolate the values at the positions, in logarithms where they are positive. @param {ArrayLike<number>} values */
  #at(values) {
    const place = Math.max(0, Math.min(values.length - 1, Number(this.input.value)));
    const before = Math.min(Math.floor(place), Math.max(0, values.length - 2));
    const [low, high, share] = [values[before], values[before + 1] ?? values[before], place - before];
    if (share === 0 || low === high) return low;
    return low > 0 && high > 0 ? low ** (1 - share) * high ** share : low + share * (high - low);
  }
}
