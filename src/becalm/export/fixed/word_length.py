"""Choose the binary point of each state of a filter in fixed point, and compute the resulting error before any row.

A reading is a count of 31 bits; a state is an integer of 61 bits whose last digit is 2^-f counts. f is as large as the
range of the state allows. This range covers the worst readings in the steady state (the sum of |h| over the impulse
response). If there are enough digits, it also covers the worst readings during the start, or during a prediction
without readings; otherwise a filter that exceeds the range starts anew.

The ranges are computed, but not proved: the impulse response is evaluated at each of its first rows, and later at a
fixed number of rows in each octave, so that its sum is accurate to about 1 %. Rounding stalls a state and adds noise at
every step, as in `export/word_length.py`. Readings and signal are rounded to counts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.steady.steady_filter import SteadyFilter
from becalm.errors import RecipeError
from becalm.export.design import Design, spread_of
from becalm.export.schedule import Schedule
from becalm.export.word_length import MOST_ERROR, WordLength, lyapunov_sum

STATE_BITS = 61
"""Bits of a state without its sign. A sum of terms has one bit more, and the sum of two such sums fits into 64 bits."""

_COUNT_BITS = 31  # of a reading, without its sign
_INNOVATION_DIGITS = 28  # largest number of binary digits after the point, for nu and for the signal
_QUIET = 0.02  # error of the states, in counts, that is negligible compared with the rounding of the signal
_PROMISED = 3e-4  # largest error of the states over the noise std: 90 dB for a signal of 12 noise std
_APART = 128.0  # least difference of readings that a start must allow, in standard deviations of their noise
_START_ROWS = 512  # largest number of rows of a start that are evaluated
_MARGIN = 1.01  # factor on a range, for the rows that are not evaluated
_GRID = 512  # number of first rows of an impulse response that are evaluated, and of rows in each octave after them
_OCTAVES = 60  # largest number of octaves of an impulse response that are evaluated


class BinaryPoint(NamedTuple):
    """The numbers of binary digits after the point, for quantities in counts.

    Attributes
    ----------
    states : tuple of int
        f of each state.
    innovation, signal : int
        Digits of the innovation, and of the sum that is rounded to the signal.
    apart : float
        Largest difference of readings during a start or a prediction, as a share of half the range. With a larger
        difference the filter may start anew.
    """

    states: tuple[int, ...]
    innovation: int
    signal: int
    apart: float


class StateBounds(NamedTuple):
    """Bounds on the magnitudes of the states (n,), relative to the greatest reading."""

    settled: Floats  # in the steady state
    starting: Floats  # also during a start, or a prediction without readings


def fit(design: Design, schedule: Schedule, lsb: float) -> tuple[BinaryPoint, WordLength]:
    """Choose the binary point of each state, and compute the resulting error.

    Parameters
    ----------
    design : Design
        A filter with a steady state.
    schedule : Schedule
        The gains of the filter.
    lsb : float
        One count, in unit.

    Raises
    ------
    RecipeError
        If the resolution of counts or of states is too coarse for the noise.
    """
    unit, span = design.unit_after, lsb * 2.0 ** (_COUNT_BITS + 1)
    if lsb > design.noise_std:
        raise RecipeError(
            f"{design.name}: one count of q31 is {lsb:.3g}{unit} for readings that span {span:.3g}{unit}, more"
            f" than their noise of {design.noise_std:.3g}{unit}; give a narrower --range, or --precision float32."
        )
    bounds, least = bound_states(design, schedule), min(_APART * lsb_noise(design, lsb) / 2.0**_COUNT_BITS, 1.0)
    apart = 1.0
    point = _point(design, schedule, bounds, apart)
    while apart > least and _states_error(design, point) > _QUIET:
        apart = max(apart / 2, least)
        point = _point(design, schedule, bounds, apart)
    word = _word(design, point, lsb)
    _refuse(design, point, word, lsb)
    return point, word


def lsb_noise(design: Design, lsb: float) -> float:
    """Return the standard deviation of a reading's noise, in counts."""
    return design.noise_std / lsb


