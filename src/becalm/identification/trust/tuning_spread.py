"""Estimate how much the uncertainty of the tuning itself widens sigma.

A filter's sigma treats q and r as exact. They were identified from the record, and another record of the same motion
would have given other values. For a short record, the error is averaged over all motion models that may have produced
the record (`posterior_widening`). For a long record, theta = log(q/r) has a variance, and

    E[(x - y)^2] = P + (dy / d theta)^2 Var(theta)

(the delta method, JCGM 100:2008, 5.1). For a filter in its steady state the mean square of dy / d theta is an integral
over the spectrum of the readings. With the motion's share W of the readings' power, dW / d theta of a smoother is
W (1 - W). The likelihood determines theta with Var = 2 / (N var W) (Whittle, Arkiv Mat. 2 (1953) 423), cross-validation
with

    Var = 2 Q / (N V^2),    V = E_p[(W - mu)^2],    Q = E[(p (W - mu))^2],    mu = E_p[W],

with p = (1 - W) / E[1 - W]. This is the variance of the criterion's slope over the square of the criterion's curvature
(Huber 1967).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import autoregressive_power, cutoff_to_ratio
from becalm.core.filter.channel import ChannelRecord, Estimates
from becalm.core.steady.steady_filter import SteadyFilter, steady
from becalm.errors import ModelError
from becalm.identification.likelihood import Candidate, Evidence, Tuning
from becalm.identification.spectrum import tone_power
from becalm.metrics.whiteness import whiteness

# Estimate how much smaller a smoother's error could be, from the colour of its innovations.
#
# The power of normalised innovations is the ratio of the readings' spectrum to that of the model. The readings'
# spectrum less the model's noise is the spectrum of the signal. These spectra give the error of this smoother, and that
# of the best smoother for such readings (Wiener 1949). Predictable innovations do not increase the error at frequencies
# where the smoother passes nothing or everything.

# angles for integrals, in radians per step, closer together at low frequencies
_ANGLES = np.pi * np.concatenate([np.geomspace(1e-7, 1e-2, 1500)[:-1], np.linspace(1e-2, 1.0, 3000)])

Colour = Callable[[Floats], Floats]
"""Function of angles (k,), radians per step, that returns the power (k,) of normalised innovations.

The power is 1 for a correct model.
"""


def excess_error(tuning: Tuning, colour: Colour) -> float:
    """Return a smoother's RMS error over that of the best smoother for such readings, less 1.

    Parameters
    ----------
    tuning : Tuning
        The smoother's model.
    colour : callable
        The power of the smoother's normalised innovations, as a function of angles (k,) in radians per step.
    """
    signal, noise = powers(tuning, _ANGLES)
    passed = signal / (signal + noise)
    total = colour(_ANGLES) * (signal + noise)
    true_noise = np.minimum(noise, total)
    true_signal = total - true_noise
    own = (1 - passed) ** 2 * true_signal + passed**2 * true_noise
    share = np.divide(true_noise, total, out=np.zeros_like(total), where=total > 0)
    best = _mean(true_signal * share)
    return float(np.sqrt(_mean(own) / best)) - 1 if best > 0 else 0.0


def powers(tuning: Tuning, angle: Floats) -> tuple[Floats, Floats]:
    """Return the power (k,) of the signal and of the noise in readings, unit^2, at angles (k,) in radians a step."""
    signal = tuning.motion_power(angle)
    noise = np.full_like(angle, tuning.noise_variance)
    for tone in tuning.tones:
        power = tone_power(tone, angle)
        signal, noise = (signal, noise + power) if tone.disturbance else (signal + power, noise)
    if tuning.coloured is not None:
        coefficients, innovation_variance = tuning.coloured.coefficients, tuning.coloured.innovation_variance
        noise = noise + autoregressive_power(coefficients, innovation_variance, angle)
    return signal, noise


def _mean(power: Floats) -> float:
    """Return the mean of a power over all frequencies; below the lowest angle the power is constant."""
    return float((power[0] * _ANGLES[0] + np.trapezoid(power, _ANGLES)) / np.pi)


# Compute the expected error of an estimate over all motion models that may have made a short record.
#
# The models, here called walks, have the chosen order and any cut-off. They are weighted by their likelihood, with a
# flat prior on the logarithms of cut-off and noise variance. With the weight w_i, the estimate y_i and the variance P_i
# of each walk,
#
#     E[(x - y)^2] = sum of w_i (P_i + (y_i - y)^2)
#
# at each reading. This is exact if the record is such a walk (Hoeting et al., Statistical Science 14 (1999) 382). If
# the innovations of the likeliest walk are not white, no walk describes the record, and the weights are meaningless.

_SLOWEST_CYCLES, _FASTEST = 0.02, 4.0  # slowest cut-off, in cycles per record; fastest cut-off, in radians per step
_COARSE, _FINE, _WALKS = 15, 9, 8  # cut-offs over the whole range, and near the likeliest; walks to average over
_INTERPOLATED = 400  # cut-offs at which the likelihood is interpolated
_BY_CHANCE = 0.01  # p-value of whiteness up to which a walk is rejected; one true walk in a hundred is


def posterior_widening(tuning: Tuning, evidence: Evidence, causal: bool) -> float | None:
    """Return the root mean square, over the readings, of the factor by which sigma must be widened.

    Parameters
    ----------
    tuning : Tuning
        The motion model of the estimate, without tones.
    evidence : Evidence
        The readings, at most a few thousand.
    causal : bool
        True if the estimate is a filter's, False if a smoother's.

    Returns
    -------
    float or None
        The factor; None if no walk describes the readings.
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
        """Return logarithms of cut-offs (count,), each of which represents the same share of the likelihood."""
        mass = np.cumsum(np.exp(self.log_likelihood - self.log_likelihood.max()))
        log_cutoffs: Floats = np.interp((np.arange(count) + 0.5) / count, mass / mass[-1], self.log_cutoff)
        return log_cutoffs


