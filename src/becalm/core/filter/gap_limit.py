"""Find the longest gap that a filter may bridge before float64 loses the information from before the gap.

Across a gap of T steps the predicted variance of a kinematic model of order n grows as q T^(2n-1); the part that comes
from the first readings grows as (T / L)^(2n-2), where L is the time that these readings span. The first reading after
the gap reduces the variance to about R in one update. If the predicted variance is too many times R, the difference has
no correct digit left. In that case the readings before the gap have almost no information on those after it, so that a
filter that restarts after the gap loses almost nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import comb
from typing import NamedTuple

import numpy as np

from becalm.core.model.components import Component

_FORGOTTEN = 1e15  # largest predicted variance over R; from 1e18 on smoothers lose all digits
_CARRIED = 1e13  # largest part from the first readings over R; it has fewer digits: all are lost from 1e14 on
_LENGTHS = np.ldexp(1.0, np.arange(53))  # steps: whole ones, because coloured noise needs whole steps
_LEAST = 2.0  # steps: two rows one even step apart are not a gap, even with large process noise


class GapLimit(NamedTuple):
    """The gaps that a filter may bridge, as time since the last reading that arrived."""

    longest: float  # steps
    spans: float = np.inf  # longest gap over the time that the earlier readings span, once they determine the state
    readings: int = 1  # number of readings that determine the state


@lru_cache(maxsize=256)
def gap_limit_of(component: Component, noise_variance: float) -> GapLimit:
    """Return the gap limit of a component's filter.

    Parameters
    ----------
    component : Component
        The signal's model, in steps; its first part is the motion.
    noise_variance : float
        R, in unit^2; with a *small* one the filter bridges fewer gaps.

    Notes
    -----
    The highest coefficient of a polynomial of degree d = n - 1, fitted to m >= n readings at even times over the time
    L, has the variance (2d + 1) C(2d, d)^2 R / (m L^2d), by Legendre's polynomials. T later this variance counts T^2d
    times.
    """
    if len(component.drift) == 1:  # one reading determines the only state, after a gap of any length
        return GapLimit(np.inf)
    order = 1 if component.returns else len(component.parts[0].state_names)
    degree, spans = order - 1, np.inf
    if degree and component.keeps_level and noise_variance > 0:
        spans = (_CARRIED * order / ((2 * degree + 1) * comb(2 * degree, degree) ** 2)) ** (1 / (2 * degree))
    return GapLimit(longest_gap(component, noise_variance), spans, len(component.drift))


def longest_gap(component: Component, noise_variance: float) -> float:
    """Return the longest gap, in steps, after which the prediction still has correct digits; a power of two.

    Parameters
    ----------
    component : Component
        The model, in steps.
    noise_variance : float
        R, in unit^2; with a *small* one the longest gap is short.

    Returns
    -------
    float
        The longest gap over which the variance of the measured quantity grows by no more than 1e15 R, at least 2;
        inf if it stays below that over any time that a clock can count, or if R is 0.
    """
    if not noise_variance > 0:
        return np.inf
    with np.errstate(all="ignore"):
        _, Q = component.over(_LENGTHS)
        grown = (component.output @ Q @ component.output.T)[:, 0, 0]
    beyond = np.flatnonzero(~(grown <= _FORGOTTEN * noise_variance))
    return max(_LEAST, float(_LENGTHS[max(beyond[0] - 1, 0)])) if len(beyond) else np.inf


def least_gap_limit(limits: Sequence[GapLimit]) -> GapLimit:
    """Return the gap limit of several modes: the gaps that all of them bridge."""
    longest, spans, readings = zip(*limits, strict=True)
    return GapLimit(min(longest), min(spans), max(readings))
