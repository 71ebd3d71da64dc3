"""Filter, smooth or score a complete record of one channel with the C kernel.

The smoother is that of Bryson and Frazier (1963) in Bierman's form (1973), equations (9) to (12) of
`becalm.core.reference.kalman`; the likelihood is equation (8).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.channel import Estimates
from becalm.core.filter.channel_settings import packed_coefficients
from becalm.core.filter.likelihood_sums import Sums
from becalm.core.model.components import Component
from becalm.core.model.magnitudes import largest_magnitude_for_noise
from becalm.native import score
from becalm.native.rows import SETTINGS
from becalm.native.smoothers import Smoother


class ChannelRecord:
    """A record of one channel; every measurement may enter the filter, and no gap is too long.

    Parameters
    ----------
    component : Component
        The model, in steps; the signal is all that is measured, disturbances included.
    noise_variance : float
        R, in unit^2.
    z : (N,) float array
        Measurements, in unit; NaN where missing.
    elapsed : (N,) float array
        Steps since the row before; ignored for the first row.

    Raises
    ------
    ModelError
        If a channel cannot start from measurements alone, or coloured noise does not come in whole steps.
    """

    def __init__(self, component: Component, noise_variance: float, z: Floats, elapsed: Floats) -> None:
        even = np.concatenate([elapsed[1:2], elapsed[1:]]) if len(elapsed) > 1 else np.ones(len(elapsed))
        lengths, step = np.unique(even, return_inverse=True)
        F, Q = component.over(lengths if len(lengths) else np.ones(1))
        self._rows: dict[str, Any] = {
            "z": np.ascontiguousarray(z),
            "elapsed": even,
            "step": step.astype(np.int32),
            "F": F,
            "Q": Q,
        }
        self._coefficients = packed_coefficients(component, noise_variance, disturbed=False)
        self._settings = np.zeros((), SETTINGS)
        self._settings["states"] = len(component.drift)
        self._settings["longest_gap"] = self._settings["gap_spans"] = np.inf
        self._settings["largest_accepted"] = largest_magnitude_for_noise(noise_variance)

    @property
    def process_noise(self) -> Floats:
        """Q (u, n, n) for each of the u different step lengths of the record."""
        return np.asarray(self._rows["Q"])

    def filtered(self) -> Estimates:
        """Return the filtered estimates: each row uses the measurements up to its own."""
        estimates = Estimates.room(len(self._rows["z"]))
        Smoother(self._settings, self._coefficients).forward(ends=True, **estimates.outputs(), **self._rows)
        return estimates

    def smoothed(self, process_noise: Floats | None = None) -> Estimates:
        """Return the smoothed estimates: each row uses all measurements. Innovations are those of the forward pass.

        Parameters
        ----------
        process_noise : (u, n, n) float array, optional
            Q to use in place of that of the component.
        """
        estimates, smoother = Estimates.room(len(self._rows["z"])), Smoother(self._settings, self._coefficients)
        forward_pass = smoother.forward(ends=True, **estimates.outputs(), **self._with(process_noise))
        smoother.backward(forward_pass, smoother.nothing())
        return estimates

    def score(self, scored_from: int, process_noise: Floats | None = None) -> Sums:
        """Return the terms of the log-likelihood of the rows from `scored_from` on that have a prediction.

        Parameters
        ----------
        scored_from : int
            The first row that counts; earlier rows only start the filter.
        process_noise : (u, n, n) float array, optional
            Q to use in place of that of the component.
        """
        return Sums(*score(self._settings, self._coefficients, scored_from, **self._with(process_noise)))

    def _with(self, process_noise: Floats | None) -> dict[str, Any]:
        return self._rows if process_noise is None else self._rows | {"Q": process_noise}
