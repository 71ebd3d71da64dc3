"""Compute the gains of a filter from its first rows to the steady state; in a slow filter, rows share gains."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.model.covariances import covariance_ahead, gain_before
from becalm.core.steady.opening_gains import CovarianceMap, covariance_map, gains_after
from becalm.errors import RecipeError
from becalm.export.design import Design, spread_of

MOST_NUMBERS = 1024
"""Largest size of a table of gains, in numbers; a longer table is thinned."""

_EXACT = 32  # rows with their own gains in any case
_MOST_ALIKE = (1 << 32) - 1  # rows per gain, which four bytes can count
_ALIKE = 32  # from row k on, one gain is used for k / 32 rows
_NEAR = 2e-3  # distance at which a thinned gain counts as settled, in the measure of `near`
_MOST_ROWS = 1 << 40  # after which a thinned schedule ends in any case


class Schedule(NamedTuple):
    """The gains of the rows after the opening.

    Attributes
    ----------
    K : (r, n) float array
        Gains, in order.
    counts : (r,) int array
        Numbers of rows that use each gain; all later rows use `settled`.
    settled : (n,) float array
        The gain in the steady state.
    exact : bool
        Whether each row has its own gain, so that the filter equals the full one from its first reading on.
    """

    K: Floats
    counts: Integers
    settled: Floats
    exact: bool

    @property
    def rows(self) -> int:
        """Return the number of rows from the opening until the gain has settled."""
        return int(self.counts.sum())


def schedule_of(design: Design, near: float, most_numbers: int = MOST_NUMBERS) -> Schedule:
    """Return the gains of a filter with a steady state.

    Parameters
    ----------
    design : Design
        The filter.
    near : float
        Distance from `settled` at which a gain counts as settled, as a share of |settled| + s, where s is the spread of
        the state over that of an innovation; a *small* one makes a longer table.
    most_numbers : int
        Largest size of the table, in numbers; if it does not suffice, rows share gains, and gains change by about 3 %
        per order from one to the next.

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
    off = (np.abs(gains.K - settled) / (spread + np.abs(settled))).max(axis=1)
    far = np.flatnonzero(off > near)
    rows = int(far[-1]) + 1 if len(far) else 0
    if rows < len(gains.K) or gains.settled:
        return Schedule(gains.K[:rows], np.ones(rows, np.int64), settled, True)
    return _thinned(design, gains.K[:_EXACT], settled, spread)


def _thinned(design: Design, first: Floats, settled: Floats, spread: Floats) -> Schedule:
    """Return a schedule in which several rows share a gain, that of their middle row; the rows of `first` do not."""
    K, counts, row = list(first), [1] * len(first), len(first)
    one = covariance_map(design.model)
    P, leaps = _after(design, row), [one]
    while row < _MOST_ROWS:
        count = min(max(row // _ALIKE, 1), _MOST_ALIKE)
        half = _leap(leaps, P, count // 2)
        gain = gain_before(half, design.model)[:, 0]
        if (np.abs(gain - settled) <= _NEAR * (spread + np.abs(settled))).all():
            break
        K.append(gain)
        counts.append(count)
        P, row = _leap(leaps, P, count), row + count
    return Schedule(np.array(K), np.array(counts), settled, False)


def _after(design: Design, rows: int) -> Floats:
    """Return the prior covariance of row `rows` after the opening; the first of these rows is row 0."""
    P, leap = covariance_ahead(design.opening.P, design.model), covariance_map(design.model)
    for _ in range(rows):
        P = leap.over(P)
    return P


def _leap(leaps: list[CovarianceMap], P: Floats, steps: int) -> Floats:
    """Return the prior covariance `steps` later; `leaps` has the maps over 1, 2, 4 ... steps, and is extended."""
    bit = 0
    while steps >> bit:
        if bit == len(leaps):
            leaps.append(leaps[-1].twice())
        if steps >> bit & 1:
            P = leaps[bit].over(P)
        bit += 1
    return P


def _spread(design: Design) -> Floats:
    """Return the scale (n,) of a gain: the spread of each state over that of an innovation."""
    assert design.steady is not None
    return np.asarray(spread_of(design.steady) / np.sqrt(design.steady.innovation_variance), dtype=np.float64)
