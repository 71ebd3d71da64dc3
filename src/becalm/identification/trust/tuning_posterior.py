"""Compute the expected error of an estimate over all random walks that may have made a short record.

The walks have the chosen order and any cut-off. They are weighted by their likelihood, with a flat prior on the
logarithms of cut-off and noise variance. With the weights w, each walk's estimate y_i and its variance P_i,

    E[(x - y)^2] = sum of w_i (P_i + (y_i - y)^2)

at each reading, which is exact where the record is such a walk (Hoeting et al., Statistical Science 14 (1999) 382). It
holds only if the innovations of the likeliest walk are white; otherwise no walk describes the record, and the weights
mean nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio
from becalm.core.filter.channel import ChannelRecord, Estimates
from becalm.identification.likelihood import Candidate, Evidence, Tuning
from becalm.metrics.whiteness import whiteness

_SLOWEST_CYCLES, _FASTEST = 0.02, 4.0  # cycles in the record, far slower than it can resolve; radians per step
_COARSE, _FINE, _WALKS = 15, 9, 8  # points over all cut-offs, and around the likeliest; walks that represent all
_EVERY = 400  # cut-offs at which the likelihood is interpolated
_BY_CHANCE = 0.01  # least p-value of whiteness: one true walk in a hundred is rejected


def posterior_widening(tuning: Tuning, evidence: Evidence, causal: bool) -> float | None:
    """Return the factor by which sigma must be widened, as a root mean square over the readings.

    Parameters
    ----------
    tuning : Tuning
        The motion, without tones, of the given estimate.
    evidence : Evidence
        The readings, at most a few thousand.
    causal : bool
        True if the estimate is a filter's, False if a smoother's.

    Returns
    -------
    float or None
        The factor; None where no walk describes the readings.
    """
    candidate = Candidate(tuning.order, evidence)
    likelihoods = _likelihoods(candidate)
    if likelihoods is None or not _describes(_walk(candidate, likelihoods.likeliest), evidence):
        return None
    walks = [_walk(candidate, log_cutoff) for log_cutoff in likelihoods.quantiles(_WALKS)]
    signal, variance = _estimate(tuning, evidence, causal)
    others = [_estimate(walk, evidence, causal) for walk in walks]
    expected = np.mean([own + (other - signal) ** 2 for other, own in others], axis=0)
    known = np.isfinite(variance) & np.isfinite(expected) & (variance > 0)
    return float(np.sqrt(np.mean(expected[known] / variance[known]))) if known.any() else None


class _Likelihoods(NamedTuple):
    """The likelihood of one order over the logarithm of the cut-off."""

    log_cutoff: Floats  # (k,) ascending
    log_likelihood: Floats  # (k,)

    @property
    def likeliest(self) -> float:
        return float(self.log_cutoff[int(np.argmax(self.log_likelihood))])

    def quantiles(self, count: int) -> Floats:
        """Return logarithms of cut-offs (count,) that each represent an equal share of the likelihood."""
        mass = np.cumsum(np.exp(self.log_likelihood - self.log_likelihood.max()))
        log_cutoffs: Floats = np.interp((np.arange(count) + 0.5) / count, mass / mass[-1], self.log_cutoff)
        return log_cutoffs


def _likelihoods(candidate: Candidate) -> _Likelihoods | None:
    """Score all cut-offs, more densely around the likeliest; None where no reading is scored."""

    def scores(log_cutoffs: Floats) -> Floats:
        ratios = [cutoff_to_ratio(candidate.order, float(each)) for each in np.exp(log_cutoffs)]
        return np.array([candidate.score(ratio).log_likelihood for ratio in ratios])

    slowest = 2 * np.pi * _SLOWEST_CYCLES / candidate.evidence.longest_steps
    coarse = np.linspace(np.log(slowest), np.log(_FASTEST), _COARSE)
    first = scores(coarse)
    if not np.isfinite(first).all():
        return None
    best, step = int(np.argmax(first)), coarse[1] - coarse[0]
    nearby = coarse[best] + step * np.linspace(-1, 1, _FINE + 2)[1:-1]
    nearby = nearby[(nearby > coarse[0]) & (nearby < coarse[-1]) & (np.arange(_FINE) != _FINE // 2)]
    at, values = np.concatenate([coarse, nearby]), np.concatenate([first, scores(nearby)])
    from scipy.interpolate import CubicSpline  # imported only for short records

    ascending, every = np.argsort(at), np.linspace(coarse[0], coarse[-1], _EVERY)
    return _Likelihoods(every, CubicSpline(at[ascending], values[ascending])(every))


def _walk(candidate: Candidate, log_cutoff: float) -> Tuning:
    """Return a walk with the mean noise variance for its cut-off, used / (used - 2) times the likeliest."""
    ratio = cutoff_to_ratio(candidate.order, float(np.exp(log_cutoff)))
    _, r, used = candidate.score(ratio)
    return Tuning(candidate.order, ratio, r * used / max(used - 2, 1), used)


def _describes(tuning: Tuning, evidence: Evidence) -> bool:
    """Return whether the innovations of a walk are white, up to chance."""
    innovations = [
        estimates.innovation / estimates.deviation for estimates in _run_stretches(tuning, evidence, causal=True)
    ]
    return whiteness(np.concatenate(innovations)).p_value > _BY_CHANCE


def _estimate(tuning: Tuning, evidence: Evidence, causal: bool) -> tuple[Floats, Floats]:
    """Return the estimates (N,), in unit, and their variances (N,), unit^2, at the readings."""
    estimates = _run_stretches(tuning, evidence, causal)
    signal, sigma = (np.concatenate([getattr(part, name) for part in estimates]) for name in ("signal", "sigma"))
    return signal, sigma**2


def _run_stretches(tuning: Tuning, evidence: Evidence, causal: bool) -> list[Estimates]:
    """Run a filter, or a smoother, over each stretch."""
    records = [
        ChannelRecord(tuning.component, tuning.noise_variance, evidence.z[part, 0], evidence.elapsed[part])
        for part in evidence.stretches
    ]
    return [record.filtered() if causal else record.smoothed() for record in records]
