// A table of any length, of which only the rows in sight are in the page; one of them may be open. It is laid out as
// boxes, so that columns may go where there is no room for them: therefore each part says what it is.

const BEYOND = 12; // rows beyond those in sight, so that a quick hand meets no gap
const MOST_PRINTED = 300;
const PAGE = 10; // rows that a key goes on

/**
 * Make an element with children.
 * @template {keyof HTMLElementTagNameMap} T
 * @param {T} tag
 * @param {string} [kind] its class
 * @param {...(Node | string)} children
 * @returns {HTMLElementTagNameMap[T]}
 */
export function make(tag, kind = "", ...children) {
  const element = document.createElement(tag);
  if (kind) element.className = kind;
  element.append(...children);
  return element;
}

/** @param {string} kind @param {HTMLTableCellElement[]} [cells] */
function row(kind, cells = []) {
  const line = make("tr", kind, ...cells);
  line.role = "row";
  return line;
}

/** @param {string} kind @param {...(Node | string)} children */
export function cell(kind, ...children) {
  const box = make("td", kind, ...children);
  box.role = "gridcell";
  return box;
}

/**
 * @typedef {object} Shown what a table shows
 * @property {{ name: string, kind: string, says?: string }[]} columns
 * @property {(row: number) => HTMLTableCellElement[]} cells
 * @property {(row: number) => Node[]} opened what stands below a row that is open
 * @property {(row: number) => Node[]} printed what stands below a row on paper
 * @property {(column: number) => void} pressed hears of headings
 */

