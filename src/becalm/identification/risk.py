"""When no motion describes the signal: the white floor of the spectrum, and the least risk.

Maximum likelihood is right when the model is. When it is not (a sine is no random walk), it lets
white noise pass for motion. Then two things still hold without any model: white noise lies under
every band of the spectrum, so the quietest band bounds it; and the mean squared error of a linear
filter can be estimated without truth. Source: Stein, Annals of Statistics 9 (1981) 1135.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio, ratio_to_cutoff
from becalm.core.filter.channel_record import ChannelRecord
from becalm.identification.imputation import completed
from becalm.identification.likelihood import Candidate, Evidence, Tuning
from becalm.identification.spectrum import periodogram, welch_power
from becalm.metrics.whiteness import whiteness

MISFIT = 0.02
"""Share of the innovation power above which a motion does not describe the signal."""

_SEGMENT = 512
_FEWEST = 4 * _SEGMENT
_SEARCH = (-1.0, 0.7)  # about the likeliest cut-off, in its logarithm
_PRECISION = 3e-3
_BETTER = 0.1  # of a mean squared error, by which it must be less for tones
_EXPLAINED = 4.0  # times less than that: flanks of tones, which white noise at rest would contradict
_HONEST = 4.0  # times what sigma claims
_PARTS = 8  # of the band
_PIECE, _PIECES = 1 << 15, 4  # readings of a long record that filters are compared on


def retune(tuning: Tuning, evidence: Evidence) -> Tuning:
    """Give back white noise that the likelihood took for motion; a tuning that fits comes back as it is.

    Parameters
    ----------
    tuning : Tuning
        The likeliest.
    evidence : Evidence
        The readings it was tuned on; at least 2048 in even time but for jitter and short holes, otherwise the tuning
        stays.
    """
    from scipy.optimize import minimize_scalar

    readings, evidence = len(evidence.z), completed(evidence, tuning)
    if not _is_whole(evidence) or len(evidence.z) < readings:
        return tuning
    _, share = _risk(tuning, evidence)
    floor = white_floor(evidence.z[:, 0])
    if share <= MISFIT or floor <= tuning.noise_variance:
        return tuning

    def at(log_cutoff: float) -> Tuning:
        ratio = cutoff_to_ratio(tuning.order, float(np.exp(log_cutoff)))
        return replace(tuning, ratio=ratio, noise_variance=floor)

    likeliest = np.log(ratio_to_cutoff(tuning.order, tuning.ratio))
    found = minimize_scalar(
        lambda log_cutoff: _risk(at(log_cutoff), evidence)[0],
        bounds=(likeliest + _SEARCH[0], likeliest + _SEARCH[1]),
        method="bounded",
        options={"xatol": _PRECISION},
    )
    best = at(float(found.x))
    likelihood = Candidate(tuning.order, evidence).score(best.ratio).log_likelihood
    return replace(best, log_likelihood=float(likelihood), at_edge="")


def white_floor(z: Floats) -> float:
    """Return the variance, in unit^2, of white noise as loud as the quietest quarter of the band.

    Notes
    -----
    Of z (N,) in Hann segments of 512, but for the lowest two frequencies, which hold the level, and the highest.
    """
    power = welch_power(z, np.hanning(_SEGMENT))[2:-1]
    quarter = len(power) // 4
    return float(np.convolve(power, np.ones(quarter) / quarter, "valid").min())


def floor_between_lines(z: Floats) -> float:
    """Return the variance, in unit^2, of white noise as loud as the quietest part of a record (N,), lines left out.

    The median of a periodogram, which few lines move, is log 2 times its mean where it is noise, to 1.44 over the
    root of how many frequencies there are; 1.4 times that lies the lowest of eight below what they all are.
    """
    parts = np.array_split(periodogram(z).power, _PARTS)
    lowest = min(float(np.median(part)) for part in parts) / float(np.log(2))
    return lowest * (1 + 1.4 * 1.44 / float(np.sqrt(len(parts[0]))))


def less_risky(tuning: Tuning, other: Tuning, evidence: Evidence, causal: bool) -> Tuning:
    """Return the first tuning if its filter, or smoother, errs less by its estimated risk; otherwise the second.

    Its tones must not have taken the place of white noise, whose variance would be far below the quietest part of
    the band. It must be better by a tenth, and its sigma not too small by more than a factor of two, unless it is
    better by half.

    Parameters
    ----------
    tuning, other : Tuning
        Motions, the first with tones. Its noise variance is believed for both, or what lies between the lines of the
        quietest part of the band, if that is less: what a model does not describe, it takes for noise.
    evidence : Evidence
        Readings, in unit; of very many, some long pieces are looked at.
    causal : bool
        Whether filters (True) or smoothers shall be compared.

    Notes
    -----
    Cross-validation cannot compare a smoother that leaves each reading half its weight with one that leaves it a
    tenth: it asks how a reading is told by the others, and its own word counts for much in the first.
    """
    whole = completed(evidence, tuning)
    longest = max(whole.even, key=lambda part: part.stop - part.start, default=slice(0))
    floors = [floor_between_lines(whole.z[longest, 0])] if longest.stop else []
    if floors and tuning.noise_variance < floors[0] / _EXPLAINED:
        return other
    R = min(tuning.noise_variance, *floors)
    one, two = (estimated_risk(each, evidence, R, causal) for each in (tuning, other))
    better = one.error < two.error - _BETTER * min(two.error, two.claimed)
    honest = one.error < _HONEST * one.claimed + 3 * R * np.sqrt(2 / max(one.readings, 1)) or one.error < two.error / 2
    return tuning if better and honest else other


class Risk(NamedTuple):
    """Of a filter or smoother over a record."""

    error: float  # mean square, unit^2, as estimated; NaN where no stretch tells the state
    claimed: float  # mean of sigma^2, unit^2
    readings: int


def estimated_risk(tuning: Tuning, evidence: Evidence, noise_variance: float, causal: bool) -> Risk:
    """Estimate how far a filter, or a smoother, errs over a record, given the variance of a reading's noise, unit^2."""
    component, r = tuning.component, tuning.noise_variance
    squares, weights = list[Floats](), list[Floats]()
    for part in long_pieces(evidence):
        z = evidence.z[part, 0]
        record = ChannelRecord(component, r, z, evidence.elapsed[part])
        found = record.filtered() if causal else record.smoothed()
        told = np.isfinite(found.sigma)
        squares.append((z - found.signal)[told] ** 2)
        weights.append(found.sigma[told] ** 2 / r)
    every = np.concatenate(squares)
    if not len(every):
        return Risk(np.nan, np.nan, 0)
    weight = float(np.concatenate(weights).mean())
    return Risk(float(every.mean()) + noise_variance * (2 * weight - 1), r * weight, len(every))


