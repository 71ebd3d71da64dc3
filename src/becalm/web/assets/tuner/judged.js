// Shows the verdict on a filter over the whole record: a sentence, numbers and figures.

import { find, make, say, fillTerms, write } from "../dom.js";
import { decode, draw } from "../figures.js";

/**
 * @typedef {object} Judged
 * @property {string} tone
 * @property {string} says
 * @property {[string, string][]} numbers
 * @property {import("../figures.js").Payload} payload
 * @property {Record<string, string>} captions by name of the figure
 */

/** @type {Record<string, string>} */
const SIGNS = { fits: "✓", except: "!", not: "✗" };

export class Verdict {
  constructor() {
    this.place = find("verdict", HTMLElement);
    this.figures = find("figures", HTMLElement);
    /** @type {uPlot[]} */
    this.plots = [];
    this.tone = this.says = "";
  }

  /** Show whether the verdict is still being computed; meanwhile the old figures are faint. @param {boolean} waiting */
  wait(waiting) {
    this.figures.classList.toggle("stale", waiting);
    this.place.className = `verdict ${waiting ? "" : this.tone}`;
    const [first, ...more] = waiting ? ["Judging the whole record …"] : this.says.split(/(?<=\.) /);
    write(this.place, first);
    say(find("advice", HTMLElement), more.join(" "));
  }

  /** @param {Judged} judged */
  show({ tone, says, numbers, payload, captions }) {
    this.tone = tone;
    this.says = [SIGNS[tone], says].filter(Boolean).join(" ");
    this.wait(false);
    this.clear();
    fillTerms(find("numbers", HTMLElement), numbers);
    const arrays = payload.arrays.map(decode);
    const map = find("map", HTMLElement);
    for (const figure of payload.figures) {
      if (figure.layers.some(({ kind }) => kind === "lane")) continue; // the lanes below the signal show the verdicts
      const place = frameOf(figure.title, `${figure.title}, ${figure.y.label} over ${figure.x.label}`, captions[figure.name]);
      map.before(place);
      this.plots.push(draw(figure, arrays, place));
    }
  }

  clear() {
    fillTerms(find("numbers", HTMLElement), []);
    for (const u of this.plots.splice(0)) {
      const place = u.root.closest("figure");
      u.destroy();
      place?.remove();
    }
  }
}

/** Make the element that `draw` needs for a figure. @param {string} title @param {string} label @param {string} caption */
function frameOf(title, label, caption) {
  const reset = make("button", { type: "button", class: "reset", hidden: true }, "Whole");
  const header = make("header", {}, make("h3", {}, title), make("div", { class: "legend" }), reset);
  const canvas = make("div", { class: "canvas", role: "img", "aria-label": label });
  return make("figure", {}, header, canvas, make("figcaption", {}, caption));
}
