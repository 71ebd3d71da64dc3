// The strip of verdicts under the signal: a lane for each that comes up, by name and by colour.

import { colour, other } from "../colours.js";

/** As `becalm.core.verdict.Verdict` counts them; the first is no verdict that is drawn. */
export const VERDICTS = ["used", "missing", "nonfinite", "overrange", "spike", "step", "clipped", "stuck", "dead", "drift", "late", "repeated", "gap", "outlier", "hole", "runaway"];
const ROW = 18;

/**
 * Draw verdicts in line with the signal above.
 * @param {HTMLCanvasElement} canvas
 * @param {uPlot} u
 * @param {ArrayLike<number>} verdicts bits of each stretch of the plot's data
 */
export function drawLanes(canvas, u, verdicts) {
  const found = VERDICTS.map((name, bit) => ({ name, bit })).filter(({ bit }) => bit && some(verdicts, 1 << bit));
  const rows = Math.max(found.length, Number(canvas.dataset.rows ?? 0)); // the room stays, so that nothing jumps
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
  const told = found.map(({ name, bit }, row) => {
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
  canvas.setAttribute("aria-label", `Verdicts in view: ${told.join(", ") || "none but used"}.`);
}

/** @param {ArrayLike<number>} verdicts @param {number} mask */
function some(verdicts, mask) {
  for (let i = 0; i < verdicts.length; i += 1) if (verdicts[i] & mask) return true;
  return false;
}

/** Where a verdict holds, as first stretches and those after the last. @param {ArrayLike<number>} verdicts @param {number} mask */
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

/** Where a stretch begins on the canvas. @param {uPlot} u @param {number} stretch */
function placeOf(u, stretch) {
  const t = u.data[0];
  const last = t.length - 1;
  const when = stretch <= last ? t[stretch] : t[last] + (last > 0 ? t[last] - t[last - 1] : 0);
  return u.valToPos(when, "x", true);
}
