"""Smooth one channel with a fixed lag of L rows, block by block and in constant memory.

The estimate of row k is that of `SmoothedFlow` on the record that ends at row k + L, except that the gate decides
causally. The boundaries between blocks change no bit. The filter is `native/fixed_lag.c`: when later rows arrive, it
filters the waiting rows again, from the state before them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from operator import index
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import BLOCK, Floats, input_of
from becalm.core.filter.channel import Estimates, log_densities, parts_of
from becalm.core.filter.channel_settings import ChannelSettings, StepTable, packed_coefficients, packed_settings
from becalm.core.filter.gate import Gate
from becalm.core.model.components import Component
from becalm.core.model.parts import largest_magnitude_for_noise
from becalm.core.reading_verdicts import BEYOND_ANY_SENSOR, Verdict
from becalm.core.reading_verdicts import judge as judge_readings
from becalm.core.rows import EstimatedRows, Judge, Rows
from becalm.errors import ModelError
from becalm.native.smoothers import LagSmoother

# Check the lag of a fixed-lag smoother.

LONGEST_LAG = 1 << 20
"""The longest lag, in readings; the smoother holds a window of this length."""


def checked_lag(lag: int) -> int:
    """Return the lag as a whole number of rows.

    Raises
    ------
    ModelError
        If the lag is not a whole number from 0 to 2^20.
    """
    try:
        rows = index(lag)
    except TypeError as cause:
        raise ModelError(f"lag = {lag!r} is not a number of readings; give a whole number, 0 to filter.") from cause
    if rows > LONGEST_LAG:
        raise ModelError(f"lag = {rows} needs a window of too many readings; give up to {LONGEST_LAG}, or smooth.")
    if rows < 0:
        raise ModelError(f"lag = {rows} is negative; give a whole number, 0 to filter.")
    return rows


_MOST_NUMBERS = 1 << 19  # numbers in the state matrices of the rows that are processed at once
_FEW = 8 * BLOCK  # least number of rows that are processed at once


class _Steps(Protocol):
    def before(self, elapsed: Floats) -> dict[str, Any]:
        """Return the index of the step before each row, and the matrices of these steps."""
        ...


class FixedLagSmoother:
    """A fixed-lag smoother of one channel: it estimates each row once the next `lag` rows are there.

    Parameters
    ----------
    settings, coefficients : () structured array
        Settings and coefficients of the channel, as C's structs.
    steps : object
        An object whose method `before` returns the matrices of the steps before rows.
    lag : int
        Lag in rows, 1 or more.
    split : bool
        Whether to return also the smoothed states.

    Attributes
    ----------
    settled_row : int or None
        The first row with the steady-state gain; None if there is none yet.
    """

    def __init__(
        self,
        settings: NDArray[np.void],
        coefficients: NDArray[np.void],
        steps: _Steps,
        lag: int,
        *,
        split: bool = False,
    ) -> None:
        self._smoother, self._steps, self.lag = LagSmoother(settings, coefficients), steps, lag
        self._waiting = Rows.empty()
        states = int(settings["states"])
        self._at_once = max(_FEW, _MOST_NUMBERS // states**2)
        self._states = states if split else 0
        self.settled_row: int | None = None

    @property
    def state(self) -> NDArray[np.void]:
        """Return the state before the waiting rows."""
        return self._smoother.state

    @property
    def waiting(self) -> int:
        """Return the number of waiting rows."""
        return len(self._waiting.z)

    def set_history(self, reading: float, readings: int, steps: float) -> None:
        """Set the history before the first row: the record's first reading, the number of readings, and of steps."""
        self._smoother.set_history(reading, readings, steps)

    def take(self, rows: Rows) -> Iterator[tuple[Estimates, Estimates]]:
        """Take the next rows in parts. For each part yield the due rows, smoothed, and the new rows, filtered."""
        for at in range(0, len(rows.z), self._at_once):
            waited = len(self._waiting.z)
            all_rows = Rows.joined([self._waiting, rows.part(slice(at, at + self._at_once))])
            count = max(0, len(all_rows.z) - self.lag)
            estimates = self._smoothed(all_rows, count)
            rest = all_rows.part(slice(count, None))
            self._waiting = Rows(rest.z.copy(), rest.elapsed.copy(), rest.verdicts.copy())
            yield estimates.rows(slice(count)), estimates.rows(slice(waited, None))

    def stepper(self) -> Callable[[float], tuple[float, float]]:
        """Return a fast function that takes one reading, one step after the last, and returns signal and sigma.

        The results belong to the oldest waiting row. The function checks nothing. It needs `lag` waiting rows and no
        gate, and is valid until the next call of `take`.
        """
        now = self._waiting
        z, elapsed, verdicts = np.append(now.z, 0.0), np.append(now.elapsed, 1.0), np.append(now.verdicts, np.int8(0))
        estimates, self._waiting = Estimates.allocate(len(z)), Rows(z[:-1], elapsed[:-1], verdicts[:-1])
        arrays = estimates.outputs() | self._steps.before(elapsed) | {"z": z, "elapsed": elapsed}
        call = self._smoother.caller(self.lag, **arrays)

        def step(reading: float) -> tuple[float, float]:
            z[-1] = reading if abs(reading) <= BEYOND_ANY_SENSOR else np.nan
            call()
            for array in (z, elapsed, verdicts):
                array[:-1] = array[1:]
            return estimates.signal.item(0), estimates.sigma.item(0)

        return step

    def estimate_waiting(self) -> Estimates:
        """Return estimates of the waiting rows from the rows so far; the state does not change."""
        state, settled = self._smoother.state, self.settled_row
        self._smoother.state = np.frombuffer(bytearray(state.tobytes()), state.dtype).reshape(())
        estimates = self._smoothed(self._waiting, len(self._waiting.z))
        self._smoother.state, self.settled_row = state, settled
        return estimates

    def state_dict(self) -> dict[str, Any]:
        """Return the state that later rows depend on, as arrays."""
        waiting = {f"lag_{name}": array for name, array in self._waiting._asdict().items()}
        return self._smoother.state_dict() | waiting

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`; raise a ModelError if it does not fit this filter and lag."""
        z, elapsed, verdicts = (np.array(arrays[f"lag_{name}"]) for name in Rows._fields)
        fits = z.dtype == elapsed.dtype == np.float64 and verdicts.dtype == np.int8
        if not (fits and z.shape == elapsed.shape == verdicts.shape == (z.size,)) or z.size > self.lag:
            raise ModelError("The snapshot's waiting rows do not fit this lag; pass what snapshot() returned.")
        if not ((elapsed >= 0).all() and np.isin(verdicts, list(Verdict)).all()):
            raise ModelError("The snapshot's waiting rows go back in time, or have no verdict; it is damaged.")
        self._smoother.load_state_dict(arrays)
        self._waiting = Rows(z, elapsed, verdicts)

    def _smoothed(self, rows: Rows, count: int) -> Estimates:
        """Filter waiting and new rows; smooth the first `count` of them."""
        estimates = Estimates.allocate(len(rows.z), self._states)
        arrays = estimates.outputs() | self._steps.before(rows.elapsed) | {"z": rows.z, "elapsed": rows.elapsed}
        settled = self._smoother.smooth(self.lag, count, **arrays)
        self.settled_row = settled if self.settled_row is None else self.settled_row
        return estimates._replace(verdict=np.where(estimates.verdict == Verdict.USED, rows.verdicts, estimates.verdict))


class FixedLagFlow:
    """A fixed-lag smoother of one channel; a push may have any number of rows.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    noise_variance : float
        R, in unit^2; a *small* one trusts the readings.
    lag : int
        Lag in rows, 1 or more, for any time between rows; a *small* lag leaves more noise.
    judge : callable, optional
        It receives the innovations of each push, and their expected standard deviations.
    split : bool
        Whether to return also the contribution of each part of the component, including disturbances.
    gate : Gate, optional
        The innovation gate, which rejects spikes and follows steps causally; by default every reading is used.

    Raises
    ------
    ModelError
        If the lag is not a whole number, or the filter cannot start from measurements alone.
    """

    def __init__(  # noqa: PLR0913  (keyword arguments)
        self,
        component: Component,
        noise_variance: float,
        *,
        lag: int,
        judge: Judge | None = None,
        split: bool = False,
        gate: Gate | None = None,
    ) -> None:
        settings = ChannelSettings(component, noise_variance, gate=gate)
        coefficients = packed_coefficients(component, noise_variance, disturbed=settings.disturbed)
        steps = StepTable(component, nearest=False)
        self._smoother = FixedLagSmoother(packed_settings(settings), coefficients, steps, checked_lag(lag), split=split)
        self._component, self._judge, self._split = component, judge, split
        self._largest, self._has_rows = largest_magnitude_for_noise(noise_variance), False
        self.log_likelihood = 0.0

    @property
    def settled_row(self) -> int | None:
        """Return the first row with the steady-state gain; None if there is none yet."""
        return self._smoother.settled_row

    @property
    def shares(self) -> dict[str, float]:
        """Return the share of the rows in each mode: empty, because there are no modes."""
        return {}

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return the waiting rows that are now due."""
        z, elapsed = input_of(z), input_of(elapsed)
        if len(z) and not self._has_rows:
            elapsed, self._has_rows = np.concatenate([[1.0], elapsed[1:]]), True  # the first row is on time
        judged, output = judge_readings(z, self._largest), list[EstimatedRows]()
        for due, newest in self._smoother.take(Rows(judged.readings, elapsed, judged.verdicts)):
            self.log_likelihood += float(np.nansum(log_densities(newest.innovation, newest.deviation)))
            if self._judge is not None:
                self._judge(newest.innovation, newest.deviation)
            output.append(self._estimated(due))
        return output

    def finish(self) -> list[EstimatedRows]:
        """Return estimates of the waiting rows from the rows so far; the state does not change, so more may follow."""
        return [self._estimated(self._smoother.estimate_waiting())]

    def set_history(self, reading: float, readings: int, steps: float) -> None:
        """Set the history before the first row: the record's first reading, the number of readings, and of steps."""
        self._smoother.set_history(reading, readings, steps)
        self._has_rows = readings > 0

    def state_dict(self) -> dict[str, Any]:
        """Return the state that later rows depend on, as arrays."""
        return self._smoother.state_dict() | {"lag_begun": np.array(int(self._has_rows))}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`; raise a ModelError if it does not fit this filter and lag."""
        self._smoother.load_state_dict(arrays)
        self._has_rows = bool(arrays["lag_begun"])

    def _estimated(self, estimates: Estimates) -> EstimatedRows:
        rows = estimates.to_rows()
        return rows._replace(parts=parts_of(self._component, estimates)) if self._split else rows
