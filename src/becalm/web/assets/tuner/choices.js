// The controls for the model of a filter, its components, and the mode (smoother, causal filter or fixed lag).

import { find, make } from "../dom.js";

/**
 * @typedef {{ key: string, name: string, evidence: string, order: number | null }} Choice
 * @typedef {{ key: string, name: string, on: boolean }} Part
 * @typedef {{ name: string, unit: string, choices: Choice[], components: Part[] }} Channel
 * @typedef {{ choice: string, order: number | null, noise_std: number | null, process_noise_density: number | null,
 *   on: Record<string, boolean>, unchanged: boolean }} Settings
 */

export class Choices {
  /**
   * @param {(settings: Partial<Settings>) => void} change called with the settings that a person changed
   * @param {(mode: string, lag_s: number | null) => void} setMode called with the mode that a person chose
   */
  constructor(change, setMode) {
    this.change = change;
    this.models = find("choice-list", HTMLElement);
    this.parts = find("part-list", HTMLElement);
    this.cleaned = find("cleaned", HTMLInputElement);
    this.cleaned.addEventListener("change", () => change({ unchanged: !this.cleaned.checked }));
    this.mode = find("mode", HTMLSelectElement);
    this.lag = find("lag", HTMLInputElement);
    this.lagField = find("lag-asked", HTMLElement);
    this.proposed_s = 1; // proposed lag in seconds
    const send = () => setMode(this.mode.value, this.mode.value === "lagged" ? Number(this.lag.value) : null);
    this.mode.addEventListener("change", () => {
      if (this.mode.value === "lagged" && !(Number(this.lag.value) > 0)) this.lag.value = String(Number(this.proposed_s.toPrecision(2)));
      send();
    });
    this.inForce = ""; // the lag in force
    this.lag.addEventListener("change", () => {
      if (Number(this.lag.value) > 0) send();
      else this.lag.value = this.inForce;
    });
  }

  /** Show the models and parts of a channel. @param {Channel} channel */
  open({ choices, components }) {
    this.models.replaceChildren(...choices.map(({ key, name, evidence }) => {
      const input = make("input", { type: "radio", name: "choice", value: key });
      input.addEventListener("change", () => this.change({ choice: key }));
      return make("label", { class: "choice" }, input, make("span", {}, name, " ", make("small", {}, evidence)));
    }));
    this.parts.replaceChildren(...components.map(({ key, name }) => {
      const input = make("input", { type: "checkbox", role: "switch", value: key });
      input.addEventListener("change", () => this.change({ on: this.#on() }));
      return make("label", { class: "choice" }, input, make("span", {}, name));
    }));
    this.cleaned.disabled = !choices.some(({ order }) => order); // a constant or nearly empty channel has no filter
  }

  /** Show the settings in force. @param {Settings} settings */
  point({ choice, on, unchanged }) {
    this.cleaned.checked = !unchanged;
    for (const input of this.models.querySelectorAll("input")) input.checked = input.value === choice;
    for (const input of this.parts.querySelectorAll("input")) input.checked = on[input.value] ?? false;
  }

  /** @param {string} mode @param {number | null} lag_s */
  pointMode(mode, lag_s) {
    this.mode.value = mode;
    this.lagField.hidden = mode !== "lagged";
    if (lag_s) this.lag.value = this.inForce = String(lag_s);
  }

  /** Forget a lag that is not in force, so that one is proposed again: it may be impossible for this recording. */
  forgetLag() {
    if (this.lagField.hidden) this.lag.value = "";
  }

  #on() {
    return Object.fromEntries([...this.parts.querySelectorAll("input")].map(({ value, checked }) => [value, checked]));
  }
}
