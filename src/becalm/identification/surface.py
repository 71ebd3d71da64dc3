"""How well every noise and density of a motion would foretell the next reading: the likelihood as a surface.

Of one ratio q/r the filter's gains are the same whatever r is; with the squares and determinants of a pass with r = 1

    -log L / N = 1/2 (log 2 pi + mean log S + log r + mean(nu^2 / S) / r)

so that a pass a ratio is enough for all points of a diagonal (Harvey, Forecasting, Structural Time Series Models and
the Kalman Filter (1989), section 4.2). What stands beside the motion is carried along in proportion to r.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.channel_record import ChannelRecord
from becalm.core.filter.likelihood_sums import Sums
from becalm.identification.likelihood import FEWEST_READINGS, UNSCORED, Evidence, Tuning

_NOISES, _DENSITIES = 41, 61
_NOISE_DECADES = 2.0  # of the standard deviation, to each side
_STILL = 1e-9  # q/r that a surface lies about where a filter believes in no change at all


class Surface(NamedTuple):
    """The cost of each noise and density about a tuning.

    Attributes
    ----------
    noise_std : (k,) float array
        In the readings' unit.
    density : (l,) float array
        q, in unit^2/step^(2n-1).
    cost : (k, l) float array
        In nats a reading, 0 at the best; infinite where none could be foretold.
    """

    noise_std: Floats
    density: Floats
    cost: Floats


def surface(tuning: Tuning, stretches: Sequence[Evidence]) -> Surface | None:
    """Tell how much worse each noise and density foretells readings than the best of them.

    Parameters
    ----------
    tuning : Tuning
        What the surface lies about.
    stretches : sequence of Evidence
        Readings in a row; each starts anew.

    Returns
    -------
    Surface or None
        None of too few readings.
    """
    ratio = tuning.ratio or _STILL
    decades = _NOISE_DECADES * np.linspace(-1.0, 1.0, _NOISES)
    step = 2 * float(decades[1] - decades[0])  # of the variance: as of the densities, so that ratios are diagonals
    passes = _Passes(tuning, stretches)
    least = step * -(_NOISES // 2 + _DENSITIES // 2)
    sums = [passes.sums(ratio * 10.0 ** (least + step * k)) for k in range(_NOISES + _DENSITIES - 1)]
    r = tuning.noise_variance * 10.0 ** (2 * decades)
    of_ratio = np.arange(_DENSITIES)[np.newaxis, :] - np.arange(_NOISES)[:, np.newaxis] + _NOISES - 1
    squares, log_det, used = (np.array([one[place] for one in sums], dtype=float)[of_ratio] for place in range(3))
    if not used.max() >= FEWEST_READINGS:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        cost = 0.5 * ((log_det + squares / r[:, np.newaxis]) / used + np.log(r)[:, np.newaxis])
    cost = np.where(used > 0, cost, np.inf)
    powers = step * (np.arange(_DENSITIES) - _DENSITIES // 2)
    density = np.asarray(ratio * tuning.noise_variance * 10.0**powers)
    return Surface(np.sqrt(r), density, cost - cost.min())


class _Passes:
    """Filters stretches of readings with any ratio q/r, and r = 1."""

    def __init__(self, tuning: Tuning, stretches: Sequence[Evidence]) -> None:
        r, noise = tuning.noise_variance, tuning.coloured
        unit = replace(
            tuning,
            ratio=1.0,
            noise_variance=1.0,
            lines=tuple(line._replace(density=line.density / r) for line in tuning.lines),
            coloured=None if noise is None else noise._replace(variance=noise.variance / r),
        )
        component = unit.component
        still = replace(unit, ratio=0.0).component
        self._records = [
            tuple(ChannelRecord(one, 1.0, evidence.z[:, 0], evidence.elapsed) for one in (component, still))
            for evidence in stretches
        ]

    def sums(self, ratio: float) -> tuple[float, float, int]:
        """Return the sums of nu^2 / S and log S, and how many readings they are of."""
        total = Sums()
        for record, still in self._records:
            beside = still.process_noise
            total = total.plus(record.score(UNSCORED, beside + ratio * (record.process_noise - beside)))
        return total[0], total[1], total[2]
