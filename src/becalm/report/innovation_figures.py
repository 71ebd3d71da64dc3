"""Draw the innovations of a channel, which show whether its filter can be trusted."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.metrics.whiteness import MOST_LAGS, LaggedSums, judge_whiteness, smoothed_power
from becalm.report.data.description import Axis, Curve, Figure, Layer, Rule
from becalm.report.data.envelope import Envelope, Means
from becalm.report.pictures import TIME, Title, break_at_pauses

_WITHIN = 1.96  # half-width of a 95 % interval, in standard deviations
_SHARE = 0.025  # probability outside a 95 % interval, on each side
_READINGS_A_LAG = 8  # smallest number of innovations for each lag of the autocorrelation


def innovation_figures(
    title: Title, times: Envelope, sums: LaggedSums | None, nis: Means, rate_hz: float
) -> tuple[Figure, ...]:
    """Draw the autocorrelation, the spectrum and the mean square (NIS over time) of the normalised innovations.

    Parameters
    ----------
    title : Title
        Names of the channel.
    times : Envelope
        Times of the stretches that `nis` is averaged over, in seconds since the first row.
    sums : LaggedSums or None
        Lagged sums of all normalised innovations; None if there are too few.
    nis : Means
        Means of the squared normalised innovations over stretches.
    rate_hz : float
        Samples per second.

    Returns
    -------
    tuple of Figure
        Empty if there are too few innovations.
    """
    correlations = np.zeros(0) if sums is None else _correlations(sums)
    if sums is None or not len(correlations):
        return ()
    return (
        _correlation(title, correlations, sums.seen),
        _spectrum(title, sums, correlations, rate_hz),
        _nis(title, times, nis),
    )


def _correlations(sums: LaggedSums) -> Floats:
    """Return the autocorrelation (k,) of innovations at lags 1 to 32, or to a smaller lag if there are few of them."""
    covariance = sums.about_mean(min(MOST_LAGS, sums.seen // _READINGS_A_LAG))
    return covariance[1:] / covariance[0] if covariance[0] > 0 else np.zeros(0)


def _level(name: str, x: Floats, height: float) -> Curve:
    return Curve(name, x[[0, -1]], np.full(2, height), "limit", "dashed")


def _correlation(title: Title, correlations: Floats, count: int) -> Figure:
    lags = np.arange(1.0, len(correlations) + 1)
    limit = _WITHIN / np.sqrt(count)
    layers = (
        Curve("autocorrelation", lags, correlations, "clean", "points"),
        _level("95 % of white noise", lags, limit),
        _level("", lags, -limit),
    )
    caption = "White innovations cannot be predicted. The limits of a long record are close to 0."
    reach = max(0.1, 1.2 * float(np.abs(correlations).max()))
    axis = Axis("autocorrelation", low=-reach, high=reach)
    return Figure(f"{title.slug}-whiteness", "Innovations: whiteness", Axis("lag (rows)"), axis, layers, caption)


def _spectrum(title: Title, sums: LaggedSums, correlations: Floats, rate_hz: float) -> Figure:
    whiteness = judge_whiteness(sums)
    cycles = np.linspace(0.0, 0.5, 251)
    layers: tuple[Layer, ...] = (
        Curve("innovations", cycles * rate_hz, smoothed_power(np.append(1.0, correlations), cycles), "clean"),
        _level("white", cycles * rate_hz, 1.0),
    )
    caption = "White noise is 1 everywhere. A peak is a frequency that the model does not describe."
    if whiteness.loudest is not None and len(whiteness.predictor.coefficients):
        layers += (Rule("loudest", whiteness.loudest * rate_hz),)
        caption += f" The loudest is near {whiteness.loudest * rate_hz:.3g} Hz."
    axis = Axis("power, relative", low=0.0)
    return Figure(f"{title.slug}-colour", "Innovations: spectrum", Axis("frequency (Hz)"), axis, layers, caption)


def _nis(title: Title, times: Envelope, nis: Means) -> Figure:
    from scipy.special import chdtri

    seen, mean = nis.seen, nis.result()
    degrees = np.maximum(seen, 1)
    upper, lower = (np.where(seen > 0, chdtri(degrees, share) / degrees, np.nan) for share in (_SHARE, 1 - _SHARE))
    x, mean, upper, lower = break_at_pauses(times.low, mean, upper, lower)
    layers = (
        Curve("normalised innovation squared", x, mean, "clean"),
        Curve("95 % where sigma is right", x, upper, "limit", "dashed"),
        Curve("", x, lower, "limit", "dashed"),
    )
    caption = "Means over stretches. Above the limits sigma is too small, below them it is too large."
    return Figure(f"{title.slug}-nis", "Innovations: size (NIS)", TIME, Axis("NIS", low=0.0), layers, caption)
