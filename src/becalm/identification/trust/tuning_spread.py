"""How much wider sigma becomes for what the tuning itself does not know.

A filter's sigma takes q and r for known. They were told from the record, and another record of the same
motion would have told others. Of a short record every walk that may have made it is asked
(`tuning_posterior`). Of a long one the ratio q/r is told to a standard error of its logarithm, theta, and

    E[(x - y)^2] = P + (dy / d theta)^2 Var(theta)

(the delta method, JCGM 100:2008, 5.1). Of a settled filter the mean square of dy / d theta is an integral over
the spectrum of the readings; with W the share of their power that is motion's, a smoother's dW / d theta is
W (1 - W). A likelihood tells theta to Var = 2 / (N var W) (Whittle, Arkiv Mat. 2 (1953) 423), cross-validation to

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
"""Readings from which on the delta method is enough."""

_DIGITS = 4  # of a share: more would be noise
_SMALL = 1e-3  # of theta: what a slope is told across
_FORGETS = 1 - 1e-13  # largest pole of a filter that does
_UNTOLD = 4.0  # variance of theta from which on a straight line across it means nothing


def tuning_spread(tuning: Tuning, evidence: Evidence, causal: bool, *, noise_known: bool = False) -> float:
    """Return by which share sigma is to be widened for the spread of a tuning.

    Parameters
    ----------
    tuning : Tuning
        As it was found in these readings, of order 1 to 5.
    evidence : Evidence
        The readings.
    causal : bool
        Whether the tuning is used by a filter (True) or by a smoother.
    noise_known : bool
        Whether the noise was told at rest, and not in these readings.

    Returns
    -------
    float
        0 or more, without unit: sigma becomes (1 + spread) sigma. A *small* one trusts the tuning. 0 where neither
        way tells anything: of a long record whose search ended at its slowest or fastest filter.
    """
    alone = not (tuning.lines or tuning.coloured or noise_known)
    if alone and len(evidence.z) < LONG:
        found = posterior_widening(tuning, evidence, causal)
        if found is not None:
            return max(round(found - 1.0, _DIGITS), 0.0)
    return 0.0 if tuning.at_edge else round(delta_widening(tuning, causal) - 1.0, _DIGITS)


def delta_widening(tuning: Tuning, causal: bool) -> float:
    """Return by which factor the spread of log(q/r) widens sigma, by the delta method; 1 where that tells nothing.

    Parameters
    ----------
    tuning : Tuning
        Of `count` readings.
    causal : bool
        Whether of the filter (True) or of the smoother.
    """
    variance = log_ratio_variance(tuning)
    if not variance < _UNTOLD:
        return 1.0
    moved, claimed = _moved_and_claimed(tuning, causal)
    return float(np.sqrt(1 + variance * moved / claimed))


def log_ratio_variance(tuning: Tuning) -> float:
    """Return the variance of log(q/r) as `count` readings tell it: by likelihood, or, with a `loss`, cross-validated.

    inf where they do not tell it, or where the filter never settles.
    """
    found = spectra_of(tuning)
    if found is None or not tuning.count:
        return np.inf
    W = found.motion / found.total
    if not np.isfinite(tuning.loss):
        told = found.mean(W**2) - found.mean(W) ** 2
        return 2 / (tuning.count * told) if told > 0 else np.inf
    p = (1 - W) / found.mean(1 - W)
    apart = W - found.mean(p * W)
    V, Q = found.mean(p * apart**2), found.mean((p * apart) ** 2)
    return 2 * Q / (tuning.count * V**2) if V > 0 else np.inf


class Spectra(NamedTuple):
    """What the readings of a settled filter consist of, over frequency."""

    filter: SteadyFilter
    f: Floats  # (k,) cycles a step
    motion: Floats  # (k,) power of the motion in readings, unit^2
    signal: Floats  # (k,) of the signal
    total: Floats  # (k,) of the readings

    def mean(self, power: Floats) -> float:
        """Return the mean over all frequencies of a power (k,)."""
        return float(2 * (power[0] * self.f[0] + np.trapezoid(power, self.f)))


def spectra_of(tuning: Tuning) -> Spectra | None:
    """Return what a tuning's readings consist of, and its filter; None of one that does not settle."""
    found = settled_filter(tuning)
    if found is None:
        return None
    f = found.frequencies
    angle = 2 * np.pi * f
    motion = tuning.motion_power(angle)
    signal, noise = powers(tuning, angle)
    return Spectra(found, f, motion, signal, signal + noise)


def settled_filter(tuning: Tuning) -> SteadyFilter | None:
    """Return the filter of a tuning in even time; None of one that does not settle."""
    try:
        found = _settled(tuning)
    except ModelError:
        return None
    return found if abs(found.poles[0]) < _FORGETS else None


def _settled(tuning: Tuning) -> SteadyFilter:
    component = tuning.component
    return steady(component.to_model(1.0, tuning.noise_variance), component.signal_output[0])


def _moved_and_claimed(tuning: Tuning, causal: bool) -> tuple[float, float]:
    """Return the mean square of d signal / d log(q/r), and of the error that is claimed, in unit^2."""
    found = spectra_of(tuning)
    if found is None:
        return 0.0, 1.0
    if not causal:
        noise = 1 - found.signal / found.total
        slope = found.motion / found.total * noise
        return found.mean(slope**2 * found.total), found.mean(found.signal * noise)
    low, high = (_settled(replace(tuning, ratio=tuning.ratio * np.exp(by))) for by in (-_SMALL, _SMALL))
    change = (high.filter_response(found.f) - low.filter_response(found.f)) / (2 * _SMALL)
    return found.mean(np.abs(change) ** 2 * found.total), found.filter.error_variance()
