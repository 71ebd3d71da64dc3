// The map of the prediction cost of each noise and density; click, drag or use the arrow keys to tune.

import { axisOf, roomFor } from "../axes.js";
import { colour } from "../colours.js";
import { amount, find, write } from "../dom.js";
import { clipped } from "../figures.js";

/**
 * @typedef {{ noise_std: number[], process_noise_density: number[], best: [number, number], here: [number, number],
 *   density_unit: string }} Grid
 * @typedef {{ noise_std: number, process_noise_density: number }} Tuning
 */

const LEVELS = [0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1, 3]; // nats per reading
const SHADES = [1, 0.86, 0.72, 0.58, 0.45, 0.33, 0.22, 0.12, 0.04];

export class CostMap {
  /** @param {(tuning: Tuning, final: boolean) => void} turned */
  constructor(turned) {
    this.canvas = /** @type {HTMLElement} */ (find("map", HTMLElement).querySelector(".canvas"));
    this.caption = find("map-says", HTMLElement);
    this.turned = turned;
    /** @type {{ grid: Grid, cost: ArrayLike<number>, unit: string, image: HTMLCanvasElement } | null} */
    this.map = null;
    /** @type {Tuning | null} */
    this.here = null;
    /** @type {uPlot | null} */
    this.u = null;
    this.canvas.addEventListener("keydown", (event) => this.#walk(event));
    this.canvas.addEventListener("keyup", (event) => { if (event.key.startsWith("Arrow")) this.#release(); });
    new ResizeObserver(() => this.u?.setSize({ width: this.canvas.clientWidth, height: this.canvas.clientHeight })).observe(this.canvas);
  }

  clear() {
    this.u?.destroy();
    this.u = this.map = null;
    this.caption.textContent = "";
  }

  /** Show why there is no map. @param {string} why */
  refuse(why) {
    this.clear();
    this.caption.textContent = why;
  }

  /** @param {Grid} grid @param {ArrayLike<number>} cost row by row @param {string} unit */
  show(grid, cost, unit) {
    this.clear();
    this.map = { grid, cost, unit, image: document.createElement("canvas") };
    this.#paint();
    const [low, high] = [edgesOf(grid.noise_std), edgesOf(grid.process_noise_density)];
    this.u = new uPlot({
      width: this.canvas.clientWidth,
      height: this.canvas.clientHeight,
      legend: { show: false },
      scales: { x: { time: false, distr: 3, range: low }, y: { distr: 3, range: high } },
      axes: [
        axisOf({ label: unit ? `noise of a reading (${unit})` : "noise of a reading", log: true }, { size: 34, grid: { show: false } }),
        axisOf({ label: `process noise density (${grid.density_unit})`, log: true }, { size: roomFor(52), grid: { show: false } }),
      ],
      series: [{}, { stroke: "transparent", points: { show: false } }],
      cursor: { drag: { x: false, y: false }, points: { show: false } },
      hooks: { drawClear: [(u) => this.#image(u)], draw: [(u) => this.#marks(u)] },
    }, [[low[0], low[1]], [high[0], high[1]]], this.canvas);
    this.#pointer(this.u.over);
    this.point({ noise_std: grid.here[0], process_noise_density: grid.here[1] });
  }

  /** Mark the present tuning. @param {Tuning} tuning */
  point(tuning) {
    this.here = tuning;
    this.u?.redraw(false, false);
    if (this.map) this.#say(tuning);
  }

  /** Draw again in the colours of the current theme. */
  redraw() {
    this.#paint();
    this.u?.redraw(false, true);
  }

  /** @param {Tuning} tuning */
  #say({ noise_std, process_noise_density }) {
    if (!this.map) return;
    const { grid, cost, unit } = this.map;
    const [i, j] = [nearest(grid.noise_std, noise_std), nearest(grid.process_noise_density, process_noise_density)];
    const worse = cost[i * grid.process_noise_density.length + j];
    const quality = worse < 0.001 ? "as well as at best" : `${amount(worse, "nats")} worse than at best`;
    write(this.caption, `Here (ring): noise ${amount(noise_std, unit)}, density ${amount(process_noise_density, grid.density_unit)}; each reading is predicted ${quality} (cross). The stronger the colour, the better.`);
    this.canvas.setAttribute("aria-label", `Cost of every noise and density; arrow keys tune. ${this.caption.textContent}`);
  }

  /** Paint one pixel for each cell; cells that predict better get a stronger colour. */
  #paint() {
    if (!this.map) return;
    const { grid: { noise_std, process_noise_density }, cost, image } = this.map;
    [image.width, image.height] = [noise_std.length, process_noise_density.length];
    const pen = /** @type {CanvasRenderingContext2D} */ (image.getContext("2d"));
    pen.fillStyle = colour("clean")();
    for (let i = 0; i < image.width; i += 1)
      for (let j = 0; j < image.height; j += 1) {
        const level = LEVELS.findIndex((one) => cost[i * image.height + j] < one);
        pen.globalAlpha = SHADES.at(level) ?? 0; // level -1, a cost above all levels, gets the last and faintest shade
        pen.fillRect(i, image.height - 1 - j, 1, 1);
      }
  }

  /** @param {uPlot} u */
  #image(u) {
    if (!this.map) return;
    const { left, top, width, height } = u.bbox;
    u.ctx.imageSmoothingEnabled = false;
    u.ctx.drawImage(this.map.image, left, top, width, height);
  }

  /** @param {uPlot} u */
  #marks(u) {
    if (!this.map) return;
    const { grid } = this.map;
    const place = (/** @type {number} */ x, /** @type {number} */ y) => [u.valToPos(x, "x", true), u.valToPos(y, "y", true)];
    const [bestX, bestY] = place(grid.noise_std[grid.best[0]], grid.process_noise_density[grid.best[1]]);
    const [hereX, hereY] = place(this.here?.noise_std ?? grid.here[0], this.here?.process_noise_density ?? grid.here[1]);
    const size = 6 * devicePixelRatio;
    clipped(u, () => {
      const path = new Path2D();
      path.moveTo(bestX - size, bestY); path.lineTo(bestX + size, bestY);
      path.moveTo(bestX, bestY - size); path.lineTo(bestX, bestY + size);
      path.moveTo(hereX + 1.4 * size, hereY);
      path.arc(hereX, hereY, 1.4 * size, 0, 2 * Math.PI);
      for (const [stroke, width] of /** @type {const} */ ([["paper", 5], ["ink", 2]])) {
        u.ctx.strokeStyle = colour(stroke)();
        u.ctx.lineWidth = width * devicePixelRatio;
        u.ctx.stroke(path);
      }
    });
  }

  /** @param {HTMLElement} over */
  #pointer(over) {
    const turn = (/** @type {PointerEvent} */ event, /** @type {boolean} */ final) => {
      if (!this.u) return;
      const { left, top, width, height } = over.getBoundingClientRect();
      const inside = (/** @type {number} */ place, /** @type {number} */ size) => Math.max(0, Math.min(size, place));
      const tuning = {
        noise_std: this.u.posToVal(inside(event.clientX - left, width), "x"),
        process_noise_density: this.u.posToVal(inside(event.clientY - top, height), "y"),
      };
      this.point(tuning);
      this.turned(tuning, final);
    };
    over.addEventListener("pointerdown", (event) => {
      over.setPointerCapture(event.pointerId);
      turn(event, false);
    });
    over.addEventListener("pointermove", (event) => { if (over.hasPointerCapture(event.pointerId)) turn(event, false); });
    over.addEventListener("pointerup", (event) => turn(event, true));
    over.addEventListener("pointercancel", () => this.#release());
  }

  /** Make the dragged tuning final. */
  #release() {
    if (this.here) this.turned(this.here, true);
  }

