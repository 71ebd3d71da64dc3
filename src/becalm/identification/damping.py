"""The damping of a motion, by which its own spread is that of the record, so that predictions are bounded.

A kinematic model is integrated noise: without readings its estimate runs away, and its variance grows without end.
Damped below a frequency a it is stationary about a level of its own, and in the band where the filter works, beyond a,
it is the model that it was. One number is to be found, and the record says which: with the variance
V = q / (2 n sin(pi / 2n) a^(2n-1)) of the damped motion about its level that of the signal about its own level. Where
the readings are foretold worse for it, as those of a ramp, which does not return, the damping is halved, and at last
left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import ratio_to_cutoff
from becalm.core.filter.channel_record import ChannelRecord
from becalm.core.filter.likelihood_sums import Sums
from becalm.core.model.components import LEVEL_RATE
from becalm.identification.likelihood import Evidence, Tuning

_LEAST = 1e-250  # of a noise variance: of less, or of more than one over it, no recipe is made
_ROUNDS = 12
_SAME = 1e-3  # of a damping, by which another round changes it
_CHANCE = 4.0  # standard errors of a variance, below which a spread is not told from noise
_SLOWEST = 1.0  # radians that the record has to last, for a motion of order 1 to be seen returning
_NEVER = 1e-8  # radians a step: what is damped less returns in no record
_BLOCK, _AT_ONCE = 64, 5.0  # readings that are averaged at once; a rate from which on a level is the reading
_HALVINGS = 12
_DOUBT = 2.0  # of a log-likelihood: what a damping may cost
_BEGUN = 64  # readings that are not scored
_FASTEST = np.pi / 4  # radians a step, and
_HIGHEST = 1.0  # of the cut-off: beyond, the motion would be damped where it is read


def damped(tuning: Tuning, evidence: Evidence) -> Tuning:
    """Return a tuning whose motion returns to its level, with the spread about it that the record shows.

    Parameters
    ----------
    tuning : Tuning
        As it was found, perhaps with tones and coloured noise; with a density of 0 it comes back as it is.
    evidence : Evidence
        What it was found in.

    Notes
    -----
    A random walk that does not return within the record stays one: it predicts what was read last, and is bounded.
    """
    n, density = tuning.order, tuning.ratio * tuning.noise_variance
    if not (density > 0 and _LEAST < tuning.noise_variance < 1 / _LEAST):
        return tuning
    z, steps = evidence.z[:, 0], float(evidence.elapsed[1:].sum()) / max(len(evidence.z) - 1, 1)
    beside = tuning.noise_variance + sum(line.density / (2 * line.damping) for line in tuning.lines)
    beside += 0.0 if tuning.coloured is None else tuning.coloured.variance
    least = max(_CHANCE * beside * np.sqrt(2 / len(z)), evidence.smallest_variance)
    spread, damping = float(np.var(z)), 0.0
    for _ in range(_ROUNDS):
        before = damping
        variance = max(spread - beside, least)
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
    """Return the log-likelihood a reading of the sample of a record, each piece begun anew; -inf where none tells it.

    A mean, for filters may know their state from different readings on, and each log-density holds that of the unit.
    """
    component, r, total = tuning.component, tuning.noise_variance, Sums()
    for part in evidence.sample:
        z = evidence.z[part, 0]
        total = total.plus(ChannelRecord(component, r, z, evidence.elapsed[part]).score(min(_BEGUN, len(z) // 4)))
    return total.log_likelihood / total.used if total.used else -np.inf


def spread_std(evidence: Evidence) -> float | None:
    """Return the standard deviation of readings, in unit; None where they do not vary."""
    found = float(evidence.z.std())
    return found if found > 0 else None


def spread_about_level(z: Floats, rate: float) -> float:
    """Return the mean square of readings (N,) about a mean whose weights fade by a rate, 1 / reading, in unit^2."""
    if not rate > 0:
        return float(np.var(z))
    rate, total = min(rate, _AT_ONCE), 0.0
    level, fades = float(z[: max(1, int(min(1 / rate, len(z))))].mean()), np.exp(-rate * np.arange(1, _BLOCK + 1))
    shares = -np.expm1(-rate) / fades  # each reading's, told from the start of its block
    for start in range(0, len(z), _BLOCK):
        block = z[start : start + _BLOCK]
        levels = fades[: len(block)] * (level + np.cumsum(shares[: len(block)] * block))
        level, total = float(levels[-1]), total + float(((block - levels) ** 2).sum())
    return total / len(z)
