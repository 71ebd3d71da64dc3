"""Whether innovations are white, and how much of them is still predictable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc

from becalm.core.arrays import Floats

LAGS = 20
_PREDICTOR_LAGS = 32
_READINGS_PER_LAG = 8  # a short sequence is asked fewer questions


@dataclass(frozen=True)
class Whiteness:
    """How white a sequence is.

    Attributes
    ----------
    p_value : float
        Ljung-Box over 20 lags: how often white noise looks as coloured as this. Long real records
        always fail it; the size of the effect is `predictable_share`.
    first_correlation : float
        Of neighbours; positive: the filter is sluggish, negative: nervous.
    predictable_share : float
        Share of the innovation power that a linear predictor of 32 lags still foresees, less what
        it foresees of white noise by chance; 0 to 1.
    """

    p_value: float
    first_correlation: float
    predictable_share: float


def whiteness(normalised: Floats) -> Whiteness:
    """Judge a sequence (N,) of normalised innovations; NaN is left out.

    Notes
    -----
    Ljung and Box, Biometrika 65 (1978) 297. The predictor is that of Levinson and Durbin.
    """
    e = normalised[np.isfinite(normalised)]
    n = len(e)
    tested, foreseen = min(LAGS, n // _READINGS_PER_LAG), min(_PREDICTOR_LAGS, n // _READINGS_PER_LAG)
    if foreseen < 1 or not np.any(e != e[0]):
        return Whiteness(1.0, 0.0, 0.0)
    correlation = autocorrelation(e, foreseen)
    lags = np.arange(1, tested + 1)
    statistic = n * (n + 2) * float((correlation[1 : tested + 1] ** 2 / (n - lags)).sum())
    p_value = float(gammaincc(tested / 2, statistic / 2))
    share = 1 - prediction_error(correlation)
    chance = foreseen / n
    return Whiteness(p_value, float(correlation[1]), max(0.0, (share - chance) / (1 - chance)))


def autocorrelation(e: Floats, lags: int) -> Floats:
    """Return the autocorrelation of e (N,) about its mean at lags 0 to `lags`."""
    centred = e - e.mean()
    padded = 1 << (len(e) + lags).bit_length()  # so that the circular correlation does not wrap
    spectrum = np.abs(np.fft.rfft(centred, padded)) ** 2
    correlation: Floats = np.fft.irfft(spectrum, padded)[: lags + 1]
    correlation /= correlation[0]
    return correlation


def prediction_error(correlation: Floats) -> float:
    """Return the variance left by the best linear predictor, over the variance (Durbin 1960)."""
    error, predictor = 1.0, np.zeros(0)
    for j in range(1, len(correlation)):
        reflection = (correlation[j] - predictor @ correlation[j - 1 : 0 : -1]) / error
        predictor = np.append(predictor - reflection * predictor[::-1], reflection)
        error *= 1 - reflection**2
        if not error > 0:
            return 0.0
    return error


def mean_nis(normalised: Floats) -> float:
    """Return the mean squared normalised innovation; 1 when the scale of the noise is right."""
    e = normalised[np.isfinite(normalised)]
    return float(np.mean(e**2)) if len(e) else float("nan")
