"""Damp a motion model so that its spread equals that of the record, and its predictions stay bounded.

A kinematic model is integrated white noise: without readings its estimate runs away, and its variance grows without
bound. A model that is damped below a frequency a varies about a level, a mean of its past, with bounded variance. Above
a, in the band where the filter works, the model does not change. The record determines a: the variance V = q / (2 n
sin(pi / 2n) a^(2n-1)) of the damped motion about its level must equal the variance of the signal about the signal's
level. If the damped model predicts the readings worse, as on a ramp, which does not return, the damping is halved
repeatedly, and finally left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import ratio_to_cutoff
from becalm.core.filter.channel import ChannelRecord, Sums
from becalm.core.model.components import LEVEL_RATE
from becalm.identification.likelihood import Evidence, Tuning

_LEAST = 1e-250  # smallest noise variance, unit^2, of a model that is damped; the largest is 1 / _LEAST
_ROUNDS = 12  # most iterations
_SAME = 1e-3  # relative change of the damping at which the iteration ends
_CHANCE = 4.0  # standard errors of the noise variance; a smaller variance of the signal may be chance
_SLOWEST = 1.0  # least damping times duration, in radians, for a record to show that a motion of order 1 returns
_NEVER = 1e-8  # radians a step; with less damping a motion returns in no record
_BLOCK, _AT_ONCE = 64, 5.0  # readings in a block; highest rate of the mean, 1/reading, at which it follows at once
_HALVINGS = 12  # most dampings that are tried, each half of the previous one
_DOUBT = 2.0  # largest loss in log-likelihood with which a damping is still accepted
_UNSCORED = 64  # first readings of a piece, or a quarter of a shorter one, which are not scored
_FASTEST = np.pi / 4  # largest damping, in radians a step, ...
_HIGHEST = 1.0  # ... and as a multiple of the cut-off; a larger one would change the band where the filter works


def damped(tuning: Tuning, evidence: Evidence) -> Tuning:
    """Return a tuning whose motion returns to its level, with the spread that the record shows.

    Parameters
    ----------
    tuning : Tuning
        Undamped, perhaps with tones and coloured noise. If its density is 0, it is returned unchanged.
    evidence : Evidence
        The readings it was tuned on.

    Notes
    -----
    A random walk that does not return within the record is not damped: its prediction, the last level, is bounded.
    """
    n, density = tuning.order, tuning.ratio * tuning.noise_variance
    if not (density > 0 and _LEAST < tuning.noise_variance < 1 / _LEAST):
        return tuning
    z, steps = evidence.z[:, 0], float(evidence.elapsed[1:].sum()) / max(len(evidence.z) - 1, 1)
    other_variance = tuning.noise_variance + sum(tone.density / (2 * tone.damping) for tone in tuning.tones)
    other_variance += 0.0 if tuning.coloured is None else tuning.coloured.variance
    least = max(_CHANCE * other_variance * np.sqrt(2 / len(z)), evidence.smallest_variance)
    spread, damping = float(np.var(z)), 0.0
    for _ in range(_ROUNDS):
        before = damping
        variance = max(spread - other_variance, least)
        damping = (density / (2 * n * np.sin(np.pi / (2 * n)) * variance)) ** (1 / (2 * n - 1))
        if abs(damping - before) <= _SAME * damping:
            break
        spread = spread_about_level(z, LEVEL_RATE * damping * steps)
    returns = variance > least and damping * len(z) * steps > _SLOWEST
    if n == 1 and not returns:
        return tuning
    highest = float(min(damping, _FASTEST, _HIGHEST * ratio_to_cutoff(n, tuning.ratio)))
    dampings = (highest / 2**k for k in range(_HALVINGS))
    tried = (replace(tuning, damping=damping) for damping in dampings if damping > _NEVER)
    least = _mean_log_likelihood(tuning, evidence) - _DOUBT / len(z)
    return next((one for one in tried if _mean_log_likelihood(one, evidence) >= least), tuning)


def _mean_log_likelihood(tuning: Tuning, evidence: Evidence) -> float:
    """Return the mean log-likelihood of a reading, over pieces of the record; -inf if no piece starts the filter.

    The filter starts anew in each piece. Means of two filters can be compared. Sums cannot, because the filters may
    need different numbers of readings to start, and the log-density of each reading depends on the unit.
    """
    component, r, total = tuning.component, tuning.noise_variance, Sums()
    for part in evidence.sample:
        z = evidence.z[part, 0]
        total = total.plus(ChannelRecord(component, r, z, evidence.elapsed[part]).score(min(_UNSCORED, len(z) // 4)))
    return total.log_likelihood / total.used if total.used else -np.inf


def spread_std(evidence: Evidence) -> float | None:
    """Return the standard deviation of the readings, in unit; None where they do not vary."""
    std = float(evidence.z.std())
    return std if std > 0 else None


def spread_about_level(z: Floats, rate: float) -> float:
    """Return the mean square, unit^2, of readings (N,) about their exponential mean, whose rate is in 1/reading."""
    if not rate > 0:
        return float(np.var(z))
    rate, total = min(rate, _AT_ONCE), 0.0
    level, fades = float(z[: max(1, int(min(1 / rate, len(z))))].mean()), np.exp(-rate * np.arange(1, _BLOCK + 1))
    shares = -np.expm1(-rate) / fades  # weight of each reading over the decay since the start of its block
    for start in range(0, len(z), _BLOCK):
        block = z[start : start + _BLOCK]
        levels = fades[: len(block)] * (level + np.cumsum(shares[: len(block)] * block))
        level, total = float(levels[-1]), total + float(((block - levels) ** 2).sum())
    return total / len(z)
