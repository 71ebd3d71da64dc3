// Unpacks, formats, searches and sorts the rows of a fleet. The page contains the rows sorted, the worst first.

import { short } from "../numbers.js";

/** @typedef {(number | null)[]} Numbers */
/**
 * @typedef {object} Columns the data that `fleet_page` packed, one value for each row
 * @property {string[]} sensor
 * @property {string[]} channel
 * @property {string[]} unit
 * @property {string[]} reason
 * @property {string[]} faults
 * @property {string[]} says
 * @property {string[]} recipe
 * @property {string[]} outlying
 * @property {Numbers} health
 * @property {Numbers} noise_std
 * @property {Numbers} rate_hz
 * @property {Numbers} usable in percent
 * @property {number[]} rows
 * @property {number[]} traits one bit for each trait of the row
 * @typedef {{ traits: { name: string, tone: string }[], columns: Columns }} Fleet
 */
/**
 * @typedef {object} Column of the table
 * @property {string} name
 * @property {string} kind its CSS class
 * @property {string} [says] explanation of the column
 * @property {boolean} [down] whether the first sort is in descending order
 * @property {(fleet: Fleet, row: number) => string} text the text of a cell
 * @property {(fleet: Fleet, row: number) => number | string | null} key sort key
 */

/** Unpack rows. @param {string} base64 @returns {Promise<Fleet>} */
export async function unpack(base64) {
  const letters = atob(base64);
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i += 1) bytes[i] = letters.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).json();
}

/** Format a number with three digits and its unit; null as a dash. @param {number | null} value @param {string} [unit] */
export function amount(value, unit = "") {
  return value === null ? "–" : `${short(Number(value.toPrecision(3)))} ${unit}`.trim();
}

/** Format a count with spaces between thousands. @param {number} count */
export const spaced = (count) => String(count).replace(/\B(?=(\d{3})+$)/g, "\u202f");

/** Format a percentage; null as a dash. @param {number | null} percent */
export const share = (percent) => (percent === null ? "–" : `${percent} %`);

/** Return a sort key for a name, in which digits count as numbers. @param {string} name */
const natural = (name) => name.replace(/\d+/g, (digits) => digits.padStart(12, "0"));

/** Return the traits of a row. @param {Fleet} fleet @param {number} row */
export const traitsOf = ({ traits, columns }, row) => traits.filter((_, bit) => columns.traits[row] & (1 << bit));

/** @param {Fleet} fleet @param {number} row */
const judged = (fleet, row) => traitsOf(fleet, row).map(({ name }) => name).join(", ");

/** @type {Column[]} */
export const COLUMNS = [
  { name: "#", kind: "rank", says: "Rank among all rows, the worst first", text: (_, i) => spaced(i + 1), key: (_, i) => i },
  { name: "sensor", kind: "sensor", text: ({ columns }, i) => columns.sensor[i], key: ({ columns }, i) => natural(columns.sensor[i]) },
  { name: "channel", kind: "channel", text: ({ columns }, i) => columns.channel[i], key: ({ columns }, i) => columns.channel[i] || null },
  { name: "judged", kind: "judged", text: judged, key: judged },
  { name: "noise", kind: "noise", says: "Standard deviation of one reading's noise", down: true, text: ({ columns }, i) => amount(columns.noise_std[i], columns.unit[i]), key: ({ columns }, i) => columns.noise_std[i] },
  { name: "NIS", kind: "nis", says: "Mean squared normalised innovation; 1 is right", down: true, text: ({ columns }, i) => amount(columns.health[i]), key: ({ columns }, i) => columns.health[i] },
  { name: "usable", kind: "usable", says: "Share of the readings that show the signal", text: ({ columns }, i) => share(columns.usable[i]), key: ({ columns }, i) => columns.usable[i] },
  { name: "faults", kind: "faults", text: ({ columns }, i) => columns.faults[i], key: ({ columns }, i) => columns.faults[i] || null },
  { name: "rows", kind: "rows", down: true, text: ({ columns }, i) => spaced(columns.rows[i]), key: ({ columns }, i) => columns.rows[i] },
];

/** Return, for each row, the text to search in, in lower case. @param {Fleet} fleet */
export function haystack({ columns }) {
  const { sensor, channel, recipe, faults, outlying, reason, says } = columns;
  const texts = [channel, recipe, faults, outlying, reason, says];
  return sensor.map((name, i) => [name, ...texts.map((one) => one[i])].join("\n").toLowerCase());
}

/**
 * Return the rows that have a trait and contain all words of a query.
 * @param {Fleet} fleet
 * @param {string[]} texts from `haystack`
 * @param {number} bit number of the trait; negative for all rows
 * @param {string} query words to search for
 */
export function matching({ columns }, texts, bit, query) {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  const has = (/** @type {number} */ i) => bit < 0 || columns.traits[i] & (1 << bit);
  return [...texts.keys()].filter((i) => has(i) && words.every((word) => texts[i].includes(word)));
}

/**
 * Sort rows by a column; equal rows keep their order, and rows without a value come last.
 * @param {Fleet} fleet
 * @param {number[]} rows worst first
 * @param {Column} column
 * @param {boolean} down
 */
export function ordered(fleet, rows, column, down) {
  /** @type {(number | string | null)[]} */
  const keys = [];
  for (const row of rows) keys[row] = column.key(fleet, row);
  const [first, then] = down ? [1, -1] : [-1, 1];
  const known = rows.filter((row) => keys[row] !== null).sort((a, b) => {
    const [x, y] = /** @type {(number | string)[]} */ ([keys[a], keys[b]]);
    return x === y ? 0 : x < y ? first : then;
  });
  return [...known, ...rows.filter((row) => keys[row] === null)];
}