def _likelihoods(candidate: Candidate) -> _Likelihoods | None:
    """Compute the likelihood at all cut-offs, denser around the likeliest; None if no reading is scored."""

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

    ascending, every = np.argsort(at), np.linspace(coarse[0], coarse[-1], _INTERPOLATED)
    return _Likelihoods(every, CubicSpline(at[ascending], values[ascending])(every))


def _walk(candidate: Candidate, log_cutoff: float) -> Tuning:
    """Return a walk whose noise variance is its posterior mean, used / (used - 2) times the likeliest."""
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


LONG = 4096
"""Number of readings from which on the delta method is enough."""

_DIGITS = 4  # decimals of a spread; more would be meaningless
_SMALL = 1e-3  # step of theta for difference quotients
_LARGEST_POLE = 1 - 1e-13  # magnitude of the largest pole below which a filter counts as having a steady state
_UNDETERMINED = 4.0  # variance of theta from which on a linear approximation is meaningless


def tuning_spread(tuning: Tuning, evidence: Evidence, causal: bool, *, noise_known: bool = False) -> float:
    """Return by how much sigma must be widened for the uncertainty of a tuning, as a share of sigma.

    Parameters
    ----------
    tuning : Tuning
        A tuning of order 1 to 5 that was identified from these readings.
    evidence : Evidence
        The readings.
    causal : bool
        True if a filter uses the tuning, False if a smoother does.
    noise_known : bool
        True if the noise was measured at rest, and not identified from these readings.

    Returns
    -------
    float
        The spread, 0 or more, without unit: sigma becomes (1 + spread) sigma. A *small* one trusts the tuning. It is 0
        if neither method gives a result, for example because the search in a long record ended at its slowest or
        fastest filter.
    """
    simple = not (tuning.tones or tuning.coloured or noise_known)
    if simple and len(evidence.z) < LONG:
        factor = posterior_widening(tuning, evidence, causal)
        if factor is not None:
            return max(round(factor - 1.0, _DIGITS), 0.0)
    return 0.0 if tuning.at_edge else round(delta_widening(tuning, causal) - 1.0, _DIGITS)


def delta_widening(tuning: Tuning, causal: bool) -> float:
    """Return the factor by which the spread of log(q/r) widens sigma, by the delta method; 1 if the method fails.

    Parameters
    ----------
    tuning : Tuning
        A tuning from `count` readings.
    causal : bool
        True for the filter, False for the smoother.
    """
    variance = log_ratio_variance(tuning)
    if not variance < _UNDETERMINED:
        return 1.0
    slope_square, error_variance = _slope_square_and_error(tuning, causal)
    return float(np.sqrt(1 + variance * slope_square / error_variance))


def log_ratio_variance(tuning: Tuning) -> float:
    """Return the variance of log(q/r) as identified from `count` readings.

    The variance is that of maximum likelihood or, for a tuning with a `loss`, of cross-validation. It is inf if the
    readings do not determine the ratio, or the filter has no steady state.
    """
    spectra = spectra_of(tuning)
    if spectra is None or not tuning.count:
        return np.inf
    W = spectra.motion / spectra.total
    if not np.isfinite(tuning.loss):
        variance = spectra.mean(W**2) - spectra.mean(W) ** 2
        return 2 / (tuning.count * variance) if variance > 0 else np.inf
    p = (1 - W) / spectra.mean(1 - W)
    deviation = W - spectra.mean(p * W)
    V, Q = spectra.mean(p * deviation**2), spectra.mean((p * deviation) ** 2)
    return 2 * Q / (tuning.count * V**2) if V > 0 else np.inf


