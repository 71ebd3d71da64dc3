"""Compute the covariance of Allan variances at several cluster times, for each kind of noise.

Let c be the covariances of M_i second differences of theta over m_i readings with M_j second differences over m_j
readings. For Gaussian noise, the two Allan variances have the covariance 2 sum c^2 / (M_i M_j (2 m_i m_j)^2). All times
are in steps, T = 1. Source: Greenhall and Riley, Uncertainty of stability variances based on finite differences, 35th
PTTI (2003).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np

from becalm.core.arrays import Floats, Integers, frozen

FLICKER = 2 * np.log(2) / np.pi
"""Allan variance of bias instability over B^2; its root is 0.664."""

_NODES = 8  # lags between two knots at which the covariance is evaluated


def shapes(sizes: Floats | Integers) -> Floats:
    """Return the Allan variances (k, 4) of the four terms, with coefficients of 1, at cluster sizes (k,)."""
    m = np.asarray(sizes, dtype=np.float64)
    return np.stack([3 / m**2, 1 / m, np.full_like(m, FLICKER), m / 3 + 1 / (6 * m)], axis=-1)


@lru_cache(maxsize=8)  # the channels of one record share the result
def spreads(sizes: tuple[int, ...], counts: tuple[int, ...]) -> Floats:
    """Return S (k, k, 4, 4) such that p' S[i, j] p is the covariance of two Allan variances.

    Parameters
    ----------
    sizes : tuple of k int
        m, numbers of readings in a cluster, ascending.
    counts : tuple of k int
        M, numbers of second differences averaged.

    Notes
    -----
    p holds Q^2, N^2, B^2, K^2, in steps. The covariance c is evaluated at some lags only; that costs at most 0.3 %
    accuracy.
    """
    spread = np.zeros((len(sizes), len(sizes), 4, 4))
    for i, j in combinations_with_replacement(range(len(sizes)), 2):
        m, n, first, second = (float(each) for each in (sizes[i], sizes[j], counts[i], counts[j]))
        lags, pairs = _lags(m, n, first, second)
        c = _covariances(lags - m, m) - 2 * _covariances(lags + n - m, m) + _covariances(lags + 2 * n - m, m)
        spread[i, j] = spread[j, i] = 2 * (c * pairs) @ c.T / (first * second * (2 * m * n) ** 2)
    return frozen(spread)


def _covariances(lags: Floats, m: float) -> Floats:
    """Return the covariances (4, lags) of theta with its second differences over m, for coefficients of 1.

    Notes
    -----
    They are second differences of theta's generalised autocovariance at t: 1 at t = 0 and 0 elsewhere, -|t| / 2,
    t^2 ln|t| / (2 pi), (|t|^3 - |t|) / 12 for the four terms. The form avoids a loss of digits at large lags.
    """
    t = np.abs(lags)
    jumps = (t == m) - 2.0 * (t == 0)
    tent = np.maximum(m - t, 0.0)
    cubic = np.where(t < m, 2 * m**3 + 6 * m * t**2 - 2 * t**3, 6 * m**2 * t)
    near = _flicker(t + m) - 2 * _flicker(t) + _flicker(t - m)
    t = np.maximum(t, 2 * m)
    r = m / t
    far = t**2 * ((1 + r**2) * np.log1p(-(r**2)) + 4 * r * np.arctanh(r)) + 2 * m**2 * np.log(t)
    flicker = np.where(np.abs(lags) < 2 * m, near, far)
    return np.stack([jumps, -tent, flicker / (2 * np.pi), (cubic - 2 * tent) / 12])


def _flicker(t: Floats) -> Floats:
    """Return t^2 ln|t|, which is 0 at 0."""
    result: Floats = t**2 * np.log(np.where(t == 0, 1.0, np.abs(t)))
    return result


def _lags(m: float, n: float, first: float, second: float) -> tuple[Floats, Floats]:
    """Return lags of `first` differences over m readings to `second` over n, and how many pairs each represents.

    Notes
    -----
    Knots are dense where the covariance bends. Between two knots, eight Gauss-Legendre points represent all lags.
    """
    reach = m * np.append(0, 2.0 ** np.arange(np.ceil(np.log2((first + second) / m)) + 1))
    near = [centre + sign * reach for centre in (0.0, -n, -2 * n, m, 2 * m) for sign in (-1, 1)]
    ends = np.array([1 - first, 0.0, second - first, second - 1])
    knots = np.unique(np.clip(np.concatenate([*near, ends]), 1 - first, second - 1))
    start, between = knots[:-1, np.newaxis], np.diff(knots)[:, np.newaxis] - 1
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    each, many = np.arange(1, _NODES + 1), between > _NODES
    lags = np.where(many, start + 0.5 + between * (nodes + 1) / 2, start + each)
    shares = np.where(many, between * weights / 2, each <= between)
    lags, shares = np.append(knots, lags), np.append(np.ones(len(knots)), shares)
    return lags, shares * np.maximum(np.minimum(first, second - lags) - np.maximum(0, -lags), 0)
