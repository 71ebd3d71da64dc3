// What the whole record says about a filter: a verdict in words, numbers, and figures.

import { find, make, say, tell } from "../dom.js";
import { decode, draw } from "../figures.js";

/**
 * @typedef {object} Judged
 * @property {string} tone
 * @property {string} says
 * @property {string} words
 * @property {[string, string][]} numbers
 * @property {import("../figures.js").Payload} payload
 */

/** @type {Record<string, string>} */
const SIGNS = { fits: "✓", except: "!", not: "✗" };

export class Verdict {
  constructor() {
    this.place = find("verdict", HTMLElement);
    this.figures = find("figures", HTMLElement);
    /** @type {uPlot[]} */
    this.plots = [];
  }

  /** Say that it is not known yet; figures of before stay, faint. */
  wait() {
    this.place.className = "verdict";
    this.place.textContent = "Judging the whole record …";
    this.figures.classList.add("stale");
  }

  /** @param {Judged} judged */
  show({ tone, says, words, numbers, payload }) {
    this.place.className = `verdict ${tone}`;
    this.place.textContent = [SIGNS[tone], says].filter(Boolean).join(" ");
    say(find("words", HTMLElement), words);
    tell(find("numbers", HTMLElement), numbers);
    this.clear();
    const arrays = payload.arrays.map(decode);
    const map = find("map", HTMLElement);
    for (const figure of payload.figures) {
      const place = frameOf(figure.title, `${figure.title}, ${figure.y.label} over ${figure.x.label}`);
      map.before(place);
      this.plots.push(draw(figure, arrays, place));
    }
  }

  clear() {
    for (const u of this.plots.splice(0)) {
      const place = u.root.closest("figure");
      u.destroy();
      place?.remove();
    }
    this.figures.classList.remove("stale");
  }
}

/** A figure's frame, as `draw` wants it. @param {string} title @param {string} label */
function frameOf(title, label) {
  const reset = make("button", { type: "button", class: "reset", hidden: true }, "Whole");
  const header = make("header", {}, make("h3", {}, title), make("div", { class: "legend" }), reset);
  return make("figure", {}, header, make("div", { class: "canvas", role: "img", "aria-label": label }));
}
