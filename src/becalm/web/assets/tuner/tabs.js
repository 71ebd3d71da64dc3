// The tabs of a recording's channels.

import { find, make } from "../dom.js";

export class Tabs {
  /** @param {(channel: number, focus: boolean) => void} chosen */
  constructor(chosen) {
    this.place = find("channels", HTMLElement);
    this.panel = find("signal", HTMLElement);
    this.chosen = chosen;
  }

  /** @param {string[]} names */
  open(names) {
    this.place.replaceChildren(...names.map((name, i) => {
      const tab = make("button", { type: "button", role: "tab", id: `tab-${i}`, "aria-controls": "signal" }, name);
      tab.addEventListener("click", () => this.chosen(i, false));
      tab.addEventListener("keydown", ({ key }) => {
        if (key === "ArrowRight" || key === "ArrowLeft") this.chosen(i + (key === "ArrowRight" ? 1 : -1), true);
      });
      return tab;
    }));
  }

  /** Mark the selected channel. @param {number} channel @param {boolean} focus */
  point(channel, focus) {
    for (const [i, tab] of [...this.place.children].entries()) {
      tab.setAttribute("aria-selected", String(i === channel));
      tab.setAttribute("tabindex", i === channel ? "0" : "-1");
      if (i === channel && focus) /** @type {HTMLElement} */ (tab).focus();
    }
    this.panel.setAttribute("aria-labelledby", `tab-${channel}`);
  }
}
