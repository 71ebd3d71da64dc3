// The page of a fleet: a table of its sensors, which the user can filter and sort, and strips of their noise.

import { onTheme, readColours } from "../colours.js";
import { COLUMNS, amount, haystack, matching, ordered, share, spaced, traitsOf, unpack } from "./rows.js";
import { Strip } from "./strip.js";
import { Table, cell, make } from "./table.js";

/** @typedef {Parameters<typeof haystack>[0]} Fleet */

const MOST_STRIPS = 6;
const HINT = "Point at a dot to see its sensor; click it to find its row.";

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/** Return the CSS class of the row's first trait whose name is in `names`; "" if there is none. @param {Fleet} fleet @param {number} row @param {string[]} names */
const toneOf = (fleet, row, names) => traitsOf(fleet, row).find(({ name }) => names.includes(name))?.tone ?? "";

/** Make the cells of a row. @param {Fleet} fleet @param {typeof COLUMNS} columns @param {number} row */
function cellsOf(fleet, columns, row) {
  return columns.map(({ kind, text }) => {
    const words = make("bdi", kind === "judged" ? traitsOf(fleet, row)[0].tone : "", text(fleet, row));
    const box = cell(kind, words);
    box.title = words.textContent;
    return box;
  });
}

/** Return the row's reason, judgement and remark as paragraphs. @param {Fleet} fleet @param {number} row */
function sentences(fleet, row) {
  const { reason, says, outlying } = fleet.columns;
  const texts = [
    [reason[row], toneOf(fleet, row, ["refused"])],
    [says[row], toneOf(fleet, row, ["does not fit", "fits except", "fits"])],
    [outlying[row], toneOf(fleet, row, ["outlying"])],
  ];
  return texts.filter(([words]) => words).map(([words, tone]) => make("p", tone, words));
}

/** Return all details of a row as elements. @param {Fleet} fleet @param {number} row */
function all(fleet, row) {
  const { columns } = fleet;
  const details = [
    ["channel", columns.channel[row]],
    ["noise of a reading", amount(columns.noise_std[row], columns.unit[row])],
    ["mean NIS, 1 is right", amount(columns.health[row])],
    ["usable readings", share(columns.usable[row])],
    ["faults", columns.faults[row]],
    ["rows", spaced(columns.rows[row])],
    ["rate", amount(columns.rate_hz[row], "Hz")],
    ["recipe", columns.recipe[row]],
  ];
  const shown = details.filter(([, words]) => words && words !== "–");
  const list = make("dl", "", ...shown.map(([term, words]) => make("div", "", make("dt", "", term), make("dd", "", words))));
  return [make("h3", "", columns.sensor[row]), ...sentences(fleet, row), list];
}

/** Return, for each channel and unit, the rows with known noise; the channel with most rows comes first. @param {Fleet} fleet */
function channelsOf({ columns }) {
  /** @type {Map<string, number[]>} */
  const found = new Map();
  columns.noise_std.forEach((noise, row) => {
    if (noise === null || !(noise > 0)) return;
    const [channel, unit] = [columns.channel[row], columns.unit[row]];
    const title = `${channel ? `${channel}: noise` : "noise"}${unit ? ` (${unit})` : ""}`;
    const rows = found.get(title) ?? [];
    rows.push(row);
    found.set(title, rows);
  });
  return [...found].sort(([, a], [, b]) => b.length - a.length);
}

/**
 * Draw the strip of one channel.
 * @param {Fleet} fleet @param {string} title @param {number[]} rows
 * @param {(row: number) => void} pressed
 */
function stripOf(fleet, title, rows, pressed) {
  const { columns } = fleet;
  const hint = find("strips").childElementCount ? "" : HINT;
  const caption = make("figcaption", "", hint);
  const dots = rows.map((row) => ({ row, value: Number(columns.noise_std[row]), marked: columns.outlying[row] !== "" }));
  const outlying = dots.filter(({ marked }) => marked).length;
  const canvas = make("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${title}, of ${spaced(rows.length)} sensors on a logarithmic axis; ${spaced(outlying)} are outlying.`);
  const legend = make("div", "legend", ...(outlying ? [make("span", "mark", `outlying ${spaced(outlying)}`)] : []));
  const figure = make("figure", "", make("header", "", make("h3", "", title), legend), canvas, caption);
  figure.id = `strip-${find("strips").childElementCount + 1}`;
  find("strips").append(figure);
  const pointed = (/** @type {number | null} */ row) => {
    caption.textContent = row === null ? hint : `${columns.sensor[row]}: ${amount(columns.noise_std[row], columns.unit[row])}. ${columns.outlying[row]}`;
  };
  return new Strip(canvas, dots, { pointed, pressed });
}

/** @param {Fleet} fleet */
function start(fleet) {
  const search = /** @type {HTMLInputElement} */ (find("search"));
  const filters = /** @type {HTMLElement[]} */ ([...document.querySelectorAll("[data-bit]")]);
  const texts = haystack(fleet);
  const columns = COLUMNS.filter(({ kind }) => kind !== "channel" || new Set(fleet.columns.channel).size > 1);
  const query = { bit: -1, column: 0, down: false };

  const table = new Table(/** @type {HTMLTableElement} */ (find("table")), {
    columns,
    cells: (row) => cellsOf(fleet, columns, row),
    opened: (row) => all(fleet, row),
    printed: (row) => (traitsOf(fleet, row)[0].name === "fits" ? [] : sentences(fleet, row)),
    pressed: (column) => {
      query.down = column === query.column ? !query.down : columns[column].down ?? false;
      query.column = column;
      show();
    },
  });

  function show() {
    const matches = matching(fleet, texts, query.bit, search.value);
    table.mark(query.column, query.down);
    table.show(ordered(fleet, matches, columns[query.column], query.down));
    find("shown").textContent = `${spaced(matches.length)} of ${spaced(texts.length)}`;
    const shown = new Uint8Array(texts.length);
    for (const row of matches) shown[row] = 1;
    for (const strip of strips) strip.show((row) => shown[row] === 1);
  }

  /** Show only the rows with one trait. @param {number} bit number of the trait; -1 for all rows */
  function only(bit) {
    query.bit = bit;
    for (const one of filters) one.setAttribute("aria-pressed", String(Number(one.dataset.bit) === bit));
    show();
  }

  /** Scroll to a row of the table and open it; first remove search and filter if they hide the row. @param {number} row */
  function reveal(row) {
    if (!table.rows.includes(row)) {
      search.value = "";
      only(-1);
    }
    const at = table.rows.indexOf(row);
    table.go(at);
    if (table.open !== at) table.toggle(at);
    table.go(at);
    table.place.focus({ preventScroll: true });
  }

  const channels = channelsOf(fleet);
  const strips = channels.slice(0, MOST_STRIPS).map(([title, rows]) => stripOf(fleet, title, rows, reveal));
  const left = channels.length - MOST_STRIPS;
  if (left > 0) find("strips").append(make("p", "", `Only the ${MOST_STRIPS} channels with most sensors are drawn; the table lists the noise of ${left} more.`));
  for (const one of filters) one.addEventListener("click", () => only(query.bit === Number(one.dataset.bit) ? -1 : Number(one.dataset.bit)));
  search.addEventListener("input", show);
  onTheme(() => strips.forEach((strip) => strip.paint()));
  show();
  return { fleet, table, strips };
}

readColours();
unpack(find("rows").textContent).then((fleet) => {
  Object.assign(window, { becalmFleet: start(fleet) }); // for scripts that inspect the page, such as its tests
});
