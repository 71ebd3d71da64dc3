// The plot of raw and clean values over time; the old picture is stretched until a new one arrives.

import { axisOf, roomFor, roomy } from "../axes.js";
import { colour, translucent } from "../colours.js";
import { alone, legend } from "../figures.js";
import { gapped } from "../frames.js";

/**
 * @typedef {{ from: number, to: number }} View seconds since the first row
 * @typedef {import("../frames.js").Frame} Frame
 */

const FEW = 150; // up to this number of values, points are drawn in addition to lines
const NEAREST = 3; // minimum number of rows in view
const COLUMNS = ["raw_low", "raw_high", "band_low", "band_high", "clean_low", "clean_high", "classic_low", "classic_high"];

export class SignalPlot {
  /**
   * @param {HTMLElement} place a figure with a .canvas and a .legend
   * @param {(view: View) => void} looked called after each change of the view or its size
   */
  constructor(place, looked) {
    this.canvas = /** @type {HTMLElement} */ (place.querySelector(".canvas"));
    this.names = /** @type {HTMLElement} */ (place.querySelector(".legend"));
    this.looked = looked;
    /** @type {View} */
    this.all = { from: 0, to: 1 };
    this.view = this.all;
    this.step = 1;
    /** @type {uPlot | null} */
    this.u = null;
    /** @type {() => void} */
    this.drawn = () => {};
    new ResizeObserver(() => this.#resize()).observe(this.canvas);
  }

  /** Return the maximum number of stretches of a picture. */
  get width() {
    return Math.min(4000, Math.max(100, Math.round((this.canvas.clientWidth - 90) * Math.min(devicePixelRatio, 2))));
  }

  /**
   * Start with a channel; the view stays.
   * @param {{ name: string, unit: string }} channel
   * @param {{ rate_hz: number, lasts_s: number }} recording
   */
  open({ name, unit }, { rate_hz, lasts_s }) {
    this.step = 1 / rate_hz;
    this.all = { from: 0, to: Math.max(lasts_s, NEAREST * this.step) };
    this.u?.destroy();
    this.names.replaceChildren();
    this.canvas.setAttribute("aria-label", `${name} over time. Left and right move in time, plus and minus zoom, 0 shows all.`);
    const label = unit && !name.endsWith(`(${unit})`) ? `${name} (${unit})` : name;
    this.u = new uPlot(this.#options(label), [[], ...COLUMNS.map(() => [])], this.canvas);
    const update = legend(this.u, [
      { name: "readings", role: "readings", columns: [1, 2] },
      { name: "±2 sigma", role: "clean-band", columns: [3, 4] },
      { name: "clean", role: "clean", columns: [5, 6] },
      { name: "", role: "other-0", columns: [7, 8] },
    ], this.names);
    this.u.hooks.setCursor = [update];
    this.#gestures(this.u.over);
  }

  /** Draw a picture. @param {Frame} frame */
  show({ header, arrays }) {
    const { u } = this;
    if (!u) return;
    const columns = COLUMNS.map((name) => (arrays[name] ? gapped(arrays[name]) : new Array(arrays.t.length).fill(null)));
    const last = /** @type {HTMLElement} */ (this.names.lastElementChild);
    last.hidden = !header.classic;
    /** @type {ChildNode} */ (last.firstChild).textContent = header.classic ?? "";
    u.batch(() => {
      u.setData([Array.from(arrays.t), ...columns], false);
      u.setScale("x", { min: this.view.from, max: this.view.to });
    });
  }

  /** Show a time span, moved into the record. @param {number} from seconds @param {number} to seconds */
  look(from, to) {
    const span = Math.min(this.all.to - this.all.from, Math.max(to - from, NEAREST * this.step));
    const middle = (from + to) / 2;
    const begin = Math.max(this.all.from, Math.min(middle - span / 2, this.all.to - span));
    this.view = { from: begin, to: begin + span };
    this.u?.setScale("x", { min: this.view.from, max: this.view.to });
    this.looked(this.view);
  }

  /** Zoom around a point, by default the middle. @param {number} times @param {number} [share] of the width */
  zoom(times, share = 0.5) {
    const { from, to } = this.view;
    const [about, span] = [from + share * (to - from), (to - from) * times];
    this.look(about - share * span, about + (1 - share) * span);
  }

  /** Move in time by a share of the view. @param {number} share */
  pan(share) {
    const by = share * (this.view.to - this.view.from);
    this.look(this.view.from + by, this.view.to + by);
  }

  whole() {
    this.look(this.all.from, this.all.to);
  }

  /** Return whether the whole record is in view. */
  get isWhole() {
    return this.view.to - this.view.from >= this.all.to - this.all.from;
  }

  /** @param {string} label @returns {uPlot.Options} */
  #options(label) {
    const few = (/** @type {uPlot} */ u, /** @type {number} */ i) => (u.data[0].length <= FEW ? null : alone(u, i));
    const dots = (/** @type {string} */ role, size = 4) => ({ show: true, size, fill: colour(role), width: 0, filter: few });
    const line = (/** @type {string} */ role, width = 1) => ({ stroke: colour(role), width, points: dots(role) });
    const raw = { ...line("readings"), points: dots("readings", 5) };
    const band = { stroke: "transparent", points: { show: false } };
    const band_fill = (/** @type {number} */ low, /** @type {uPlot.Band["fill"]} */ fill) => /** @type {uPlot.Band} */ ({ series: [low + 1, low], fill });
    return {
      width: this.canvas.clientWidth,
      height: this.canvas.clientHeight,
      legend: { show: false },
      scales: { x: { time: false, auto: false }, y: roomy },
      axes: [axisOf({ label: "time since the first row (s)" }, { size: 34 }), axisOf({ label }, { size: roomFor(72) })],
      series: [{}, raw, raw, band, band, line("clean", 1.5), line("clean", 1.5), line("other-0"), line("other-0")],
      bands: [band_fill(1, colour("readings")), band_fill(3, translucent("clean")), band_fill(5, colour("clean")), band_fill(7, colour("other-0"))],
      cursor: {
        drag: { x: true, y: false, setScale: false },
        points: { show: false },
        bind: { dblclick: () => () => { this.whole(); return null; }, mousedown: (u, over, begin) => (event) => (event.shiftKey ? null : begin(event)) },
      },
      hooks: {
        draw: [() => this.drawn()],
        setSelect: [
          (u) => {
            const { left, width } = u.select;
            if (!width) return;
            const [from, to] = [u.posToVal(left, "x"), u.posToVal(left + width, "x")];
            u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
            this.look(from, to);
          },
        ],
      },
    };
  }

  #resize() {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!this.u || !width || (this.u.width === width && this.u.height === height)) return;
    this.u.setSize({ width, height });
    this.looked(this.view);
  }