class Spectra(NamedTuple):
    """The spectra of a steady-state filter's readings and of their parts."""

    filter: SteadyFilter
    f: Floats  # (k,) cycles a step
    motion: Floats  # (k,) power of the motion in the readings, unit^2
    signal: Floats  # (k,) power of the signal, unit^2
    total: Floats  # (k,) power of the readings, unit^2

    def mean(self, power: Floats) -> float:
        """Return the mean over all frequencies of a power (k,)."""
        return float(2 * (power[0] * self.f[0] + np.trapezoid(power, self.f)))


def spectra_of(tuning: Tuning) -> Spectra | None:
    """Return the spectra of a tuning's readings, and its filter; None for a filter without a steady state."""
    steady_filter = settled_filter(tuning)
    if steady_filter is None:
        return None
    f = steady_filter.frequencies
    angle = 2 * np.pi * f
    motion = tuning.motion_power(angle)
    signal, noise = powers(tuning, angle)
    return Spectra(steady_filter, f, motion, signal, signal + noise)


def settled_filter(tuning: Tuning) -> SteadyFilter | None:
    """Return the steady-state filter of a tuning with even sampling; None if it has no steady state."""
    try:
        steady_filter = _settled(tuning)
    except ModelError:
        return None
    return steady_filter if abs(steady_filter.poles[0]) < _LARGEST_POLE else None


def _settled(tuning: Tuning) -> SteadyFilter:
    component = tuning.component
    return steady(component.to_model(1.0, tuning.noise_variance), component.signal_output[0])


def _slope_square_and_error(tuning: Tuning, causal: bool) -> tuple[float, float]:
    """Return the mean square of d signal / d log(q/r), and the error variance at the exact ratio, in unit^2."""
    spectra = spectra_of(tuning)
    if spectra is None:
        return 0.0, 1.0
    if not causal:
        noise = 1 - spectra.signal / spectra.total
        slope = spectra.motion / spectra.total * noise
        return spectra.mean(slope**2 * spectra.total), spectra.mean(spectra.signal * noise)
    low, high = (_settled(replace(tuning, ratio=tuning.ratio * np.exp(by))) for by in (-_SMALL, _SMALL))
    change = (high.filter_response(spectra.f) - low.filter_response(spectra.f)) / (2 * _SMALL)
    return spectra.mean(np.abs(change) ** 2 * spectra.total), spectra.filter.error_variance()


# Compute how many samples apart the errors of an estimate are independent.
#
# The errors of neighbours are correlated, so the mean of n errors does not have the standard deviation sigma / sqrt(n).
# With the correlation rho_k of errors k samples apart and the sum L of rho_k over all k, negative and positive, the
# mean of n >> L samples has the variance sigma^2 L / n. L is the integrated autocorrelation time (Priestley, Spectral
# Analysis and Time Series (1981), 5.3). The correlation time of the passed noise alone is 1 / (2 B), with the filter's
# noise bandwidth B; sigma and L also include the part of the signal that the filter does not pass.


def independence_steps(tuning: Tuning, causal: bool) -> float | None:
    """Return L in steps: L samples determine a mean as well as one independent sample does.

    Parameters
    ----------
    tuning : Tuning
        A tuning for evenly sampled readings.
    causal : bool
        True for the filter, False for the smoother.

    Returns
    -------
    float or None
        L; None for a filter without a steady state.

    Notes
    -----
    A smoother's errors have the spectrum S R / (S + R), with the spectra S of the signal and R of the noise; its value
    at 0 Hz is sigma^2 L. For a motion that value is R, so a long mean of smoothed samples is exactly as accurate as
    that of the readings. A filter's errors are e[k] = A e[k-1] plus white noise, with A = (I - K H) F, so that
    L = 2 c (I - A)^-1 P c' / (c P c') - 1.
    """
    if not causal:
        spectra = spectra_of(tuning)
        if spectra is None:
            return None
        # total - signal would lose the noise to rounding, because the power of a motion is far larger
        noise = powers(tuning, 2 * np.pi * spectra.f[:1])[1]
        return float(spectra.signal[0] / spectra.total[0] * noise[0] / spectra.filter.error_variance(np.inf))
    steady_filter = settled_filter(tuning)
    if steady_filter is None:
        return None
    c, loop = steady_filter.row, steady_filter.loop
    P = c @ loop.P_plus @ c.T
    summed = c @ np.linalg.solve(np.eye(len(loop.A)) - loop.A, loop.P_plus @ c.T)
    return float((2 * summed / P)[0, 0]) - 1.0
