"""Whether the innovations keep their size, as one noise level and one sigma demand."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats

_BLOCK = 50
_FACTOR = 4.0  # in power: sigma is off by two


def uneven_share(normalised: Floats) -> float:
    """Return the share of blocks of 50 whose mean power is off by more than a factor of four.

    Parameters
    ----------
    normalised : (N,) float array
        Innovations over their expected standard deviation; NaN is left out.

    Notes
    -----
    The mean power of 50 white Gaussian innovations is 1 with a standard deviation of 0.2, so that
    chance alone gives none. A large share says that sigma holds on average only.
    """
    e = normalised[np.isfinite(normalised)]
    blocks = len(e) // _BLOCK
    if blocks == 0:
        return 0.0
    power = np.mean(e[: blocks * _BLOCK].reshape(blocks, _BLOCK) ** 2, axis=1)
    return float(np.mean((power > _FACTOR) | (power < 1 / _FACTOR)))
