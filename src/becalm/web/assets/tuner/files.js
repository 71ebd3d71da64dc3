// Lists the files of the folder, uploads dropped files, and saves results.

import { amount, find, make } from "../dom.js";

/** @typedef {{ id: string, name: string, bytes: number, changed: number | string }} Listed */

export class Files {
  /**
   * @param {(file: string) => void} opened called with the id of the file to open
   * @param {(file: File) => void} dropped called with a file that a person dropped or chose
   * @param {() => void} wanted called when the list is shown, to request a new list
   */
  constructor(opened, dropped, wanted) {
    this.opened = opened;
    this.wanted = wanted;
    this.listed = ""; // the listed files, as JSON
    this.held = false; // whether a person opened the list, so that only a person closes it
    this.place = find("files", HTMLElement);
    this.button = find("show-files", HTMLButtonElement);
    this.chosen = find("chosen", HTMLInputElement);
    this.rate = find("rate", HTMLInputElement);
    this.button.addEventListener("click", () => this.show(this.place.hidden, true));
    this.chosen.addEventListener("change", () => {
      const [file] = this.chosen.files ?? [];
      this.chosen.value = "";
      if (file) dropped(file);
    });
    const over = (/** @type {DragEvent} */ event, /** @type {boolean} */ on) => {
      if (!event.dataTransfer?.types.includes("Files")) return;
      event.preventDefault();
      document.body.classList.toggle("dropping", on);
    };
    addEventListener("dragover", (event) => over(event, true));
    addEventListener("dragleave", (event) => { if (!event.relatedTarget) over(event, false); });
    addEventListener("drop", (event) => {
      over(event, false);
      const [file] = event.dataTransfer?.files ?? [];
      if (file) dropped(file);
    });
  }

  /** Return the rate in Hz for a file without times. @returns {number | null} */
  get rate_hz() {
    return Number(this.rate.value) || null;
  }

  /** Open or close the list, unless a person opened it. @param {boolean} on */
  suggest(on) {
    if (!this.held) this.show(on);
  }

  /** Open or close the list. @param {boolean} on @param {boolean} [held] whether it stays until the person chooses */
  show(on, held = false) {
    this.held = on && held;
    if (on && this.place.hidden) this.wanted();
    if (!on && this.place.contains(document.activeElement)) this.button.focus({ preventScroll: true }); // a hidden element cannot keep the focus
    this.place.hidden = !on;
    this.button.setAttribute("aria-expanded", String(on));
    const first = /** @type {HTMLElement | null} */ (this.place.querySelector("li button"));
    if (on) (first ?? this.chosen).focus({ preventScroll: true });
  }

  /** @param {{ folder: string, files: Listed[], formats: string[], upload_limit: number }} welcome */
  list({ folder, files, formats, upload_limit }) {
    find("files-says", HTMLElement).textContent = files.length
      ? `Choose one of ${folder}, or drop a file anywhere on this page (up to ${amount(upload_limit, "B")}).`
      : `Drop a file anywhere on this page, or choose one; ${folder} has no file that becalm can read.`;
    this.chosen.accept = formats.join(",");
    const listed = JSON.stringify(files);
    if (listed === this.listed) return; // the focus stays on a name
    this.listed = listed;
    find("folder", HTMLElement).replaceChildren(...files.map(({ id, name, bytes }) => {
      const button = make("button", { type: "button", class: "plain" }, name);
      button.addEventListener("click", () => this.opened(id));
      return make("li", {}, button, " ", make("small", {}, amount(bytes, "B")));
    }));
  }
}

/** Return a sentence that says why a request failed. @param {unknown} error */
export const whyNot = (error) => (error instanceof TypeError ? "becalm does not answer; is it still running?" : /** @type {Error} */ (error).message);

/** Send a file to becalm; returns its id. @param {File} file */
export async function upload(file) {
  const answer = await fetch(`/files/${encodeURIComponent(file.name)}`, { method: "PUT", body: file });
  if (!answer.ok) throw new Error(await answer.text());
  return /** @type {string} */ ((await answer.json()).file);
}

/** Request a file from becalm, and save it as a download. @param {string} address */
export async function save(address) {
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(await answer.text());
  const disposition = answer.headers.get("content-disposition") ?? "";
  const [, name] = /filename\*=utf-8''([^;]+)/i.exec(disposition) ?? [];
  const link = make("a", { href: URL.createObjectURL(await answer.blob()), download: decodeURIComponent(name ?? "becalm") });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
  return link.download;
}
