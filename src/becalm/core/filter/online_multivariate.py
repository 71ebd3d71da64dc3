"""Filter a stream of several channels, one step per row, with or without a lag, with the kernel of `kalman_filter`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import DEFAULT_RESULTS, new_kernel, rows_of
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import even_timeline
from becalm.errors import ModelError
from becalm.native.multivariate import EstimateBuffers


class OnlineMultivariate:
    """A stream filter for a model of several channels, one step per row.

    Parameters
    ----------
    model : Model
        A model of several channels.
    lag : int
        Lag in rows; 0 filters.

    Raises
    ------
    ModelError
        If the model is too large, or cannot start without x0 and P0.
    """

    def __init__(self, model: Model, lag: int) -> None:
        self.model, self.lag = model, lag
        self._kernel = new_kernel(model, even_timeline(model, 1), DEFAULT_RESULTS)
        self._waiting, self._rows_to_skip = np.empty((0, model.channels)), lag

    def run(self, z: Floats) -> tuple[Floats, Floats]:
        """Take a block, (B, m); return signal and sigma, (B, m) each, of the rows one lag earlier."""
        if not self.lag:
            signal, sigma = np.empty((2, *z.shape))
            self._kernel.filter(rows_of(self._timeline(len(z)), z), EstimateBuffers(signal, sigma))
            return signal, sigma
        rows, at = np.concatenate([self._waiting, z]), min(self._rows_to_skip, len(z))
        signal, sigma = np.full(z.shape, np.nan), np.full(z.shape, np.inf)
        signal[at:], sigma[at:] = self._smoothed(rows, len(z) - at)
        self._waiting, self._rows_to_skip = rows[len(z) - at :].copy(), self._rows_to_skip - at
        return signal, sigma

    def stepper(self) -> Callable[[float], tuple[float, float]] | None:
        """Return None: the fast function of one number does not exist for several channels."""
        return None

    def finish(self) -> tuple[Floats, Floats]:
        """Return signal and sigma, (rows, m) each, of the waiting rows; the state does not change."""
        state = self._kernel.state.copy()
        estimates = self._smoothed(self._waiting, len(self._waiting))
        self._kernel.state = state
        return estimates

    def state_dict(self) -> dict[str, Any]:
        """Return the state, as arrays."""
        return {"live": self._kernel.state_dict(), "waiting": self._waiting, "unwaited": np.array(self._rows_to_skip)}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`.

        Raises
        ------
        ModelError
            If the arrays do not fit this filter.
        """
        waiting, rows_to_skip = np.array(arrays["waiting"]), int(arrays["unwaited"])
        fits = waiting.dtype == np.float64 and waiting.ndim == 2 and waiting.shape[1] == self.model.channels
        if not fits or not 0 <= rows_to_skip <= self.lag or len(waiting) + rows_to_skip != self.lag:
            raise ModelError("The snapshot's waiting rows do not fit this lag; pass what snapshot() returned.")
        self._kernel.load(np.asarray(arrays["live"]))
        self._waiting, self._rows_to_skip = waiting, rows_to_skip

    def _smoothed(self, rows: Floats, count: int) -> tuple[Floats, Floats]:
        return self._kernel.smooth_late(rows_of(self._timeline(len(rows)), rows), self.lag, count)

    def _timeline(self, count: int) -> Any:
        return even_timeline(self.model, count, continues=bool(self._kernel.head["rows"]))
