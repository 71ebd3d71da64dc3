"""A covariance in factors, U diag(D) U': no difference of variances is lost that is small beside them."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats

_DEAD_PIVOT = 1e-15  # of a variance: less is what rounding left of nothing


def factors_of(P: Floats) -> tuple[Floats, Floats]:
    """Return U (n, n), an upper triangle with a diagonal of 1, and D (n,) of a covariance U diag(D) U'.

    Of states that others determine, D is 0; their column of U is then that of a unit matrix.
    """
    M, n = np.array(P, dtype=np.longdouble), len(P)
    U, D, least = np.eye(n), np.zeros(n), _DEAD_PIVOT * np.diag(P)
    for j in range(n - 1, -1, -1):
        if M[j, j] > least[j]:
            u = M[:j, j] / M[j, j]
            D[j], U[:j, j] = M[j, j], u
            M[:j, :j] -= M[j, j] * np.outer(u, u)
    return U, D
