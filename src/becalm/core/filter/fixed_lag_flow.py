"""A channel smoothed with a fixed lag, any rows at a time, in constant memory; the same bits however rows are cut.

What is told of row k is what `SmoothedFlow` says of it on the record that ends L rows later, but for the gate, which
decides as a causal filter does. The filter is `native/fixed_lag.c`: rows that wait go through it again, from the state
before them, once later ones are there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import BLOCK, Floats, input_of
from becalm.core.filter.channel import Estimates, log_densities, parts_of
from becalm.core.filter.channel_settings import ChannelSettings, StepTable, packed_coefficients, packed_settings
from becalm.core.filter.gate import Gate
from becalm.core.filter.lag import checked_lag
from becalm.core.model.components import Component
from becalm.core.model.magnitudes import largest_beside
from becalm.core.rows import EstimatedRows, Judge, Rows
from becalm.core.verdict import BEYOND_ANY_SENSOR, Verdict
from becalm.core.verdict import judge as judge_readings
from becalm.errors import ModelError
from becalm.native.smoothers import LateSmoother

_MOST_NUMBERS = 1 << 19  # of the states of rows that are taken at once
_FEW = 8 * BLOCK  # rows that are


class _Steps(Protocol):
    def before(self, elapsed: Floats) -> dict[str, Any]:
        """Return which step each of some rows follows, and the matrices of these steps."""
        ...


class LateRows:
    """Rows of one channel, each told by those up to a lag after it.

    Parameters
    ----------
    settings, coefficients : () structured array
        Of the channel, as C takes them.
    steps : object
        Its `before` gives the matrices of steps.
    lag : int
        Later rows that are waited for, 1 or more.
    split : bool
        Whether the smoothed states are wanted, too.

    Attributes
    ----------
    settled_row : int or None
        The first row with a settled gain.
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
        self._smoother, self._steps, self.lag = LateSmoother(settings, coefficients), steps, lag
        self._waiting = Rows.nothing()
        states = int(settings["states"])
        self._at_once = max(_FEW, _MOST_NUMBERS // states**2)
        self._states = states if split else 0
        self.settled_row: int | None = None

    @property
    def state(self) -> NDArray[np.void]:
        """What is known before the rows that wait."""
        return self._smoother.state

    @property
    def waiting(self) -> int:
        """Rows that wait."""
        return len(self._waiting.z)

    def begin_after(self, reading: float, readings: int, steps: float) -> None:
        """Say what went before: the first reading of all, how many came, and how many steps went by."""
        self._smoother.begin_after(reading, readings, steps)

    def take(self, rows: Rows) -> Iterator[tuple[Estimates, Estimates]]:
        """Take the next rows, a part at a time; give what is told of rows that have waited, and the newest filtered."""
        for at in range(0, len(rows.z), self._at_once):
            waited = len(self._waiting.z)
            all_rows = Rows.joined([self._waiting, rows.part(slice(at, at + self._at_once))])
            count = max(0, len(all_rows.z) - self.lag)
            found = self._smoothed(all_rows, count)
            left = all_rows.part(slice(count, None))
            self._waiting = Rows(left.z.copy(), left.elapsed.copy(), left.verdicts.copy())
            yield found.rows(slice(count)), found.rows(slice(waited, None))

    def stepper(self) -> Callable[[float], tuple[float, float]]:
        """Return what takes a reading one step after the last, and returns signal and sigma of the first that waits.

        Nothing is checked anew. As many rows have to wait as the lag has, without a gate; none may come another way.
        """
        now = self._waiting
        z, elapsed, verdicts = np.append(now.z, 0.0), np.append(now.elapsed, 1.0), np.append(now.verdicts, np.int8(0))
        found, self._waiting = Estimates.room(len(z)), Rows(z[:-1], elapsed[:-1], verdicts[:-1])
        arrays = found.outputs() | self._steps.before(elapsed) | {"z": z, "elapsed": elapsed}
        call = self._smoother.caller(self.lag, **arrays)

        def step(reading: float) -> tuple[float, float]:
            z[-1] = reading if abs(reading) <= BEYOND_ANY_SENSOR else np.nan
            call()
            for array in (z, elapsed, verdicts):
                array[:-1] = array[1:]
            return found.signal.item(0), found.sigma.item(0)

        return step

    def rest(self) -> Estimates:
        """Return the rows that wait, with what there is after them; nothing changes by it."""
        state, settled = self._smoother.state, self.settled_row
        self._smoother.state = np.frombuffer(bytearray(state.tobytes()), state.dtype).reshape(())
        found = self._smoothed(self._waiting, len(self._waiting.z))
        self._smoother.state, self.settled_row = state, settled
        return found

    def saved(self) -> dict[str, Any]:
        """Return what later rows depend on, as arrays."""
        waiting = {f"lag_{name}": array for name, array in self._waiting._asdict().items()}
        return self._smoother.state_dict() | waiting

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned; raises a ModelError if it is not that of such a filter and lag."""
        z, elapsed, verdicts = (np.array(arrays[f"lag_{name}"]) for name in Rows._fields)
        alike = z.dtype == elapsed.dtype == np.float64 and verdicts.dtype == np.int8
        if not (alike and z.shape == elapsed.shape == verdicts.shape == (z.size,)) or z.size > self.lag:
            raise ModelError("The snapshot's rows that wait are not those of this lag; pass what snapshot() returned.")
        if not ((elapsed >= 0).all() and np.isin(verdicts, list(Verdict)).all()):
            raise ModelError("The snapshot's rows that wait go back in time, or have no verdict; it is damaged.")
        self._smoother.load_state_dict(arrays)
        self._waiting = Rows(z, elapsed, verdicts)

    def _smoothed(self, rows: Rows, count: int) -> Estimates:
        """Filter rows that wait, and new ones; smooth the first of them."""
        found = Estimates.room(len(rows.z), self._states)
        arrays = found.outputs() | self._steps.before(rows.elapsed) | {"z": rows.z, "elapsed": rows.elapsed}
        settled = self._smoother.smooth(self.lag, count, **arrays)
        self.settled_row = settled if self.settled_row is None else self.settled_row
        return found._replace(verdict=np.where(found.verdict == Verdict.USED, rows.verdicts, found.verdict))


class FixedLagFlow:
    """A fixed-lag smoother of one channel that is fed any rows at a time.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    noise_variance : float
        R, in unit^2; a *small* one trusts the readings.
    lag : int
        Later rows that are waited for, 1 or more, however far apart; with a *small* one more noise is left.
    judge : callable, optional
        Shown the innovations of each push.
    split : bool
        Whether to tell the share of each part of the component, disturbances among them, too.
    gate : Gate, optional
        What leaves spikes out, and follows steps, as readings come; by default every reading is believed.

    Raises
    ------
    ModelError
        If the lag is no whole number, or the filter cannot start from measurements alone.
    """

    def __init__(  # noqa: PLR0913  (each by its name)
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
        self._late = LateRows(packed_settings(settings), coefficients, steps, checked_lag(lag), split=split)
        self._component, self._judge, self._split = component, judge, split
        self._largest, self._begun = largest_beside(noise_variance), False
        self.log_likelihood = 0.0

    @property
    def settled_row(self) -> int | None:
        """The first row with a settled gain."""
        return self._late.settled_row

    @property
    def shares(self) -> dict[str, float]:
        """Share of the rows in each mode; empty, for there are no modes."""
        return {}

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return the rows that have waited for them."""
        z, elapsed = input_of(z), input_of(elapsed)
        if len(z) and not self._begun:
            elapsed, self._begun = np.concatenate([[1.0], elapsed[1:]]), True  # the first row comes when it is due
        judged, told = judge_readings(z, self._largest), list[EstimatedRows]()
        for found, newest in self._late.take(Rows(judged.readings, elapsed, judged.verdicts)):
            self.log_likelihood += float(np.nansum(log_densities(newest.innovation, newest.deviation)))
            if self._judge is not None:
                self._judge(newest.innovation, newest.deviation)
            told.append(self._told(found))
        return told

    def finish(self) -> list[EstimatedRows]:
        """Return the last rows, with what there is after them; nothing changes by it: more rows may follow."""
        return [self._told(self._late.rest())]

    def begin_after(self, reading: float, readings: int, steps: float) -> None:
        """Say what went before: the first reading of all, how many came, and how many steps went by."""
        self._late.begin_after(reading, readings, steps)
        self._begun = readings > 0

    def saved(self) -> dict[str, Any]:
        """Return what rows depend on, as arrays."""
        return self._late.saved() | {"lag_begun": np.array(int(self._begun))}

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned; raises a ModelError if it is not that of such a filter and lag."""
        self._late.restore(arrays)
        self._begun = bool(arrays["lag_begun"])

    def _told(self, found: Estimates) -> EstimatedRows:
        told = found.told()
        return told._replace(parts=parts_of(self._component, found)) if self._split else told
