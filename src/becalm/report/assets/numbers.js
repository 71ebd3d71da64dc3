// Formats numbers, and chooses the ticks of logarithmic axes.

/**
 * Format a number with five digits; very large and very small numbers with a power of ten.
 * @param {number} value
 */
export function short(value) {
  const far = value !== 0 && (Math.abs(value) >= 1e12 || Math.abs(value) < 1e-3);
  if (far) return value.toExponential(4).replace(/\.?0*e\+?/, "e");
  return String(Number(value.toPrecision(Math.abs(value) >= 1e4 ? 12 : 5))); // more digits, because large numbers may differ by little
}

/**
 * Format a tick label of a logarithmic axis; large numbers with a power of ten.
 * @param {number} value
 */
export function decade(value) {
  return value >= 1e5 ? value.toExponential(4).replace(/\.?0*e\+/, "e") : short(value);
}

/**
 * Format a tick label of a linear axis, with enough digits to distinguish it from the next ticks, one step away.
 * @param {number} value
 * @param {number} step
 */
export function even(value, step) {
  const power = (/** @type {number} */ number) => Math.floor(Math.log10(number) + 1e-9);
  if (Math.abs(value) < 1e-6 * step) return "0";
  const far = Math.abs(value) >= 1e15 || (Math.abs(value) < 1 && step < 1e-4);
  const digits = Math.max(0, power(Math.abs(value)) - power(step) + 1);
  const text = far ? value.toExponential(digits) : value.toFixed(Math.max(0, Math.min(20, 1 - power(step))));
  return text.replace(/(\.\d*?)0+(?=e|$)/, "$1").replace(/\.(?=e|$)/, "").replace("e+", "e");
}

/**
 * Return the ticks of a logarithmic axis: up to about seven powers of ten; below two decades, also numbers between them.
 * @param {unknown} u
 * @param {number} axis
 * @param {number} low
 * @param {number} high
 */
export function logarithmic(u, axis, low, high) {
  if (high < 100 * low) return within(low, high);
  const [first, last] = [Math.ceil(Math.log10(low) - 1e-9), Math.floor(Math.log10(high) + 1e-9)];
  const stride = Math.max(1, Math.ceil((last - first + 1) / 7));
  return Array.from({ length: Math.floor((last - first) / stride) + 1 }, (_, i) => 10 ** (first + i * stride));
}

/**
 * Return 1, 2 and 5 times the powers of ten between two limits; if there are fewer than two, even steps.
 * @param {number} low
 * @param {number} high
 */
function within(low, high) {
  const first = Math.floor(Math.log10(low));
  const candidates = [0, 1, 2].flatMap((i) => [1, 2, 5].map((times) => times * 10 ** (first + i)));
  const inside = candidates.filter((value) => value >= low * (1 - 1e-9) && value <= high * (1 + 1e-9));
  if (inside.length > 1) return inside;
  const rough = (high - low) / 4;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 5].find((times) => times * power >= rough) ?? 10);
  const begin = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - begin + 1 }, (_, i) => (begin + i) * step);
}
