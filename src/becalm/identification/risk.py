"""Retune a model that does not fit: R from the noise floor of the spectrum, the cut-off from the estimated risk.

Maximum likelihood is accurate if the model describes the signal. If it does not (a sine is not a random walk), maximum
likelihood counts white noise as motion. Two facts hold for any signal. White noise has the same power in every band of
the spectrum, so the band of least power is an upper bound of it. The mean squared error of a linear filter can be
estimated without the truth. Source: Stein, Annals of Statistics 9 (1981) 1135.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio, ratio_to_cutoff
from becalm.core.filter.channel import ChannelRecord
from becalm.identification.imputation import completed
from becalm.identification.likelihood import Candidate, Evidence, Tuning
from becalm.identification.spectrum import periodogram, welch_power
from becalm.metrics.whiteness import whiteness

MISFIT = 0.02
"""Predictable share of the innovation power above which a motion does not describe the signal."""

_SEGMENT = 512
_FEWEST = 4 * _SEGMENT
_SEARCH = (-1.0, 0.7)  # range of the search about the likeliest cut-off, in its logarithm
_PRECISION = 3e-3
_BETTER = 0.1  # least reduction of the mean squared error by tones, as a share of the error or sigma^2 without tones
_ABSORBED = 4.0  # if R is so many times below the noise floor, the tones have absorbed white noise
_CONSISTENT = 4.0  # largest ratio of squared error to sigma^2 that counts as consistent
_PARTS = 8  # of the band
_PIECE, _PIECES = 1 << 15, 4  # readings in a piece of a long record, and pieces, that filters are compared on


def retune(tuning: Tuning, evidence: Evidence) -> Tuning:
    """Raise R to the noise floor and tune the cut-off by the estimated risk; leave a model that fits unchanged.

    Parameters
    ----------
    tuning : Tuning
        The likeliest tuning.
    evidence : Evidence
        The readings it was tuned on. Fewer than 2048, or readings that are not evenly sampled apart from jitter and
        short holes, leave the tuning unchanged.
    """
    from scipy.optimize import minimize_scalar

    readings, evidence = len(evidence.z), completed(evidence, tuning)
    if not _is_whole(evidence) or len(evidence.z) < readings:
        return tuning
    _, share = _risk_and_predictable_share(tuning, evidence)
    floor = noise_floor_welch(evidence.z[:, 0])
    if share <= MISFIT or floor <= tuning.noise_variance:
        return tuning

    def at(log_cutoff: float) -> Tuning:
        ratio = cutoff_to_ratio(tuning.order, float(np.exp(log_cutoff)))
        return replace(tuning, ratio=ratio, noise_variance=floor)

    likeliest = np.log(ratio_to_cutoff(tuning.order, tuning.ratio))
    result = minimize_scalar(
        lambda log_cutoff: _risk_and_predictable_share(at(log_cutoff), evidence)[0],
        bounds=(likeliest + _SEARCH[0], likeliest + _SEARCH[1]),
        method="bounded",
        options={"xatol": _PRECISION},
    )
    best = at(float(result.x))
    likelihood = Candidate(tuning.order, evidence).score(best.ratio).log_likelihood
    return replace(best, log_likelihood=float(likelihood), at_edge="")


def noise_floor_welch(z: Floats) -> float:
    """Return the variance, in unit^2, of white noise as loud as the quietest quarter of the band of z (N,).

    Notes
    -----
    The spectrum is that of Hann segments of 512, without the lowest two frequencies, into which the window leaks slow
    motion, and without the highest.
    """
    power = welch_power(z, np.hanning(_SEGMENT))[2:-1]
    quarter = len(power) // 4
    return float(np.convolve(power, np.ones(quarter) / quarter, "valid").min())


def noise_floor_median(z: Floats) -> float:
    """Return the variance, in unit^2, of white noise as loud as the quietest eighth of the band of z (N,).

    The median of the periodogram of noise is log 2 times its mean, and a few tones do not change it. Its relative
    standard error is 1.44 over the root of the number of frequencies. On average the lowest of eight medians is 1.4
    standard errors too low, which is corrected.
    """
    parts = np.array_split(periodogram(z).power, _PARTS)
    lowest = min(float(np.median(part)) for part in parts) / float(np.log(2))
    return lowest * (1 + 1.4 * 1.44 / float(np.sqrt(len(parts[0]))))


def choose_by_risk(tuning: Tuning, other: Tuning, evidence: Evidence, causal: bool) -> Tuning:
    """Return the first tuning if the estimated risk of its filter, or smoother, is smaller; otherwise the second.

    The first tuning is rejected if its R is far below the noise floor, because its tones have then absorbed white
    noise. Its risk must be smaller by a tenth of the second tuning's risk or sigma^2, whichever is smaller. Its sigma
    must not be too small by more than a factor of two beyond chance, unless its risk is less than half of the second's.

    Parameters
    ----------
    tuning, other : Tuning
        Motion models, the first with tones. Both are judged with one R: the smaller of the first tuning's R and the
        noise floor, because a model counts as noise what it does not describe.
    evidence : Evidence
        Readings in unit; a few long pieces of a very long record are used.
    causal : bool
        True compares filters, False smoothers.

    Notes
    -----
    Cross-validation cannot compare two smoothers that give a reading the weights 0.5 and 0.1 in its own estimate: it
    predicts a reading from the others only, while the first smoother relies on the reading itself.
    """
    whole = completed(evidence, tuning)
    longest = max(whole.even, key=lambda part: part.stop - part.start, default=slice(0))
    floors = [noise_floor_median(whole.z[longest, 0])] if longest.stop else []
    if floors and tuning.noise_variance < floors[0] / _ABSORBED:
        return other
    R = min(tuning.noise_variance, *floors)
    one, two = (estimated_risk(each, evidence, R, causal) for each in (tuning, other))
    better = one.error < two.error - _BETTER * min(two.error, two.predicted)
    consistent = (
        one.error < _CONSISTENT * one.predicted + 3 * R * np.sqrt(2 / max(one.readings, 1)) or one.error < two.error / 2
    )
    return tuning if better and consistent else other


class Risk(NamedTuple):
    """The error of a filter or smoother over a record, estimated without the truth."""

    error: float  # estimated mean squared error, unit^2; NaN if no stretch determines the state
    predicted: float  # mean squared error by the model: mean of sigma^2, unit^2
    readings: int


def estimated_risk(tuning: Tuning, evidence: Evidence, noise_variance: float, causal: bool) -> Risk:
    """Estimate the mean squared error of a filter, or a smoother, over a record.

    `noise_variance` is the variance of a reading's noise, in unit^2.
    """
    component, r = tuning.component, tuning.noise_variance
    squares, weights = list[Floats](), list[Floats]()
    for part in long_pieces(evidence):
        z = evidence.z[part, 0]
        record = ChannelRecord(component, r, z, evidence.elapsed[part])
        estimate = record.filtered() if causal else record.smoothed()
        determined = np.isfinite(estimate.sigma)
        squares.append((z - estimate.signal)[determined] ** 2)
        weights.append(estimate.sigma[determined] ** 2 / r)
    every = np.concatenate(squares)
    if not len(every):
        return Risk(np.nan, np.nan, 0)
    weight = float(np.concatenate(weights).mean())
    return Risk(float(every.mean()) + noise_variance * (2 * weight - 1), r * weight, len(every))


def long_pieces(evidence: Evidence) -> list[slice]:
    """Return the stretches, or a few pieces of a long record, each long enough for a filter to lock on to tones."""
    if len(evidence.z) <= _PIECES * _PIECE:
        return evidence.stretches
    starts = np.linspace(0, len(evidence.z) - _PIECE, _PIECES).astype(int)
    return [slice(start, start + _PIECE) for start in starts.tolist()]


def _is_whole(evidence: Evidence) -> bool:
    """Return whether there are enough readings, all evenly sampled apart from a little jitter, and none missing."""
    return len(evidence.z) >= _FEWEST and evidence.complete == [slice(0, len(evidence.z))]


def _risk_and_predictable_share(tuning: Tuning, evidence: Evidence) -> tuple[float, float]:
    """Return the estimated mean squared error of the causal filter, and the predictable share of its innovations.

    If the readings never determine the state, the error is inf and the share 0.
    """
    component, r, z = tuning.component, tuning.noise_variance, evidence.z[:, 0]
    estimate = ChannelRecord(component, r, z, evidence.elapsed).filtered()
    determined = np.isfinite(estimate.sigma)
    determined[: len(component.drift)] = False  # the first n estimates pass through the readings themselves
    if not determined.any():
        return np.inf, 0.0
    weight = float(np.mean(estimate.sigma[determined] ** 2)) / r  # of each reading in its own estimate
    residual = (z - estimate.signal)[determined]
    normalised = estimate.innovation / estimate.deviation
    return float(np.mean(residual**2)) + r * (2 * weight - 1), whiteness(normalised).predictable_share
