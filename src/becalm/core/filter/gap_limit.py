"""How long a gap may be that a filter is carried across, before float64 loses what was read before it.

Across a gap of T steps the variance of a motion of order n grows as q T^(2n-1), and what its first readings
tell is carried on as (T / L)^(2n-2), where L is the time that they span. A reading after the gap takes all of
that away at once: beyond so many times R the difference has no digit left. The readings before the gap
then say next to nothing of those after it, so that a filter that starts with the latter loses next to nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import comb
from typing import NamedTuple

import numpy as np

from becalm.core.model.components import Component

_FORGOTTEN = 1e15  # of a predicted variance over R: what is left says nothing; from 1e18 on smoothers lose all digits
_CARRIED = 1e13  # of one that comes from the first readings, whose covariance has fewer digits: lost from 1e14 on
_LENGTHS = np.ldexp(1.0, np.arange(53))  # steps: whole ones, for what goes in even steps
_LEAST = 2.0  # steps: what even time has between two rows is no gap, however nervous the motion


class GapLimit(NamedTuple):
    """Which gaps a filter may be carried across, by time since the last reading that arrived."""

    longest: float  # steps
    spans: float = np.inf  # how many times what the readings before span, once they tell the state
    readings: int = 1  # as many tell it


@lru_cache(maxsize=256)
def gap_limit_of(component: Component, noise_variance: float) -> GapLimit:
    """Return which gaps a filter of a component may be carried across.

    Parameters
    ----------
    component : Component
        The signal's model, in steps; its first part is the motion.
    noise_variance : float
        R, in unit^2; with a *small* one fewer gaps are bridged.

    Notes
    -----
    The highest coefficient of a polynomial of degree d = n - 1, fitted to m >= n readings evenly over the time L,
    has the variance (2d + 1) C(2d, d)^2 R / (m L^2d), by Legendre's polynomials; T later it counts T^2d times.
    """
    if len(component.drift) == 1:  # the next reading tells all there is, however far it was
        return GapLimit(np.inf)
    order = 1 if component.returns else len(component.parts[0].state_names)
    degree, spans = order - 1, np.inf
    if degree and component.keeps_level and noise_variance > 0:
        spans = (_CARRIED * order / ((2 * degree + 1) * comb(2 * degree, degree) ** 2)) ** (1 / (2 * degree))
    return GapLimit(longest_gap(component, noise_variance), spans, len(component.drift))


def longest_gap(component: Component, noise_variance: float) -> float:
    """Return the longest gap after which a reading leaves digits of what was predicted, in steps; a power of two.

    Parameters
    ----------
    component : Component
        The model, in steps.
    noise_variance : float
        R, in unit^2; with a *small* one only short gaps do.

    Returns
    -------
    float
        The longest over which the variance of what is read grows by no more than 1e15 R, 2 at least; inf where it
        stays below that over any time that a clock can count, or where there is no noise to compare with.
    """
    if not noise_variance > 0:
        return np.inf
    with np.errstate(all="ignore"):
        _, Q = component.over(_LENGTHS)
        grown = (component.output @ Q @ component.output.T)[:, 0, 0]
    beyond = np.flatnonzero(~(grown <= _FORGOTTEN * noise_variance))
    return max(_LEAST, float(_LENGTHS[max(beyond[0] - 1, 0)])) if len(beyond) else np.inf


def least_gap_limit(limits: Sequence[GapLimit]) -> GapLimit:
    """Return the limit of several modes: which gaps all of them bridge."""
    longest, spans, readings = zip(*limits, strict=True)
    return GapLimit(min(longest), min(spans), max(readings))