def _refuse(design: Design, point: BinaryPoint, word: WordLength, lsb: float) -> None:
    """Raise a RecipeError if the error of a word length is too large."""
    unit, states_error = design.unit_after, _states_error(design, point)
    quiet = word.share <= MOST_ERROR and states_error <= _PROMISED * lsb_noise(design, lsb)
    if quiet and min(point.innovation, point.signal) > 0:
        return
    raise RecipeError(
        f"{design.name}: with q31 the error is {word.share:.2g} of the signal's standard deviation of"
        f" {design.settled_std:.3g}{unit} for readings that span {word.range:.3g}{unit}; at most a tenth is allowed"
        f" (it stalls {word.stall:.2g}{unit} off, rounding adds {word.noise:.2g}{unit}; its states are"
        f" {states_error * lsb:.2g}{unit} of that, where {_PROMISED * design.noise_std:.2g}{unit} is allowed); give a"
        " narrower --range, a larger process_noise_density, or --precision float64."
    )


def _word(design: Design, point: BinaryPoint, lsb: float) -> WordLength:
    """Return the errors that the binary points cause, in unit."""
    assert design.steady is not None
    stall = stall_of(design, point)
    rounded = (1 + design.steady.noise_gain()) / 12  # variance from rounding the signal and readings, in counts^2
    noise = float(np.sqrt(noise_of(design.steady, point) ** 2 + rounded))
    share = max(stall, noise) * lsb / design.settled_std
    return WordLength(stall * lsb, noise * lsb, share, lsb * 2.0 ** (_COUNT_BITS + 1), lsb)


def _states_error(design: Design, point: BinaryPoint) -> float:
    """Return the larger of the stall and the rounding noise of the states, in counts."""
    assert design.steady is not None
    return max(stall_of(design, point), noise_of(design.steady, point))


def stall_of(design: Design, point: BinaryPoint) -> float:
    """Return the largest error, in counts, at which a filter stalls on a constant signal, or by which it oscillates.

    A state of the motion does not change while |F K nu| is below half of its last digit. If a slope stalls at a value
    other than 0, the level stalls where K nu compensates the slope. An innovation below half of its own last digit has
    no effect.
    """
    assert design.steady is not None
    n = design.motion_order
    halves, gains = 0.5 ** (np.array(point.states[:n]) + 1.0), np.abs(design.model.F @ design.steady.gain)[:n, 0]
    stalls = np.divide(halves, gains, out=np.full(n, np.inf), where=gains > 0)
    return max(float(stalls.max()), 0.5 ** (point.innovation + 1))


def noise_of(steady: SteadyFilter, point: BinaryPoint) -> float:
    """Return the standard deviation, in counts, of the states' rounding noise in the signal, in the steady state.

    Each term of a sum is rounded to the last digit of the sum, with a uniformly distributed error.
    """
    F, H, C, K = steady.model.F, steady.model.H, steady.output, steady.gain
    D = _scale(steady)
    digit = 0.5 ** np.array(point.states, np.float64)
    terms = 1 + np.count_nonzero(F - np.diag(np.diag(F) == 1.0), axis=1)
    nu_variance = np.count_nonzero(H) * 4.0**-point.innovation / 12
    gain = F @ K / D[:, np.newaxis]
    injected = np.diag(terms * (digit / D) ** 2 / 12) + nu_variance * (gain @ gain.T)
    states_covariance = lyapunov_sum(steady.loop.M, injected)
    row = (C - (C @ K) @ H) * D
    signal_variance = (np.count_nonzero(C) + 1) * 4.0**-point.signal / 12 + nu_variance * float((C @ K)[0, 0]) ** 2
    return float(np.sqrt((row @ states_covariance @ row.T)[0, 0] + signal_variance))