def long_pieces(evidence: Evidence) -> list[slice]:
    """Return the stretches; of a long record some pieces, long enough for tones to be learnt."""
    if len(evidence.z) <= _PIECES * _PIECE:
        return evidence.stretches
    starts = np.linspace(0, len(evidence.z) - _PIECE, _PIECES).astype(int)
    return [slice(start, start + _PIECE) for start in starts.tolist()]


def _is_whole(evidence: Evidence) -> bool:
    """Whether one stretch in even time, but for a little jitter, holds all of enough readings."""
    return len(evidence.z) >= _FEWEST and evidence.complete == [slice(0, len(evidence.z))]


def _risk(tuning: Tuning, evidence: Evidence) -> tuple[float, float]:
    """Estimate the mean squared error of the causal filter, and the predictable share of its innovations.

    Where the readings never tell the state, the first is inf and the second 0.
    """
    component, r, z = tuning.component, tuning.noise_variance, evidence.z[:, 0]
    estimate = ChannelRecord(component, r, z, evidence.elapsed).filtered()
    known = np.isfinite(estimate.sigma)
    known[: len(component.drift)] = False
    if not known.any():
        return np.inf, 0.0
    weight = float(np.mean(estimate.sigma[known] ** 2)) / r  # of each reading in its own estimate
    residual = (z - estimate.signal)[known]
    normalised = estimate.innovation / estimate.deviation
    return float(np.mean(residual**2)) + r * (2 * weight - 1), whiteness(normalised).predictable_share
