"""Compute the likelihood of a record as a surface over the noise variance and the density of a motion.

At a given ratio q/r the filter's gains do not depend on r. With the innovations nu and their variances S of a filter
run with r = 1,

    -log L / N = 1/2 (log 2 pi + mean log S + log r + mean(nu^2 / S) / r)

so one run per ratio gives all points of the surface with this ratio, a diagonal (Harvey, Forecasting, Structural Time
Series Models and the Kalman Filter (1989), section 4.2). The densities of tones and the variance of coloured noise are
scaled with r.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.channel import ChannelRecord, Sums
from becalm.identification.likelihood import FEWEST_READINGS, UNSCORED, Evidence, Tuning

_NOISES, _DENSITIES = 41, 61  # points of the surface along each axis
_NOISE_DECADES = 2.0  # decades of the noise's standard deviation on each side of the centre
_LEAST_RATIO = 1e-9  # q/r at the centre of the surface if the tuning has no process noise


class Surface(NamedTuple):
    """The cost of each pair of noise and density around a tuning.

    Attributes
    ----------
    noise_std : (k,) float array
        Standard deviations of a reading's noise, in the readings' unit.
    density : (l,) float array
        Densities q, in unit^2/step^(2n-1).
    cost : (k, l) float array
        Loss in mean log-likelihood of a reading, in nats, 0 at the best pair; inf where no reading was scored.
    """

    noise_std: Floats
    density: Floats
    cost: Floats


def surface(tuning: Tuning, stretches: Sequence[Evidence]) -> Surface | None:
    """Return how much worse each pair of noise and density predicts the readings than the best pair.

    Parameters
    ----------
    tuning : Tuning
        The tuning at the centre of the surface.
    stretches : sequence of Evidence
        Stretches of readings; the filter starts anew in each.

    Returns
    -------
    Surface or None
        The surface; None if there are too few readings.
    """
    ratio = tuning.ratio or _LEAST_RATIO
    decades = _NOISE_DECADES * np.linspace(-1.0, 1.0, _NOISES)
    step = 2 * float(decades[1] - decades[0])  # decades of variance and of density, equal so that ratios are diagonals
    runs = _FilterRuns(tuning, stretches)
    least = step * -(_NOISES // 2 + _DENSITIES // 2)
    sums = [runs.sums(ratio * 10.0 ** (least + step * k)) for k in range(_NOISES + _DENSITIES - 1)]
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


class _FilterRuns:
    """The runs of a filter with r = 1 over stretches of readings, at any ratio q/r."""

    def __init__(self, tuning: Tuning, stretches: Sequence[Evidence]) -> None:
        r, noise = tuning.noise_variance, tuning.coloured
        unit = replace(
            tuning,
            ratio=1.0,
            noise_variance=1.0,
            tones=tuple(tone._replace(density=tone.density / r) for tone in tuning.tones),
            coloured=None if noise is None else noise._replace(variance=noise.variance / r),
        )
        component = unit.component
        noiseless = replace(unit, ratio=0.0).component
        self._records = [
            tuple(ChannelRecord(one, 1.0, evidence.z[:, 0], evidence.elapsed) for one in (component, noiseless))
            for evidence in stretches
        ]

    def sums(self, ratio: float) -> tuple[float, float, int]:
        """Return the sums of nu^2 / S and of log S at a ratio q/r, and the number of readings."""
        total = Sums()
        for record, noiseless in self._records:
            other_noise = noiseless.process_noise
            total = total.plus(record.score(UNSCORED, other_noise + ratio * (record.process_noise - other_noise)))
        return total[0], total[1], total[2]