def _point(design: Design, schedule: Schedule, bounds: StateBounds, apart: float) -> BinaryPoint:
    """Return the largest numbers of digits that the ranges of the states, their sums, nu and the signal allow."""
    F, H, C = design.model.F, np.abs(design.model.H[0]), np.abs(design.output)
    K = np.vstack([schedule.K, schedule.settled])
    level = design.level_direction
    started = np.minimum(np.maximum(bounds.starting, level), level + apart * bounds.starting)
    states = np.maximum(bounds.settled, started)
    nu = 1.0 + float(H @ states)
    entering = np.maximum(np.abs(F @ schedule.settled), apart * np.abs(K @ F.T).max(axis=0)) * nu
    sums = (np.abs(F) @ states + entering) / 2
    signal = float(C @ states) + float(np.abs(K @ design.output).max()) * nu
    digits = [_digits(size) for size in np.maximum(sums, states).tolist()]
    # Where state j is added to state i without a factor, state i must not have more digits than state j.
    for i in reversed(range(design.states - 1)):
        digits[i] = min([digits[i], *(digits[j] for j in range(i + 1, design.states) if F[i, j] == 1.0)])
    of_used = [each for each, used in zip(digits, H + C, strict=True) if used]
    return BinaryPoint(
        tuple(digits),
        min(_digits(nu), _INNOVATION_DIGITS, *of_used),
        min(_digits(signal), _INNOVATION_DIGITS, *of_used),
        apart,
    )


def _digits(size: float) -> int:
    """Return the number of digits after the point for a quantity of up to `size` times the greatest reading."""
    return STATE_BITS - _COUNT_BITS - int(np.ceil(np.log2(_MARGIN * max(size, 1e-9))))


def bound_states(design: Design, schedule: Schedule) -> StateBounds:
    """Return bounds on the magnitudes of the states, for the worst readings."""
    assert design.steady is not None
    columns, weights, D = _responses(design.steady)
    settled = D * (np.abs(columns) @ weights)
    starting, leap = np.maximum(_start_magnitudes(design, schedule), settled), design.steady.loop.F
    coasts = design.coasts
    for length in sorted({min(1 << bit, coasts) for bit in range(17)}):
        far = np.linalg.matrix_power(leap, length)
        starting = np.maximum(starting, D * (np.abs(far @ columns) @ weights))
    return StateBounds(settled, starting)


def _responses(steady: SteadyFilter) -> tuple[Floats, Floats, Floats]:
    """Return the impulse response (n, k) of the states, the number of rows of each column (k,), and the spreads (n,).

    Each of the first 512 rows has its own column; after them, each octave has 512 columns, so that a column represents
    several rows. For a decaying oscillation, the errors of this sampling nearly cancel. The states are scaled to equal
    spread.
    """
    loop = steady.loop
    grid, power = loop.F @ loop.K, loop.M
    while grid.shape[1] < _GRID:
        grid, power = np.hstack([grid, power @ grid]), power @ power
    columns, weights, spacing = [grid], [np.ones(_GRID)], 1.0  # spacing of the columns, in rows
    for _ in range(_OCTAVES):
        following = power @ grid
        columns.append(following)
        weights.append(np.full(_GRID, spacing))
        if np.abs(following).sum() * spacing <= 1e-9 * np.abs(grid).sum():
            break
        grid, power, spacing = np.hstack([grid[:, ::2], following[:, ::2]]), power @ power, spacing * 2
    return np.hstack(columns), np.concatenate(weights), _scale(steady)


def _scale(steady: SteadyFilter) -> Floats:
    """Return the spreads of the states (n,), which are the units of `steady.loop`; 1 for a state without spread."""
    spread = spread_of(steady)
    return np.where(spread > 0, spread, 1.0)


def _start_magnitudes(design: Design, schedule: Schedule) -> Floats:
    """Return the largest magnitudes of the states (n,) in the first rows, for the largest differences of readings."""
    F, H, weights = design.model.F, design.model.H, design.opening.weights
    first = np.abs(weights[1:]).sum(axis=0)
    columns = F @ weights.T
    most: Floats = np.maximum(2 * first, np.abs(columns).sum(axis=1))
    for K in np.repeat(schedule.K, np.minimum(schedule.counts, _START_ROWS), axis=0)[:_START_ROWS]:
        columns = np.hstack([F @ (columns - np.outer(K, H @ columns)), (F @ K)[:, np.newaxis]])
        most = np.maximum(most, np.abs(columns).sum(axis=1))
    return most