  /** Handle the wheel, shift-drag and two fingers. @param {HTMLElement} over */
  #gestures(over) {
    const share = (/** @type {number} */ x) => (x - over.getBoundingClientRect().left) / over.clientWidth;
    over.addEventListener("wheel", (event) => {
      event.preventDefault();
      const sideways = event.shiftKey ? event.deltaY || event.deltaX : event.deltaX;
      if (Math.abs(sideways) > Math.abs(event.deltaY) || event.shiftKey) this.pan(sideways / over.clientWidth);
      else this.zoom(Math.exp(Math.max(-0.7, Math.min(0.7, event.deltaY * (event.deltaMode ? 0.1 : 0.003)))), share(event.clientX));
    }, { passive: false });
    /** @type {Map<number, number>} */
    const down = new Map(); // x of each pointer that is down
    over.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "touch" && !event.shiftKey) return;
      down.set(event.pointerId, event.clientX);
      over.setPointerCapture(event.pointerId);
    });
    over.addEventListener("pointermove", (event) => {
      if (!down.has(event.pointerId)) return;
      const before = [...down.values()];
      down.set(event.pointerId, event.clientX);
      if (event.pointerType === "touch" && down.size < 2) return;
      const now = [...down.values()];
      const mean = (/** @type {number[]} */ places) => places.reduce((sum, place) => sum + place, 0) / places.length;
      this.pan((mean(before) - mean(now)) / over.clientWidth);
      const apart = (/** @type {number[]} */ [one, another]) => Math.max(20, Math.abs(one - another));
      if (down.size === 2) this.zoom(apart(before) / apart(now), share(mean(now)));
    });
    for (const end of /** @type {const} */ (["pointerup", "pointercancel"]))
      over.addEventListener(end, (event) => down.delete(event.pointerId));
  }
}
