"""The third pass over a stream's block: what innovations say of the sensor, and how uncertain the signal is."""

from __future__ import annotations

import math

from becalm.core.arrays import Floats, Integers
from becalm.core.compiling import compiled_part
from becalm.core.kernel_outliers import PLAUSIBLE_HIGH, PLAUSIBLE_LOW
from becalm.core.kernel_stream_layout import (
    CALIBRATED,
    COUNTS,
    DEAD_BELOW,
    DRIFT_AT,
    FACTOR,
    HOPS,
    MISSED,
    OFFSET,
    OUTLIERS,
    POWER,
    POWERS,
    READ,
    RELATIVE,
    SILENT,
    SLOPE,
    SQUARES_OF,
    TIME_INCLUDED,
    TIME_STD,
    TIMED,
    TOLD,
    TOTALS,
    UNKNOWN_FROM,
    VARIANCE,
    WATCH,
    Heard,
    Out,
    Rows,
)
from becalm.core.kernel_watch import (
    ABOVE,
    ABOVE_SINCE,
    BELOW,
    BELOW_SINCE,
    COUNT,
    DRIFT,
    DRIFT_SINCE,
    HOP,
    KEPT_HOPS,
    LARGEST,
    PARTS,
    ROWS,
    SQUARES,
    TOTAL,
    WINDOW,
    cumulate,
)

SPIKE, DEAD, HOLE, RUNAWAY = 4, 8, 14, 15
SLACK = PARTS // 2  # as `cusum.SLACK`
_BEFORE = WINDOW // HOP - 1  # hops that make a window with the last one
_OF_VARIANCE = float(WINDOW * (WINDOW - 1)) * float(PARTS) * float(PARTS)


@compiled_part
def end_hop(fixed: Floats, numbers: Floats, marks: Integers) -> None:
    """Close a hop of innovations: look at the window that ends with it."""
    total, squares, watched = marks[WATCH + TOTAL], marks[WATCH + SQUARES], marks[HOPS] >= _BEFORE
    numbers[POWERS + marks[HOPS] % KEPT_HOPS], numbers[POWER] = numbers[POWER], 0.0
    marks[HOPS] += 1
    sum_of, squares_of = total, squares
    for k in range(_BEFORE):
        sum_of += marks[TOTALS + k]
        squares_of += marks[SQUARES_OF + k]
    variance = (WINDOW * squares_of - sum_of * sum_of) / _OF_VARIANCE
    marks[SILENT] = 1 if watched and variance < fixed[DEAD_BELOW] else 0
    for k in range(_BEFORE - 1):
        marks[TOTALS + k], marks[SQUARES_OF + k] = marks[TOTALS + k + 1], marks[SQUARES_OF + k + 1]
    marks[TOTALS + _BEFORE - 1], marks[SQUARES_OF + _BEFORE - 1] = total, squares
    marks[WATCH + COUNT], marks[WATCH + TOTAL], marks[WATCH + SQUARES] = 0, 0, 0


@compiled_part
def watch_innovation(fixed: Floats, nu: float, numbers: Floats, marks: Integers) -> int:
    """Return what an innovation over its standard deviation says, NaN where there is none: the twin of `monitor`."""
    row = marks[WATCH + ROWS]
    marks[WATCH + ROWS] = row + 1
    if math.isnan(nu):
        return 0
    nu = min(max(nu, -LARGEST), LARGEST)
    part = round(nu * PARTS)
    sides = (
        marks[WATCH + ABOVE], marks[WATCH + BELOW], marks[WATCH + ABOVE_SINCE], marks[WATCH + BELOW_SINCE],
    )  # fmt: skip
    sides, since = cumulate(sides, part, row, SLACK, int(fixed[DRIFT_AT]))
    marks[WATCH + ABOVE], marks[WATCH + BELOW], marks[WATCH + ABOVE_SINCE], marks[WATCH + BELOW_SINCE] = sides
    if since >= 0 and marks[WATCH + DRIFT_SINCE] < 0:
        marks[WATCH + DRIFT_SINCE] = since
    marks[WATCH + COUNT] += 1
    marks[WATCH + TOTAL] += part
    marks[WATCH + SQUARES] += part * part
    numbers[POWER] += nu * nu
    if marks[WATCH + COUNT] == HOP:
        end_hop(fixed, numbers, marks)
    return DEAD if marks[SILENT] else DRIFT if since >= 0 else 0


@compiled_part
def widened(fixed: Floats, signal: float, sigma: float, elapsed: float, numbers: Floats) -> float:
    """Return sigma with what times, tuning and calibration add: the twin of `slopes` and `uncertainty`."""
    if fixed[TIMED] > 0.0:
        risen = signal - numbers[TOLD]
        if elapsed > 0.0 and math.isfinite(risen):
            numbers[SLOPE] = risen / elapsed
        numbers[TOLD] = signal
        more = (numbers[SLOPE] * fixed[TIME_STD]) ** 2 - fixed[TIME_INCLUDED]
        sigma *= math.sqrt(1.0 + max(more, 0.0) / fixed[VARIANCE])
    sigma *= fixed[FACTOR]
    if fixed[CALIBRATED] > 0.0:
        sensitivity = math.hypot(signal * fixed[RELATIVE], fixed[OFFSET])
        sigma = math.hypot(sigma, sensitivity) if math.isfinite(sensitivity) else sigma
    return sigma


@compiled_part
def is_lost(verdict: int) -> bool:
    """Whether a reading did not enter the filter: the twin of `verdict.LOST`."""
    return verdict in (1, 2, 3, 4, 6, 7, 13)


@compiled_part
def ran_away(fixed: Floats, signal: float, read: float) -> bool:
    """Whether an estimate has left everything that was read: the twin of `sentinel`."""
    low, high = fixed[OUTLIERS + PLAUSIBLE_LOW], fixed[OUTLIERS + PLAUSIBLE_HIGH]
    away: bool = (signal < low or signal > high) and abs(signal - read) > high - low
    return away


@compiled_part
def tell(  # noqa: PLR0913
    fixed: Floats, column: int, rows: Rows, heard: Heard, numbers: Floats, marks: Integers, out: Out, begun: int,
    end: int,
) -> None:  # fmt: skip
    """Finish the rows of a channel from `begun` to `end`: alarms, sigma, and how often each verdict was given."""
    for row in range(begun, end):
        alarm = watch_innovation(fixed, heard.normalised[row], numbers, marks)
        if alarm and out.verdicts[row, column] == 0:
            out.verdicts[row, column] = alarm
        verdict, sigma = out.verdicts[row, column], out.sigma[row, column]
        if not is_lost(verdict) and not math.isnan(heard.usable[row]):
            numbers[READ] = heard.usable[row]
        missed, marks[MISSED] = marks[MISSED], 1 if is_lost(verdict) and verdict != SPIKE else 0
        if ran_away(fixed, out.signal[row, column], numbers[READ]):
            out.signal[row, column], out.sigma[row, column], out.verdicts[row, column] = math.nan, math.nan, RUNAWAY
        if sigma >= fixed[UNKNOWN_FROM] and missed and marks[MISSED] and not math.isnan(out.signal[row, column]):
            out.signal[row, column], out.sigma[row, column], out.verdicts[row, column] = math.nan, math.nan, HOLE
        marks[COUNTS + out.verdicts[row, column]] += 1
        seconds = rows.elapsed[row] * rows.step_s
        out.sigma[row, column] = widened(fixed, out.signal[row, column], out.sigma[row, column], seconds, numbers)
