// A table of any length; the page contains only the visible rows, and one row may be open, with details below it. The
// CSS lays out the table as boxes, so that it can hide columns on a narrow screen. Therefore each part needs an
// explicit role.

const BEYOND = 12; // rows drawn above and below the visible rows, so that fast scrolling shows no gap
const MOST_PRINTED = 300;
const PAGE = 10; // rows that Page Up and Page Down move

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
 * @typedef {object} Shown contents of a table
 * @property {{ name: string, kind: string, says?: string }[]} columns
 * @property {(row: number) => HTMLTableCellElement[]} cells
 * @property {(row: number) => Node[]} opened details below an open row
 * @property {(row: number) => Node[]} printed details below a row on paper
 * @property {(column: number) => void} pressed called after a click on a heading
 */

export class Table {
  /** @param {HTMLTableElement} place with a head and a body @param {Shown} shown */
  constructor(place, shown) {
    this.place = place;
    this.shown = shown;
    this.body = place.tBodies[0];
    /** @type {number[]} the rows of the table, in order */
    this.rows = [];
    this.current = 0; // index in `rows` of the row that has the keyboard focus
    this.open = Infinity; // index in `rows` of the open row; Infinity if no row is open
    this.height = 0; // height of a row in pixels, from the style
    this.room = 0; // height of the details below the open row, in pixels
    this.panel = row("opened");
    this.above = make("tr", "space");
    this.below = make("tr", "space");
    this.drawn = ""; // indices in `rows` of the first drawn row, and of the row after the last
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

  /** Mark the column that the rows are sorted by. @param {number} column @param {boolean} down */
  mark(column, down) {
    this.headings.forEach((one) => one.removeAttribute("aria-sort"));
    this.headings[column].setAttribute("aria-sort", down ? "descending" : "ascending");
  }

  /** Replace the rows of the table. @param {number[]} rows */
  show(rows) {
    this.rows = rows;
    this.current = 0;
    this.open = Infinity;
    this.place.setAttribute("aria-rowcount", String(rows.length + 1));
    if (this.place.getBoundingClientRect().top < 0) this.place.scrollIntoView();
    this.#draw(true);
  }

  /** Open a row, or close it if it is open. @param {number} at its index in `rows` */
  toggle(at) {
    this.current = at;
    this.open = this.open === at ? Infinity : at;
    this.panel.replaceChildren(cell("", ...(this.open === at ? this.shown.opened(this.rows[at]) : [])));
    this.#draw(true);
  }

  /** Make a row current, and scroll so that it and its details are visible. @param {number} at its index in `rows` */
  go(at) {
    this.current = Math.max(0, Math.min(this.rows.length - 1, at));
    const { top } = this.body.getBoundingClientRect();
    const [first, last] = [top + this.#top(this.current), top + this.#top(this.current + 1)];
    const least = /** @type {HTMLElement} */ (this.place.tHead).offsetHeight; // the head stays visible
    if (first < least) scrollBy(0, first - least);
    else if (last > innerHeight) scrollBy(0, Math.min(last - innerHeight, first - least));
    this.#draw(true);
  }

  /** Return the distance from the first row to a row, in pixels. @param {number} at its index in `rows` */
  #top(at) {
    return at * this.height + (at > this.open ? this.room : 0);
  }

  /** Return the index in `rows` of the row at a distance from the first row. @param {number} y in pixels */
  #at(y) {
    return y < (this.open + 1) * this.height ? Math.floor(y / this.height) : Math.max(this.open, Math.floor((y - this.room) / this.height));
  }

  /** Put the visible rows into the page. @param {boolean} [anew] whether to do so if the same rows are visible as before */
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

  /** Make the element of a row. @param {number} number of the row @param {number} at its index in `rows` */
  #line(number, at) {
    const line = row(at === this.current ? "current" : "", this.shown.cells(number));
    line.id = `row-${at}`;
    line.setAttribute("aria-rowindex", String(at + 2)); // the headings have index 1
    line.setAttribute("aria-expanded", String(at === this.open));
    return line;
  }

  /** Put the first rows into the page with their details, for print. */
  #print() {
    const lines = this.rows.slice(0, MOST_PRINTED).flatMap((number, at) => {
      const details = this.shown.printed(number);
      return [this.#line(number, at), ...(details.length ? [row("opened", [cell("", ...details)])] : [])];
    });
    const left = this.rows.length - MOST_PRINTED;
    const more = left > 0 ? [row("opened", [cell("", `And ${left} more, which the page shows on a screen.`)])] : [];
    this.body.replaceChildren(...lines, ...more);
  }

  /** @param {HTMLElement} target */
  #click(target) {
    const line = target.closest("tr");
    const at = Number(line?.ariaRowIndex) - 2;
    if (at >= 0 && !String(getSelection())) this.toggle(at); // a reader who selects text wants to copy it
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
