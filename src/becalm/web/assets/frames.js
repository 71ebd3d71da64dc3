// Decodes binary frames: each has the length of its JSON header, the header, and arrays.

/** @typedef {{ type: "f4" | "f8" | "u2", at: number, count: number, offset?: number | null }} Place */
/** @typedef {Float32Array | Float64Array | Uint16Array} Values */
/** @typedef {{ header: any, arrays: Record<string, Values> }} Frame */

const KINDS = { f4: Float32Array, f8: Float64Array, u2: Uint16Array };

/**
 * Decode a frame; only arrays with an offset are copied.
 * @param {ArrayBuffer} buffer
 * @returns {Frame}
 */
export function decode(buffer) {
  const begin = 4 + new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, begin - 4)));
  /** @type {[string, Place][]} */
  const places = Object.entries(header.arrays);
  const arrays = Object.fromEntries(places.map(([name, place]) => [name, laid(buffer, begin, place)]));
  return { header, arrays };
}

/** @param {ArrayBuffer} buffer @param {number} begin @param {Place} place @returns {Values} */
function laid(buffer, begin, { type, at, count, offset }) {
  const values = new KINDS[type](buffer, begin + at, count);
  return offset ? Float64Array.from(values, (value) => value + offset) : values;
}

/** Replace numbers that are not finite by null, as uPlot needs it. @param {Values} values @returns {(number | null)[]} */
export function gapped(values) {
  return Array.from(values, (value) => (Number.isFinite(value) ? value : null));
}
