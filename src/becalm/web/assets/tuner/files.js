// Files: those of the folder, those that are dropped, and what is saved.

import { amount, find, make } from "../dom.js";

/** @typedef {{ id: string, name: string, bytes: number, changed: number | string }} Listed */

export class Files {
  /**
   * @param {(file: string) => void} opened told the id of what is to be opened
   * @param {(file: File) => void} brought told what a person dropped or chose
   * @param {() => void} wanted called where the list is looked at: it may be old
   */
  constructor(opened, brought, wanted) {
    this.opened = opened;
    this.wanted = wanted;
    this.told = ""; // which files are listed
    this.held = false; // a person has opened it
    this.place = find("files", HTMLElement);
    this.button = find("show-files", HTMLButtonElement);
    this.chosen = find("chosen", HTMLInputElement);
    this.rate = find("rate", HTMLInputElement);
    this.button.addEventListener("click", () => this.show(this.place.hidden, true));
    this.chosen.addEventListener("change", () => {
      const [file] = this.chosen.files ?? [];
      this.chosen.value = "";
      if (file) brought(file);
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
      if (file) brought(file);
    });
  }

  /** Readings a second, of a file that does not tell its times. @returns {number | null} */
  get rate_hz() {
    return Number(this.rate.value) || null;
  }

  /** Open or close unless a person has opened it: theirs stays until they choose. @param {boolean} on */
  suggest(on) {
    if (!this.held) this.show(on);
  }

  /** @param {boolean} on @param {boolean} [held] until a person closes it, or chooses */
  show(on, held = false) {
    this.held = on && held;
    if (on && this.place.hidden) this.wanted();
    if (!on && this.place.contains(document.activeElement)) this.button.focus({ preventScroll: true }); // what goes keeps no focus
    this.place.hidden = !on;
    this.button.setAttribute("aria-expanded", String(on));
    const first = /** @type {HTMLElement | null} */ (this.place.querySelector("li button"));
    if (on) (first ?? this.chosen).focus({ preventScroll: true });
  }

  /** @param {{ folder: string, files: Listed[], formats: string[], upload_limit: number }} welcome */
  list({ folder, files, formats, upload_limit }) {
    find("files-says", HTMLElement).textContent = files.length
      ? `Choose one of ${folder}, or drop a file anywhere on this page (up to ${amount(upload_limit, "B")}).`
      : `Drop a file anywhere on this page, or choose one; ${folder} has none that becalm reads.`;
    this.chosen.accept = formats.join(",");
    const told = JSON.stringify(files);
    if (told === this.told) return; // whoever stands on a name stays there
    this.told = told;
    find("folder", HTMLElement).replaceChildren(...files.map(({ id, name, bytes }) => {
      const button = make("button", { type: "button", class: "plain" }, name);
      button.addEventListener("click", () => this.opened(id));
      return make("li", {}, button, " ", make("small", {}, amount(bytes, "B")));
    }));
  }
}

/** Say why a request came to nothing. @param {unknown} error */
export const whyNot = (error) => (error instanceof TypeError ? "becalm does not answer; is it still running?" : /** @type {Error} */ (error).message);

/** Send a file to becalm; returns its id. @param {File} file */
export async function upload(file) {
  const answer = await fetch(`/files/${encodeURIComponent(file.name)}`, { method: "PUT", body: file });
  if (!answer.ok) throw new Error(await answer.text());
  return /** @type {string} */ ((await answer.json()).file);
}

/** Let becalm make a file, and leave it with the browser. @param {string} address */
export async function save(address) {
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(await answer.text());
  const said = answer.headers.get("content-disposition") ?? "";
  const [, name] = /filename\*=utf-8''([^;]+)/i.exec(said) ?? [];
  const link = make("a", { href: URL.createObjectURL(await answer.blob()), download: decodeURIComponent(name ?? "becalm") });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
  return link.download;
}
