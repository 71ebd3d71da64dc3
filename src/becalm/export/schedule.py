"""Compute the gains of a filter from its first rows to the steady state; in slow filters, several rows share a gain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.model.covariances import covariance_ahead, gain_before
from becalm.core.steady.opening_gains import CovarianceMap, covariance_map, gains_after
from becalm.errors import RecipeError
from becalm.export.design import Design, spread_of

MOST_NUMBERS = 1024
"""Largest size of a table of gains, in numbers; a longer table is thinned, so that several rows share a gain."""

_EXACT = 32  # number of first rows that never share a gain
_MOST_ALIKE = (1 << 32) - 1  # largest number of rows that share a gain, which four bytes can count
_ALIKE = 32  # at row k of a thinned table, one gain is used for k / 32 rows
_NEAR = 2e-3  # parameter `near` of `schedule_of`, for a thinned table
_MOST_ROWS = 1 << 40  # number of rows after which a thinned schedule ends in any case


class Schedule(NamedTuple):
    """The gains of the rows after the first readings, which determine the state.

    Attributes
    ----------
    K : (r, n) float array
        Gains, in order.
    counts : (r,) int array
        Number of rows that use each gain; all later rows use `settled`.
    settled : (n,) float array
        The gain in the steady state.
    exact : bool
        Whether each row has its own gain, so that the filter equals one with a covariance from the first reading on.
    """

    K: Floats
    counts: Integers
    settled: Floats
    exact: bool

    @property
    def rows(self) -> int:
        """Return the number of rows until the gain has settled, after the first readings that determine the state."""
        return int(self.counts.sum())


def schedule_of(design: Design, near: float, most_numbers: int = MOST_NUMBERS) -> Schedule:
    """Return the gains of a filter with a steady state.

    Parameters
    ----------
    design : Design
        The filter.
    near : float
        Largest distance from `settled` of a gain that counts as settled, as a share of |settled| + s, where s is the
        prior standard deviation of the state over that of an innovation. A *small* value makes a longer table.
    most_numbers : int
        Largest size of the table, in numbers. If it is too small, several rows share a gain, and successive gains
        differ by about 3 % for each order.

    Raises
    ------
    RecipeError
        If the filter has no steady state.
    """
    if design.steady is None:
        raise RecipeError(
            f"The filter of {design.name} has no steady state, since its process_noise_density is 0: its gain falls for"
            " ever. Export it with --gain full, or give it a process_noise_density."
        )
    settled = design.steady.gain[:, 0]
    gains = gains_after(design.opening, design.model, max(most_numbers // design.states, _EXACT))
    spread = _spread(design)
    distance = (np.abs(gains.K - settled) / (spread + np.abs(settled))).max(axis=1)
    unsettled = np.flatnonzero(distance > near)
    rows = int(unsettled[-1]) + 1 if len(unsettled) else 0
    if rows < len(gains.K) or gains.settled:
        return Schedule(gains.K[:rows], np.ones(rows, np.int64), settled, True)
    return _thinned(design, gains.K[:_EXACT], settled, spread)


def _thinned(design: Design, first: Floats, settled: Floats, spread: Floats) -> Schedule:
    """Return a schedule of the gains `first`, one for each row, and then of gains that several rows share.

    A shared gain is that of the middle row.
    """
    K, counts, row = list(first), [1] * len(first), len(first)
    one = covariance_map(design.model)
    P, maps = _prior_covariance(design, row), [one]
    while row < _MOST_ROWS:
        count = min(max(row // _ALIKE, 1), _MOST_ALIKE)
        middle = _advance(maps, P, count // 2)
        gain = gain_before(middle, design.model)[:, 0]
        if (np.abs(gain - settled) <= _NEAR * (spread + np.abs(settled))).all():
            break
        K.append(gain)
        counts.append(count)
        P, row = _advance(maps, P, count), row + count
    return Schedule(np.array(K), np.array(counts), settled, False)


def _prior_covariance(design: Design, row: int) -> Floats:
    """Return the prior covariance of a row; row 0 is the first after the readings that determine the state."""
    P, one_step = covariance_ahead(design.opening.P, design.model), covariance_map(design.model)
    for _ in range(row):
        P = one_step.over(P)
    return P


def _advance(maps: list[CovarianceMap], P: Floats, steps: int) -> Floats:
    """Return the prior covariance `steps` later; `maps`, over 1, 2, 4 ... steps, is extended as needed."""
    bit = 0
    while steps >> bit:
        if bit == len(maps):
            maps.append(maps[-1].twice())
        if steps >> bit & 1:
            P = maps[bit].over(P)
        bit += 1
    return P


def _spread(design: Design) -> Floats:
    """Return the scale (n,) of a gain: the prior standard deviation of each state over that of an innovation."""
    assert design.steady is not None
    return np.asarray(spread_of(design.steady) / np.sqrt(design.steady.innovation_variance), dtype=np.float64)
