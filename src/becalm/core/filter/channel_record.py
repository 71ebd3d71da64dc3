"""A whole record of one channel, filtered, smoothed, or only scored, by the filter in C.

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
from becalm.core.model.magnitudes import largest_beside
from becalm.native import score
from becalm.native.rows import SETTINGS
from becalm.native.smoothers import Smoother


class ChannelRecord:
    """Measurements of one channel, all of which may enter its filter, however long the gaps between them.

    Parameters
    ----------
    component : Component
        In steps; the signal is all that is measured, with what disturbs it.
    noise_variance : float
        R, in unit^2.
    z : (N,) float array
        Measurements, in unit; NaN where missing.
    elapsed : (N,) float array
        Steps since the row before; not looked at for the first row.

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
        self._settings["largest_accepted"] = largest_beside(noise_variance)

    @property
    def process_noise(self) -> Floats:
        """Q (u, n, n) of each length of a step that it has."""
        return np.asarray(self._rows["Q"])

    def filtered(self) -> Estimates:
        """Return what each row tells with those before it."""
        found = Estimates.room(len(self._rows["z"]))
        Smoother(self._settings, self._coefficients).forward(ends=True, **found.outputs(), **self._rows)
        return found

    def smoothed(self, process_noise: Floats | None = None) -> Estimates:
        """Return what each row tells with all others; innovations are those of the pass forward.

        Parameters
        ----------
        process_noise : (u, n, n) float array, optional
            In the place of its own.
        """
        found, smoother = Estimates.room(len(self._rows["z"])), Smoother(self._settings, self._coefficients)
        passed = smoother.forward(ends=True, **found.outputs(), **self._with(process_noise))
        smoother.backward(passed, smoother.nothing())
        return found

    def score(self, scored_from: int, process_noise: Floats | None = None) -> Sums:
        """Return what makes the likelihood of the rows from one on that are foretold.

        Parameters
        ----------
        scored_from : int
            Rows before it only start the filter.
        process_noise : (u, n, n) float array, optional
            In the place of its own.
        """
        return Sums(*score(self._settings, self._coefficients, scored_from, **self._with(process_noise)))

    def _with(self, process_noise: Floats | None) -> dict[str, Any]:
        return self._rows if process_noise is None else self._rows | {"Q": process_noise}
