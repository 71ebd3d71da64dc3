"""Filter a stream of one channel, one step per reading, with or without a lag; files use the same kernel."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Codes, Floats
from becalm.core.filter.channel import Estimates
from becalm.core.filter.channel_settings import model_coefficients, model_settings
from becalm.core.filter.fixed_lag_flow import FixedLagSmoother
from becalm.core.filter.gate import Gate
from becalm.core.model.model import Model
from becalm.core.model.parts import largest_magnitude_for_noise
from becalm.core.model.prior import WIDE, refuse_singular, root_of, wide_prior
from becalm.core.model.step_matrices import model_system
from becalm.core.reading_verdicts import BEYOND_ANY_SENSOR, Verdict
from becalm.core.reading_verdicts import judge as judge_readings
from becalm.core.rows import Rows
from becalm.errors import ModelError
from becalm.native import DETERMINED, GATHERING, loaded, process, saved, start, stepper


class _ModelSteps(NamedTuple):
    """The matrices of a model whose steps all have the same length."""

    F: Floats  # (1, n, n)
    Q: Floats  # (1, n, n)

    def before(self, elapsed: Floats) -> dict[str, NDArray[np.int32] | Floats]:
        """Return the index of the step before each row, always 0, and the matrices of this step."""
        return {"step": np.zeros(len(elapsed), np.int32), "F": self.F, "Q": self.Q}


class OnlineChannel:
    """A stream filter for a model of one channel, one step per measurement.

    Parameters
    ----------
    model : Model
        A model of one channel.
    lag : int
        Lag in readings; 0 filters.
    gate : Gate, optional
        The innovation gate, which rejects spikes and follows steps; by default every reading is used.

    Raises
    ------
    ModelError
        If the model cannot start without x0 and P0.
    """

    def __init__(self, model: Model, lag: int, gate: Gate | None) -> None:
        self.model, self.gate, self.lag = model, gate, lag
        self._settings, self._coefficients = model_settings(model, gate), model_coefficients(model)
        self._largest = BEYOND_ANY_SENSOR if gate is None else largest_magnitude_for_noise(float(model.R[0, 0]))
        self._steps = _ModelSteps(*(np.require(A[:1], np.float64, ["C", "A"]) for A in model_system(model)[:2]))
        self._has_rows = False
        self._rows_to_skip = lag  # first rows without an estimate: there is no row one lag earlier
        self.verdicts: Codes = np.empty(0, np.int8)
        first_state = self._first_state()
        self._smoother = FixedLagSmoother(self._settings, self._coefficients, self._steps, lag) if lag else None
        self._state = start(self._settings)
        _begin(self._state if self._smoother is None else self._smoother.state, first_state)

    def run(self, z: Floats) -> tuple[Floats, Floats]:
        """Take a block, (B, 1); return signal and sigma, (B, 1) each, of the readings one lag earlier."""
        signal, sigma = self._run(np.require(z[:, 0], np.float64, ["C", "A"]))
        return signal[:, np.newaxis], sigma[:, np.newaxis]

    def _run(self, z: Floats) -> tuple[Floats, Floats]:
        elapsed = np.ones(len(z))
        if not self._has_rows:
            elapsed[:1] = 0.0
        self._has_rows = self._has_rows or len(z) > 0
        judged = judge_readings(z, self._largest)
        if self._smoother is not None:
            return self._run_with_lag(Rows(judged.readings, elapsed, judged.verdicts), self._smoother)
        estimates = Estimates.allocate(len(z))
        rows = estimates.outputs() | self._steps.before(elapsed) | {"z": judged.readings, "elapsed": elapsed}
        process(self._settings, self._coefficients, self._state, **rows)
        self.verdicts = np.where(estimates.verdict > Verdict.MISSING, estimates.verdict, judged.verdicts)
        return estimates.signal, estimates.sigma

    def stepper(self) -> Callable[[float], tuple[float, float]] | None:
        """Return a fast function from a reading to signal and sigma; None with a gate, or until `lag` readings wait."""
        if not self._has_rows or self._rows_to_skip or self.gate is not None:
            return None
        if self._smoother is not None:
            return self._smoother.stepper()
        return stepper(self._settings, self._coefficients, self._state, *self._steps)

    def finish(self) -> tuple[Floats, Floats]:
        """Return signal and sigma, (rows, 1) each, of the waiting readings; the state does not change."""
        if self._smoother is None:
            return np.empty((0, 1)), np.empty((0, 1))
        estimates = self._smoother.estimate_waiting()
        return estimates.signal[:, np.newaxis], estimates.sigma[:, np.newaxis]

    def state_dict(self) -> dict[str, Any]:
        """Return the state, as arrays."""
        counts = {"begun": np.array(self._has_rows), "unwaited": np.array(self._rows_to_skip)}
        if self._smoother is not None:
            return counts | self._smoother.state_dict()
        return counts | {"live": saved(self._settings, self._state)}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`.

        Raises
        ------
        ModelError
            If the arrays do not fit this filter.
        """
        self._has_rows, self._rows_to_skip = bool(arrays["begun"]), int(arrays["unwaited"])
        if self._smoother is not None:
            self._smoother.load_state_dict(arrays)
            if self._rows_to_skip < 0 or self._rows_to_skip + self._smoother.waiting != self.lag:
                raise ModelError("The snapshot's waiting rows do not fit its lag; pass what snapshot() returned.")
        else:
            self._state = loaded(self._settings, np.asarray(arrays["live"]))

    def _run_with_lag(self, rows: Rows, smoother: FixedLagSmoother) -> tuple[Floats, Floats]:
        count, newest = len(rows.z), list[Codes]()
        signal, sigma = np.full(count, np.nan), np.full(count, np.inf)
        at = min(self._rows_to_skip, count)
        self._rows_to_skip -= at
        for due, new in smoother.take(rows):
            signal[at : at + len(due.signal)], sigma[at : at + len(due.signal)] = due.signal, due.sigma
            at += len(due.signal)
            newest.append(new.verdict)
        self.verdicts = np.concatenate([np.empty(0, np.int8), *newest])
        return signal, sigma

    def _first_state(self) -> tuple[int, Floats, Floats] | None:
        """Return phase, x and P before the first reading; None for a flat prior.

        For a wide prior, x and P hold the right-hand side and the root of the prior information.
        """
        model, prior = self.model, wide_prior(self.model)
        if prior is not None and model.x0 is not None:
            self._coefficients["widest"] = WIDE
            root = root_of(prior.Y)
            return GATHERING, root @ model.x0, root
        if model.x0 is not None and model.P0 is not None:
            return DETERMINED, model.x0, model.P0
        refuse_singular(model_system(model))
        return None


def _begin(state: NDArray[np.void], first_state: tuple[int, Floats, Floats] | None) -> None:
    """Write phase, x and P into a new state; leave a flat prior as it is."""
    if first_state is None:
        return
    phase, x, P = first_state
    state["phase"], state["has_level"] = phase, 1
    state["x"][: len(x)], state["P"][: P.size] = x, P.ravel()
