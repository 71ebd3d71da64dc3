// Draws the verdicts below the signal: a lane with a name and a colour for each verdict that occurs.

import { colour, other } from "../colours.js";

/** Names in the order of `becalm.core.reading_verdicts.Verdict`; "used" is not drawn. */
export const VERDICTS = ["used", "missing", "nonfinite", "overrange", "spike", "step", "clipped", "stuck", "dead", "drift", "late", "repeated", "gap", "outlier", "hole", "runaway"];
const ROW = 18;

/**
 * Draw verdicts, aligned with the signal above.
 * @param {HTMLCanvasElement} canvas
 * @param {uPlot} u
 * @param {ArrayLike<number>} verdicts bits of each stretch of the plot's data
 */
export function drawLanes(canvas, u, verdicts) {
  const found = VERDICTS.map((name, bit) => ({ name, bit })).filter(({ bit }) => bit && some(verdicts, 1 << bit));
  const rows = Math.max(found.length, Number(canvas.dataset.rows ?? 0)); // the height never shrinks, so that the page does not jump
  canvas.dataset.rows = String(rows);
  canvas.hidden = !rows;
  const ratio = devicePixelRatio;
  const { left, width } = u.bbox;
  canvas.width = u.width * ratio;
  canvas.height = ROW * rows * ratio;
  canvas.style.height = `${ROW * rows}px`;
  const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  pen.font = `${12 * ratio}px system-ui, sans-serif`;
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  const counts = found.map(({ name, bit }, row) => {
    const runs = runsOf(verdicts, 1 << bit);
    pen.fillStyle = colour("ink")();
    pen.fillText(name, left - 8 * ratio, (row + 0.5) * ROW * ratio);
    pen.fillStyle = colour("grid")();
    pen.fillRect(left, (row + 0.5) * ROW * ratio, width, 1);
    pen.fillStyle = colour(name === "missing" ? "faint" : other(bit))();
    for (const [from, to] of runs) {
      const [begin, end] = [placeOf(u, from), placeOf(u, to)];
      if (end < left || begin > left + width) continue;
      const start = Math.max(left, begin);
      pen.fillRect(start, (row + 0.15) * ROW * ratio, Math.max(2 * ratio, Math.min(left + width, end) - start), 0.7 * ROW * ratio);
    }
    return `${name} in ${runs.length} ${runs.length > 1 ? "places" : "place"}`;
  });
  canvas.setAttribute("aria-label", `Verdicts in view: ${counts.join(", ") || "none but used"}.`);
}

/** @param {ArrayLike<number>} verdicts @param {number} mask */
function some(verdicts, mask) {
  for (let i = 0; i < verdicts.length; i += 1) if (verdicts[i] & mask) return true;
  return false;
}

/** Return the runs of a verdict: for each the number of its first stretch, and of the stretch after its last. @param {ArrayLike<number>} verdicts @param {number} mask */
function runsOf(verdicts, mask) {
  /** @type {[number, number][]} */
  const runs = [];
  for (let i = 0; i < verdicts.length; i += 1) {
    if (!(verdicts[i] & mask)) continue;
    const last = runs.at(-1);
    if (last && last[1] === i) last[1] = i + 1;
    else runs.push([i, i + 1]);
  }
  return runs;
}

/** Return the horizontal position at which a stretch begins, in pixels of the canvas. @param {uPlot} u @param {number} stretch */
function placeOf(u, stretch) {
  const t = u.data[0];
  const last = t.length - 1;
  const when = stretch <= last ? t[stretch] : t[last] + (last > 0 ? t[last] - t[last - 1] : 0);
  return u.valToPos(when, "x", true);
}