  /** @param {KeyboardEvent} event */
  #walk(event) {
    const [right, up] = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [0, 0];
    if (!this.map || !this.here || (!right && !up)) return;
    event.preventDefault();
    event.stopPropagation();
    const { noise_std, process_noise_density } = this.map.grid;
    const tuning = { noise_std: moved(noise_std, this.here.noise_std, right), process_noise_density: moved(process_noise_density, this.here.process_noise_density, up) };
    this.point(tuning);
    this.turned(tuning, false);
  }
}

/** Return the ratio of neighbouring values of a grid. @param {number[]} values */
const ratioOf = (values) => (values.length > 1 ? (values[values.length - 1] / values[0]) ** (1 / (values.length - 1)) : 2);

/** Return the outer edges of a row of cells from the middles of the cells. @param {number[]} values @returns {[number, number]} */
const edgesOf = (values) => [values[0] / Math.sqrt(ratioOf(values)), values[values.length - 1] * Math.sqrt(ratioOf(values))];

/** @param {number[]} values @param {number} from @param {number} by */
const moved = (values, from, by) => Math.min(values[values.length - 1], Math.max(values[0], from * ratioOf(values) ** by));

/** @param {number[]} values @param {number} value */
function nearest(values, value) {
  return Math.max(0, Math.min(values.length - 1, Math.round(Math.log(value / values[0]) / Math.log(ratioOf(values)))));
}
