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
from becalm.core.closed_forms import cutoff_to_ratio, ratio_to_cutoff
from becalm.core.filtering import run_filter
from becalm.core.timeline import elapsed_timeline
from becalm.metrics.whiteness import whiteness
from becalm.noise.likelihood import Candidate, Evidence, Tuning
from becalm.noise.spectrum import welch_power

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
        The readings it was tuned on; at least 2048 in even time but for jitter, otherwise the tuning stays.
    """
    if not _is_whole(evidence):
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


def less_risky(tuning: Tuning, other: Tuning, evidence: Evidence) -> Tuning:
    """Return the tuning whose causal filter errs less; the first where too little is known to tell.

    Parameters
    ----------
    tuning, other : Tuning
        The first one's noise variance is believed for both.
    evidence : Evidence
        The readings they were tuned on; at least 2048 in even time but for jitter.
    """
    if not _is_whole(evidence):
        return tuning
    risks = [_risk(one, evidence, tuning.noise_variance)[0] for one in (tuning, other)]
    return tuning if risks[0] <= risks[1] else other


def _is_whole(evidence: Evidence) -> bool:
    """Whether one stretch in even time, but for a little jitter, holds all of enough readings."""
    return len(evidence.z) >= _FEWEST and evidence.complete == [slice(0, len(evidence.z))]


def _risk(tuning: Tuning, evidence: Evidence, noise_variance: float | None = None) -> tuple[float, float]:
    """Estimate the mean squared error of the causal filter, and the predictable share of its innovations."""
    r = tuning.noise_variance
    component = tuning.component
    model = component.to_model(1.0, r)
    estimate = run_filter(model, elapsed_timeline(component, r, evidence.elapsed), evidence.z).estimate
    known = np.isfinite(estimate.sigma[:, 0])
    known[: len(model.F)] = False
    weight = float(np.mean(estimate.sigma[known] ** 2)) / r  # of each reading in its own estimate
    residual = (evidence.z - estimate.signal)[known]
    believed = r if noise_variance is None else noise_variance
    normalised = (estimate.innovations / estimate.innovation_sigma)[:, 0]
    return float(np.mean(residual**2)) + believed * (2 * weight - 1), whiteness(normalised).predictable_share
