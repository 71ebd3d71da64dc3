"""Estimate how much the uncertainty of the tuning itself widens sigma.

A filter's sigma takes q and r as known. They were identified from the record, and another record of the same motion
would have given others. For a short record, all walks that may have made it are taken into account
(`tuning_posterior`). For a long one, the ratio q/r has a standard error of its logarithm, theta, and

    E[(x - y)^2] = P + (dy / d theta)^2 Var(theta)

(the delta method, JCGM 100:2008, 5.1). For a filter in its steady state the mean square of dy / d theta is an integral
over the spectrum of the readings. With W the motion's share of the readings' power, dW / d theta of a smoother is W (1
- W). A likelihood determines theta with Var = 2 / (N var W) (Whittle, Arkiv Mat. 2 (1953) 423), cross-validation with

    Var = 2 Q / (N V^2),    V = E_p[(W - mu)^2],    Q = E[(p (W - mu))^2],    mu = E_p[W],

with p = (1 - W) / E[1 - W]: the scatter of its slope over the square of its curvature (Huber 1967).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.steady.steady_filter import SteadyFilter
from becalm.core.steady.steady_gain import steady
from becalm.errors import ModelError
from becalm.identification.likelihood import Evidence, Tuning
from becalm.identification.trust.excess import powers
from becalm.identification.trust.tuning_posterior import posterior_widening

LONG = 4096
"""Number of readings from which on the delta method is enough."""

_DIGITS = 4  # of a share; more digits would be noise
_SMALL = 1e-3  # step of theta for difference quotients
_LARGEST_POLE = 1 - 1e-13  # largest pole of a filter that counts as having a steady state
_UNDETERMINED = 4.0  # variance of theta from which on a linear approximation means nothing


def tuning_spread(tuning: Tuning, evidence: Evidence, causal: bool, *, noise_known: bool = False) -> float:
    """Return the share by which sigma must be widened for the uncertainty of a tuning.

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
        0 or more, without unit: sigma becomes (1 + spread) sigma. A *small* one trusts the tuning. It is 0 where
        neither method gives a result: for a long record whose search ended at its slowest or fastest filter.
    """
    simple = not (tuning.lines or tuning.coloured or noise_known)
    if simple and len(evidence.z) < LONG:
        factor = posterior_widening(tuning, evidence, causal)
        if factor is not None:
            return max(round(factor - 1.0, _DIGITS), 0.0)
    return 0.0 if tuning.at_edge else round(delta_widening(tuning, causal) - 1.0, _DIGITS)


def delta_widening(tuning: Tuning, causal: bool) -> float:
    """Return the factor by which the spread of log(q/r) widens sigma, by the delta method; 1 where it fails.

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
    moved, claimed = _moved_and_claimed(tuning, causal)
    return float(np.sqrt(1 + variance * moved / claimed))


def log_ratio_variance(tuning: Tuning) -> float:
    """Return the variance of log(q/r), given `count` readings.

    It is that of the likelihood, or, for a tuning with a `loss`, of cross-validation. It is inf where the readings do
    not determine the ratio, or the filter has no steady state.
    """
    spectra = spectra_of(tuning)
    if spectra is None or not tuning.count:
        return np.inf
    W = spectra.motion / spectra.total
    if not np.isfinite(tuning.loss):
        variance = spectra.mean(W**2) - spectra.mean(W) ** 2
        return 2 / (tuning.count * variance) if variance > 0 else np.inf
    p = (1 - W) / spectra.mean(1 - W)
    apart = W - spectra.mean(p * W)
    V, Q = spectra.mean(p * apart**2), spectra.mean((p * apart) ** 2)
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
    """Return the steady-state filter of a tuning in even time; None if it has no steady state."""
    try:
        steady_filter = _settled(tuning)
    except ModelError:
        return None
    return steady_filter if abs(steady_filter.poles[0]) < _LARGEST_POLE else None


def _settled(tuning: Tuning) -> SteadyFilter:
    component = tuning.component
    return steady(component.to_model(1.0, tuning.noise_variance), component.signal_output[0])


def _moved_and_claimed(tuning: Tuning, causal: bool) -> tuple[float, float]:
    """Return the mean square of d signal / d log(q/r), and the error variance without it, in unit^2."""
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
