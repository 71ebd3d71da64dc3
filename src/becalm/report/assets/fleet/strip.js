// Draws a strip for each channel: the noise of each sensor is a dot on a logarithmic axis; equal dots are stacked.

import { colour } from "../colours.js";
import { decade, logarithmic } from "../numbers.js";

const [STACK, AXIS] = [72, 22]; // pixels of height
const [PLACE, DOT, MARK] = [4, 3, 7]; // pixels: distance of neighbouring positions; size of a dot; size of a marked dot
const EDGE = 12; // pixels left and right of the outermost dots
const NEAR = 12; // pixels, the largest distance from which the pointer selects a dot

/** @typedef {{ row: number, value: number, marked: boolean }} Dot */

export class Strip {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Dot[]} dots with values above 0
   * @param {{ pointed: (row: number | null) => void, pressed: (row: number) => void }} handlers
   */
  constructor(canvas, dots, { pointed, pressed }) {
    this.canvas = canvas;
    this.dots = dots;
    this.x = new Float32Array(dots.length);
    this.y = new Float32Array(dots.length);
    const values = dots.map(({ value }) => Math.log(value)).sort((a, b) => a - b);
    const [least, most] = [values[0], values[values.length - 1]];
    const room = most > least ? 0 : Math.LN2; // if all values are equal, the axis still needs a length
    this.range = [least - room, most + room];
    this.width = 0;
    /** @type {number | null} */
    this.pointed = null;
    /** @type {(row: number) => boolean} */
    this.shows = () => true;
    const dotAt = (/** @type {MouseEvent} */ event) => this.#near(event.offsetX, event.offsetY);
    const point = (/** @type {number | null} */ at) => {
      if (at === this.pointed) return;
      this.pointed = at;
      canvas.style.cursor = at === null ? "" : "pointer";
      pointed(at === null ? null : dots[at].row);
      this.paint();
    };
    canvas.addEventListener("pointermove", (event) => point(dotAt(event)));
    canvas.addEventListener("pointerleave", () => point(null));
    canvas.addEventListener("click", (event) => {
      const at = dotAt(event);
      if (at !== null) pressed(dots[at].row);
    });
    new ResizeObserver(() => this.#lay()).observe(canvas);
  }

  /** Return the position of a value on the axis, in pixels. @param {number} value */
  #along(value) {
    const [least, most] = this.range;
    return EDGE + ((Math.log(value) - least) / (most - least)) * (this.width - 2 * EDGE);
  }

  /** Place all dots; dots at the same position are stacked, so closely that the highest stack fits. */
  #lay() {
    const width = this.canvas.clientWidth;
    if (width === this.width || !width) return;
    this.width = width;
    const places = this.dots.map(({ value }) => Math.round(this.#along(value) / PLACE));
    const counts = new Uint32Array(width + PLACE);
    const heights = places.map((place) => (counts[place] += 1) - 1);
    const apart = Math.min(DOT + 1, (STACK - MARK) / Math.max(1, Math.max(...counts) - 1));
    places.forEach((place, i) => {
      this.x[i] = place * PLACE;
      this.y[i] = STACK - MARK / 2 - heights[i] * apart;
    });
    this.canvas.width = width * devicePixelRatio;
    this.canvas.height = (STACK + AXIS) * devicePixelRatio;
    this.paint();
  }

  /** Draw the dots of the selected rows in colour, all other dots faint. @param {(row: number) => boolean} shows */
  show(shows) {
    this.shows = shows;
    this.paint();
  }

  paint() {
    const pen = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    pen.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    pen.clearRect(0, 0, this.width, STACK + AXIS);
    this.#axis(pen);
    const [faint, plain, marked] = [/** @type {number[]} */ ([]), /** @type {number[]} */ ([]), /** @type {number[]} */ ([])];
    this.dots.forEach((dot, i) => (!this.shows(dot.row) ? faint : dot.marked ? marked : plain).push(i));
    for (const [dots, role, size] of /** @type {const} */ ([[faint, "readings", DOT], [plain, "clean", DOT], [marked, "other-0", MARK]])) {
      pen.fillStyle = colour(role)();
      for (const i of dots) pen.fillRect(this.x[i] - size / 2, this.y[i] - size / 2, size, size);
    }
    if (this.pointed === null) return;
    pen.strokeStyle = colour("truth")();
    pen.lineWidth = 2;
    pen.strokeRect(this.x[this.pointed] - MARK / 2 - 1, this.y[this.pointed] - MARK / 2 - 1, MARK + 2, MARK + 2);
  }

  /** @param {CanvasRenderingContext2D} pen */
  #axis(pen) {
    const [low, high] = this.range.map(Math.exp);
    pen.fillStyle = colour("ink")();
    pen.strokeStyle = colour("grid")();
    pen.lineWidth = 1;
    pen.font = "12px system-ui, sans-serif";
    pen.textBaseline = "bottom";
    for (const value of logarithmic(null, 0, low, high)) {
      const [x, words] = [this.#along(value), decade(value)];
      const half = pen.measureText(words).width / 2;
      pen.beginPath();
      pen.moveTo(x, 0);
      pen.lineTo(x, STACK + 4);
      pen.stroke();
      pen.fillText(words, Math.max(0, Math.min(this.width - 2 * half, x - half)), STACK + AXIS);
    }
    pen.beginPath();
    pen.moveTo(0, STACK);
    pen.lineTo(this.width, STACK);
    pen.stroke();
  }

  /** Return the dot nearest to the pointer, or null if none is near. @param {number} x @param {number} y */
  #near(x, y) {
    let [nearest, least] = [/** @type {number | null} */ (null), NEAR ** 2];
    for (let i = 0; i < this.dots.length; i += 1) {
      const distance = (this.x[i] - x) ** 2 + (this.y[i] - y) ** 2;
      if (distance < least) [nearest, least] = [i, distance];
    }
    return nearest;
  }
}
