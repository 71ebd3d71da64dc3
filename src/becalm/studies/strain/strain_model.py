"""Build the strain paper's model, and estimate its noise by maximum likelihood instead of trial and error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.model.model import Model

_RATIOS = np.arange(-14.0, 5.0)  # decimal logarithms of G T^6 / R at which a search may start
_NEAR = 0.01  # tolerance of the search, in decades


class Noise(NamedTuple):
    """The two variances of the paper's filter."""

    jerk_variance: float  # G, in unit^2/s^6
    noise_variance: float  # R, in unit^2


def strain_model(noise: Noise, step_s: float, *, from_zero: bool = False) -> Model:
    """Return the model of the paper: the third derivative is random, and constant between two readings.

    Parameters
    ----------
    noise : Noise
        The two variances: a *small* `jerk_variance` trusts the parabola and smooths more, a *small* `noise_variance`
        trusts the readings and smooths less.
    step_s : float
        Time between readings, in seconds.
    from_zero : bool
        Whether the strain and its first two derivatives start at zero, each with the variance R (the paper does not
        print a start); by default the initial state is unknown.

    Raises
    ------
    ModelError
        If a variance is negative or not finite.
    """
    return Model(
        F=np.array([[1, step_s, step_s**2 / 2], [0, 1, step_s], [0, 0, 1]]),
        H=[[1, 0, 0]],
        Q=noise.jerk_variance,
        R=noise.noise_variance,
        G=[[step_s**3 / 6], [step_s**2 / 2], [step_s]],
        x0=np.zeros(3) if from_zero else None,
        P0=noise.noise_variance * np.eye(3) if from_zero else None,
    )


def likeliest(readings: Floats, step_s: float, noise_variance: float | None = None) -> Noise:
    """Return the maximum-likelihood estimate of G, and of R if it is not given.

    Parameters
    ----------
    readings : (N,) float array
        Readings in unit; NaN where missing.
    step_s : float
        Time between readings, in seconds.
    noise_variance : float, optional
        R in unit^2, if it is known; by default it is estimated too.

    Notes
    -----
    The search is over one dimension, G / R: R alone scales every covariance, so that one pass with R = 1 gives the
    likelihood of every R, and the best R is the mean of the squared normalised innovations (Harvey, Forecasting,
    Structural Time Series Models and the Kalman Filter (1989), section 4.3.2).
    """

    def noise_at(log_ratio: float) -> tuple[float, Noise]:
        relative = 10.0**log_ratio / step_s**6
        estimate = kalman_filter(strain_model(Noise(relative, 1.0), step_s), readings, sigma=False)
        squares, used = float(np.nansum((estimate.innovations / estimate.innovation_sigma) ** 2)), estimate.used
        variance = squares / used if noise_variance is None else noise_variance
        log_likelihood = estimate.log_likelihood + (squares - squares / variance - used * np.log(variance)) / 2
        return -log_likelihood, Noise(relative * variance, variance)

    def cost(log_ratio: float) -> float:
        return noise_at(log_ratio)[0]

    begin = float(min(_RATIOS, key=cost))
    best = minimize_scalar(cost, bounds=(begin - 1, begin + 1), method="bounded", options={"xatol": _NEAR})
    return noise_at(float(best.x))[1]
