"""Fixed-lag smoothing: each row is told when the L rows after it are there, and knows them.

Between the filter (L = 0) and the smoother (all rows): a little delay buys much noise. What is told of row k
is what `kalman_smoother` says of it on the record that ends with row k + L.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats
from becalm.core.filtering import Wanted, checked_readings, kalman_filter, new_trace, sizes_of
from becalm.core.kernel_lag import open_window, run_late, run_out
from becalm.core.kernel_lag_window import PLACE, ROWS, WEIGHED, Window, new_window, newest_taken
from becalm.core.kernel_settling import GAIN, new_memory, rename_last_step
from becalm.core.kernels import Trace, new_trace, sizes_of
from becalm.core.lag_opening import LagOpening, Taken
from becalm.core.lags import checked_lag
from becalm.core.model import Model
from becalm.core.online_channel import OnlineChannel
from becalm.core.sized import Size, Sizes, size
from becalm.core.starting import arrived, first_reading, refuse_singular, wide_prior
from becalm.core.sums import Sums
from becalm.core.system import Step
from becalm.core.timeline import Timeline, even_timeline, model_system
from becalm.errors import ModelError

_FAR = 1 << 52  # rows: more than are ever counted


class Late(NamedTuple):
    """What some rows brought: outputs and sigma of the rows L before them, innovations of their own."""

    signal: Floats  # (p, B) NaN where no row is L before
    sigma: Floats  # (p, B) then inf
    innovations: Floats  # (m, B) where wanted
    innovation_sigma: Floats  # (m, B)
    sums: Sums
    settled_row: int | None


def fixed_lag_smoother(model: Model, z: ArrayLike, lag: int) -> tuple[Floats, Floats]:
    """Smooth readings with a fixed lag: each estimate knows the readings up to `lag` rows after its own.

    Parameters
    ----------
    model : Model
        The signal and its sensors, one step a row.
    z : (N,) or (N, m) array_like
        Readings in the channels' units; NaN or Inf where one did not arrive. Never modified.
    lag : int
        Later rows that are waited for; with a *small* one the signal comes soon, and noisier. 0 filters.

    Returns
    -------
    signal, sigma : (N, m) float arrays
        H x, and one standard uncertainty of it, in the channels' units. The last `lag` rows know what there is.

    Raises
    ------
    ModelError
        If z does not fit the model, the lag is no whole number, or the model cannot start without x0 and P0.
    """
    readings = checked_readings(model, z)
    if checked_lag(lag) == 0:
        found = kalman_filter(model, readings, innovations=False)
        return found.signal, found.sigma
    if model.channels == 1:
        return _single(OnlineChannel(model, checked_lag(lag), None), readings)
    smoother = FixedLag(model, lag)
    late = smoother.push(even_timeline(model, len(readings)), readings)
    signal, sigma = smoother.rest()
    waited = min(smoother.lag, len(readings))
    return np.hstack([late.signal[:, waited:], signal]).T, np.hstack([late.sigma[:, waited:], sigma]).T


def _single(channel: OnlineChannel, z: Floats) -> tuple[Floats, Floats]:
    told, rest = channel.run(z), channel.finish()
    waited = min(channel.lag, len(z))
    signal, sigma = (np.concatenate([one[waited:], last]) for one, last in zip(told, rest, strict=True))
    return signal, sigma


class FixedLag:
    """A fixed-lag smoother that is fed rows as they come.

    Parameters
    ----------
    model : Model
        The signal and its sensors.
    lag : int
        Later rows that are waited for, L, 1 or more; with a *small* one the signal comes soon, and noisier.
    output : (p, n) array, optional
        The rows that make the outputs from the states; H by default.
    enough : float
        What has to settle before a gain is used again, GAIN or COVARIANCE.

    Raises
    ------
    ModelError
        If the model cannot start without x0 and P0, or the lag is no whole number.
    """

    def __init__(
        self,
        model: Model,
        lag: int,
        output: Floats | None = None,
        enough: float = GAIN,
    ) -> None:
        self.model, self.lag, self._enough = model, checked_lag(lag), enough
        self._C = np.array(model.H if output is None else output)
        self._system = model_system(model)
        self._window = new_window(len(self._C), model.states, model.channels, self.lag)
        self._memory: Floats | None = None  # of the filter, once the state is known
        self._last_step = np.nan  # length of the step before the last row, if that was complete
        self._opening = LagOpening(model, self._C, self.lag)
        if model.x0 is not None and model.P0 is not None and wide_prior(model) is None:
            self._memory = new_memory(model.x0, model.P0, model.channels)[0]
        else:
            refuse_singular(self._system)

    @property
    def waiting(self) -> int:
        """Rows that were not told yet, at most `lag`."""
        return self._opening.waiting + min(self._rows, self.lag)

    @property
    def _rows(self) -> int:
        """Rows since the state is known, its own among them."""
        return int(self._window.counters[ROWS])

    @property
    def _sizes(self) -> tuple[Size, Sizes]:
        return size(len(self._C)), sizes_of(self.model)

    def push(self, timeline: Timeline, z: Floats, *, innovations: bool = False) -> Late:
        """Take rows of readings (B, m) over a timeline; tell the rows that have waited for them."""
        trace, row = self._room(len(z), innovations), 0
        if self._memory is None:
            row = self._open(timeline, z, trace)
        elif len(z):
            same = np.flatnonzero(timeline.lengths == self._last_step)
            number = int(same[0]) if len(same) else None
            rename_last_step(self._memory, self.model.states, self.model.channels, number)
        total, settled, begun = Sums(), None, row
        while row < len(z):
            stop = row + 1 if self._opening.waiting else len(z)
            sums, now = self._run(timeline, z, slice(row, stop), trace)
            total, settled = total.plus(sums), now if settled is None else settled
            if self._opening.waiting:
                self._opening.learn_later(self._newest())
                self._tell_early(trace, row)
            row = stop
        if row > begun:
            step = timeline.step_before(len(z) - 1)
            goes_on = step >= 0 and arrived(z[-1]).all()
            self._last_step = float(timeline.lengths[step]) if goes_on else np.nan
        return Late(trace.signal, trace.sigma, trace.innovation, trace.innovation_sigma, total, settled)

    def rest(self) -> tuple[Floats, Floats]:
        """Return outputs and sigma, (p, rows) each, of the rows that wait, with what there is after them."""
        early, last = self._opening.tell_all(), np.empty((2, len(self._C), min(self._rows, self.lag)))
        run_out(*self._sizes, self._C, self._system, self._window, last[0], last[1])
        signal, sigma = np.empty((2, len(self._C), len(early)))
        for row, (told, variance) in enumerate(early):
            signal[:, row], sigma[:, row] = told, np.sqrt(np.maximum(variance, 0.0))
        return np.hstack([signal, last[0]]), np.hstack([sigma, last[1]])

    def snapshot(self) -> dict[str, Floats]:
        """Return what moves, as arrays."""
        moves = {f"window_{field}": np.asarray(array) for field, array in self._window._asdict().items()}
        moves |= {"last_step": np.array(self._last_step)} | self._opening.snapshot()
        if self._memory is None:
            return moves
        memory = self._memory.copy()  # in which the last step is the first of any timeline, however rows were cut
        rename_last_step(memory, self.model.states, self.model.channels, None if np.isnan(self._last_step) else 0)
        return moves | {"memory": memory}

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Take over what moves, of the right shapes and types only: kernels trust them.

        Raises
        ------
        ModelError
            If the arrays are not those of a snapshot of this model and lag.
        """
        window = {field: np.array(arrays[f"window_{field}"]) for field in Window._fields}
        memory = np.array(arrays["memory"]) if "memory" in arrays else None
        blank = new_memory(np.zeros(self.model.states), np.zeros((self.model.states,) * 2), self.model.channels)[0]
        pairs = [(window[field], own) for field, own in self._window._asdict().items()]
        pairs += [] if memory is None else [(memory, blank)]
        alike = all(a.shape == b.shape and a.dtype == b.dtype and np.isfinite(a).all() for a, b in pairs)
        places = np.append(window["place"], window["counters"][PLACE:WEIGHED])
        if not alike or not ((places >= 0) & (places < self.lag + 2)).all() or not 0 <= window["counters"][ROWS] < _FAR:
            raise ModelError("The snapshot's fixed lag is not that of its model; pass what snapshot() returned.")
        self._window, self._memory, self._last_step = Window(**window), memory, float(arrays["last_step"])  # type: ignore[arg-type]
        self._opening.restore(arrays)

    def _room(self, count: int, innovations: bool) -> Trace:
        trace = new_trace(self.model, count, innovations=innovations)
        trace.innovation[:], trace.innovation_sigma[:] = np.nan, np.nan
        p = len(self._C)
        return trace._replace(signal=np.full((p, count), np.nan), sigma=np.full((p, count), np.inf))

    def _open(self, timeline: Timeline, z: Floats, trace: Trace) -> int:
        """Take rows until the state is known; return how many."""
        unread = first_reading(z) if self._opening.blank else 0
        for row in range(max(0, unread - self.lag), unread):
            self._opening.take(_step_before(timeline, row), timeline.system, z[row])
        self._opening.forget_surplus()
        for row in range(unread, len(z)):
            known = self._opening.take(_step_before(timeline, row), timeline.system, z[row])
            if known is not None:
                self._memory = new_memory(*known, self.model.channels)[0]
                open_window(*self._sizes, self._C, timeline.system, self._memory, self._window)
            self._tell_early(trace, row)
            if known is not None:
                return row + 1
        return len(z)

    def _tell_early(self, trace: Trace, row: int) -> None:
        """Write at a row what is told of one of the opening, if one has waited for it."""
        told = self._opening.tell(self._rows)
        if told is not None:
            trace.signal[:, row], trace.sigma[:, row] = told[0], np.sqrt(np.maximum(told[1], 0.0))

    def _run(self, timeline: Timeline, z: Floats, rows: slice, trace: Trace) -> tuple[Sums, int | None]:
        assert self._memory is not None, "rows follow an opening whose state is known"
        found = run_late(
            *self._sizes, self._C, timeline.system, timeline.record(z), rows.start, rows.stop, self._enough,
            self._memory, self._window, trace,
        )  # fmt: skip
        return Sums(*found[:3]), None if found[3] < 0 else int(found[3])

    def _newest(self) -> Taken:
        """Return how the newest row was taken."""
        m = self.model.channels
        _, K, L, D, seen, F, _, nu = newest_taken(self._window, self.model.states, m)
        L = np.tril(L, -1) + np.eye(m)
        return Taken(F, self.model.H * seen[:, np.newaxis], K, L * D @ L.T, nu)


def _step_before(timeline: Timeline, row: int) -> Step:
    number, (F, Q, H, R) = max(timeline.step_before(row), 0), timeline.system
    return Step(F[number], Q[number], H, R)
