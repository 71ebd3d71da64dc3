"""When no motion describes the signal: the white floor of the spectrum, and the least risk.

Maximum likelihood is right when the model is. When it is not (a sine is no random walk), it lets
white noise pass for motion. Then two things still hold without any model: white noise lies under
every band of the spectrum, so the quietest band bounds it; and the mean squared error of a linear
filter can be estimated without truth. Source: Stein, Annals of Statistics 9 (1981) 1135.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from becalm.core.arrays import Floats
from becalm.core.components import motion
from becalm.core.filtering import run_filter
from becalm.core.response import steady
from becalm.core.timeline import elapsed_timeline
from becalm.metrics.whiteness import whiteness
from becalm.noise.likelihood import Candidate, Evidence, Tuning, cutoff_to_ratio

MISFIT = 0.02
"""Share of the innovation power above which a motion does not describe the signal."""

_SEGMENT = 512
_FEWEST = 4 * _SEGMENT
_SEARCH = (-1.0, 0.7)  # about the likeliest cut-off, in its logarithm
_PRECISION = 3e-3


def retune(tuning: Tuning, evidence: Evidence) -> Tuning:
    """Give back white noise that the likelihood took for motion; a tuning that fits comes back as it is.

    Parameters
    ----------
    tuning : Tuning
        The likeliest.
    evidence : Evidence
        The readings it was tuned on; at least 2048 in even time, otherwise the tuning stays.
    """
    if len(evidence.z) < _FEWEST or not np.all(evidence.elapsed[1:] == 1.0):
        return tuning
    _, share = _risk(tuning, evidence)
    floor = white_floor(evidence.z[:, 0])
    if share <= MISFIT or floor <= tuning.noise_variance:
        return tuning

    def at(log_cutoff: float) -> Tuning:
        ratio = cutoff_to_ratio(tuning.order, float(np.exp(log_cutoff)))
        return replace(tuning, ratio=ratio, noise_variance=floor)

    likeliest = np.log(tuning.ratio) / (2 * tuning.order)
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
    Welch's periodogram of z (N,), Hann segments of 512 with half overlap (IEEE TAU-15, 1967, 70).
    """
    window = np.hanning(_SEGMENT)
    segments = np.lib.stride_tricks.sliding_window_view(z, _SEGMENT)[:: _SEGMENT // 2]
    tapered = (segments - segments.mean(axis=1, keepdims=True)) * window
    power = (np.abs(np.fft.rfft(tapered, axis=1)) ** 2).mean(axis=0)[2:-1] / (window**2).sum()
    quarter = len(power) // 4
    return float(np.convolve(power, np.ones(quarter) / quarter, "valid").min())


def _risk(tuning: Tuning, evidence: Evidence) -> tuple[float, float]:
    """Estimate the mean squared error of the causal filter, and the predictable share of its innovations."""
    r = tuning.noise_variance
    component = motion(tuning.order, tuning.ratio * r)
    model = component.to_model(1.0, r)
    estimate = run_filter(model, elapsed_timeline(component, r, evidence.elapsed), evidence.z).estimate
    weight = float((model.H @ steady(model).gain)[0, 0])  # of each reading in its own estimate
    known = slice(tuning.order, None)
    residual = (evidence.z - estimate.signal)[known]
    normalised = (estimate.innovations / estimate.innovation_sigma)[:, 0]
    return float(np.mean(residual**2)) - r + 2 * r * weight, whiteness(normalised).predictable_share