export class Table {
  /** @param {HTMLTableElement} place with a head and a body @param {Shown} shown */
  constructor(place, shown) {
    this.place = place;
    this.shown = shown;
    this.body = place.tBodies[0];
    /** @type {number[]} which rows there are, in their order */
    this.rows = [];
    this.current = 0; // place of the row that keys go to
    this.open = Infinity; // place of the row that is open
    this.height = 0; // pixels of a row, as the style has it
    this.room = 0; // pixels of what stands below the open one
    this.panel = row("opened");
    this.above = make("tr", "space");
    this.below = make("tr", "space");
    this.drawn = ""; // from where to where
    this.headings = shown.columns.map(({ name, kind, says }, i) => {
      const button = make("button", "", name);
      button.type = "button";
      button.title = says ?? "";
      button.addEventListener("click", () => shown.pressed(i));
      const heading = make("th", kind, button);
      heading.role = "columnheader";
      return heading;
    });
    place.tHead?.replaceChildren(row("", this.headings));
    place.addEventListener("keydown", (event) => { if (event.target === place) this.#key(event); });
    this.body.addEventListener("click", (event) => this.#click(/** @type {HTMLElement} */ (event.target)));
    addEventListener("scroll", () => this.#draw(), { passive: true });
    addEventListener("resize", () => this.#draw(true));
    addEventListener("beforeprint", () => this.#print());
    addEventListener("afterprint", () => this.#draw(true));
  }

  /** Tell by which column rows are ordered. @param {number} column @param {boolean} down */
  mark(column, down) {
    this.headings.forEach((one) => one.removeAttribute("aria-sort"));
    this.headings[column].setAttribute("aria-sort", down ? "descending" : "ascending");
  }

  /** Show other rows, or others first. @param {number[]} rows */
  show(rows) {
    this.rows = rows;
    this.current = 0;
    this.open = Infinity;
    this.place.setAttribute("aria-rowcount", String(rows.length + 1));
    if (this.place.getBoundingClientRect().top < 0) this.place.scrollIntoView();
    this.#draw(true);
  }

  /** Open a row, or close it, if it is open. @param {number} at its place */
  toggle(at) {
    this.current = at;
    this.open = this.open === at ? Infinity : at;
    this.panel.replaceChildren(cell("", ...(this.open === at ? this.shown.opened(this.rows[at]) : [])));
    this.#draw(true);
  }

  /** Bring a row into sight, with what is open below it, and keys to it. @param {number} at its place */
  go(at) {
    this.current = Math.max(0, Math.min(this.rows.length - 1, at));
    const { top } = this.body.getBoundingClientRect();
    const [first, last] = [top + this.#top(this.current), top + this.#top(this.current + 1)];
    const least = /** @type {HTMLElement} */ (this.place.tHead).offsetHeight; // which stays in sight
    if (first < least) scrollBy(0, first - least);
    else if (last > innerHeight) scrollBy(0, Math.min(last - innerHeight, first - least));
    this.#draw(true);
  }

  /** How far below the first row another begins. @param {number} at */
  #top(at) {
    return at * this.height + (at > this.open ? this.room : 0);
  }

  /** Which row is so far below. @param {number} y */
  #at(y) {
    return y < (this.open + 1) * this.height ? Math.floor(y / this.height) : Math.max(this.open, Math.floor((y - this.room) / this.height));
  }

  /** Put the rows in sight into the page. @param {boolean} [anew] even if the same are in sight */
  #draw(anew = false) {
    this.height = parseFloat(getComputedStyle(this.place).getPropertyValue("--row"));
    const hidden = Math.max(0, -this.body.getBoundingClientRect().top);
    const within = (/** @type {number} */ at) => Math.max(0, Math.min(this.rows.length, at));
    const [from, to] = [within(this.#at(hidden) - BEYOND), within(this.#at(hidden + innerHeight) + BEYOND)];
    if (!anew && this.drawn === `${from} ${to}`) return;
    this.drawn = `${from} ${to}`;
    const lines = this.rows.slice(from, to).map((row, i) => this.#line(row, from + i));
    if (this.open >= from && this.open < to) lines.splice(this.open - from + 1, 0, this.panel);
    this.body.replaceChildren(this.above, ...lines, this.below);
    this.room = this.panel.isConnected ? this.panel.getBoundingClientRect().height : this.room;
    this.above.style.height = `${this.#top(from)}px`;
    this.below.style.height = `${this.#top(this.rows.length) - this.#top(to)}px`;
    if (document.getElementById(`row-${this.current}`)) this.place.setAttribute("aria-activedescendant", `row-${this.current}`);
    else this.place.removeAttribute("aria-activedescendant");
  }

  /** @param {number} number which row @param {number} at its place */
  #line(number, at) {
    const line = row(at === this.current ? "current" : "", this.shown.cells(number));
    line.id = `row-${at}`;
    line.setAttribute("aria-rowindex", String(at + 2)); // that of the headings is 1
    line.setAttribute("aria-expanded", String(at === this.open));
    return line;
  }

  /** Put the first rows into the page, wherever the reader looks, with what is told of them. */
  #print() {
    const lines = this.rows.slice(0, MOST_PRINTED).flatMap((number, at) => {
      const told = this.shown.printed(number);
      return [this.#line(number, at), ...(told.length ? [row("opened", [cell("", ...told)])] : [])];
    });
    const left = this.rows.length - MOST_PRINTED;
    const more = left > 0 ? [row("opened", [cell("", `And ${left} more, which the page shows on a screen.`)])] : [];
    this.body.replaceChildren(...lines, ...more);
  }

  /** @param {HTMLElement} target */
  #click(target) {
    const line = target.closest("tr");
    const at = Number(line?.ariaRowIndex) - 2;
    if (at >= 0 && !String(getSelection())) this.toggle(at); // who marks words wants to copy them
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const goes = { ArrowDown: 1, ArrowUp: -1, PageDown: PAGE, PageUp: -PAGE, Home: -Infinity, End: Infinity }[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey || !this.rows.length) return;
    if (goes) this.go(this.current + goes);
    else if (event.key === "Enter" || event.key === " ") {
      this.toggle(this.current);
      this.go(this.current);
    } else return;
    event.preventDefault();
  }
}
