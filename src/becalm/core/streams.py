"""Several channels of a stream, a block of rows at a time: each row is told at once, as a filter knows it.

All rows go one by one, so that any cut gives the same bits. What is usual is one call of a kernel for all channels of
one size; only where readings do not tell a state yet, a row is taken here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from becalm.core import kernel_stream_layout as at
from becalm.core.arrays import Floats, Integers, input_of, read_only
from becalm.core.components import Component
from becalm.core.gates import Gate, level_of
from becalm.core.kernel_faults import new_memory as new_sensor_memory
from becalm.core.kernel_settling import COVARIANCE, GAIN, new_memory
from becalm.core.kernel_stream import run_streams
from becalm.core.kernel_stream_layout import Channels, Moving, Out, Rows, Work
from becalm.core.kernel_watch import DRIFT_SINCE, KEPT_HOPS, PARTS
from becalm.core.limits import Limits
from becalm.core.monitor import NEVER, Alarms
from becalm.core.possible import largest_beside, level_by
from becalm.core.reach import reach_of
from becalm.core.sized import size
from becalm.core.starting import (
    Information,
    carry_on,
    estimable,
    is_determined,
    known_before,
    known_state,
    learn,
    refuse_singular,
)
from becalm.core.steps import Steps
from becalm.core.timeline import model_system
from becalm.core.verdict import Verdict
from becalm.errors import ModelError

_ENDLESS = 1 << 53  # equal readings in a row: no stream has so many


class Widening(NamedTuple):
    """What makes the sigma of a signal larger than its filter's: by a share, by times, and by a calibration."""

    factor: float = 1.0
    time_std_s: float | None = None  # standard uncertainty of a reading's time
    included_std: float = 0.0  # what of it the noise holds already
    calibration: tuple[float, float] | None = None  # standard uncertainties of sensitivity, as a share, and of zero


class StreamChannel(NamedTuple):
    """What one channel is made of."""

    component: Component  # in steps
    noise_variance: float  # R, in unit^2
    limits: Limits
    alarms: Alarms
    gate: Gate | None = None
    widening: Widening = Widening()
    unknown_from: float = np.inf  # sigma from which on a row without a reading is a hole, in unit

    @property
    def disturbed(self) -> bool:
        """Whether its signal is less than what is read."""
        return any(part.disturbance for part in self.component.parts)


class Streams:
    """Causal filters of channels that have as many states each.

    Parameters
    ----------
    channels : sequence of StreamChannel
        One or more.
    columns : sequence of int
        Which columns of the blocks they are.

    Raises
    ------
    ModelError
        If one of them cannot start from readings alone.
    """

    def __init__(self, channels: Sequence[StreamChannel], columns: Sequence[int]) -> None:
        self._channels, self.columns = channels, columns
        self._models = [channel.component.to_model(1.0, channel.noise_variance) for channel in channels]
        for model in self._models:
            refuse_singular(model_system(model))
        self._states = size(self._models[0].states)
        self._steps = [Steps(channel.component) for channel in channels]
        self._even = self._parts()
        self._before = [known_before(model) for model in self._models]
        self._known: list[Information | None] = [None] * len(channels)
        blank = new_memory(np.zeros(len(self._states)), np.zeros((len(self._states),) * 2), 1)[0]
        self._blank = np.concatenate([np.zeros(at.FILTER), blank])
        self._blank[at.SENSOR : at.NOW] = new_sensor_memory()
        self._blank[[at.TOLD, at.READ]] = np.nan
        self.moving = Moving(np.tile(self._blank, (len(channels), 1)), np.zeros((len(channels), at.MARKS), np.int64))
        self.moving.marks[:, at.WATCH + DRIFT_SINCE] = -1

    def push(self, rows: Rows, out: Out) -> None:
        """Take a block, and write what is told of it; see `new_block`."""
        count, several = len(rows.elapsed), len(self._channels)
        channels = self._even
        if not rows.is_even:
            F, Q = self._over(rows.lengths)
            channels = channels._replace(F=F, Q=Q)
        work = Work(
            np.empty((several, count)), np.empty((several, count)), np.empty((several, count), np.int8),
            np.zeros((several, 3), np.int64),
        )  # fmt: skip
        while run_streams(self._states, channels, rows, self.moving, work, out):
            for c in np.flatnonzero(work.begun[:, at.FILTERED] < count).tolist():
                self._open(c, channels, rows, work, out)

    def _parts(self) -> Channels:
        """Lay all channels out for even time."""
        told = [one.component.signal_output if one.disturbed else one.component.output for one in self._channels]
        return Channels(
            *self._over(np.ones(1)),
            H=read_only(np.array([model.H for model in self._models])),
            C=read_only(np.array(told, dtype=np.float64)),
            R=read_only(np.array([model.R for model in self._models])),
            fixed=read_only(np.array([_fixed(one) for one in self._channels])),
            columns=read_only(np.array(self.columns, dtype=np.int64)),
        )

    def _over(self, lengths: Floats) -> tuple[Floats, Floats]:
        """Return F and Q of all channels over steps of several lengths, (C u, n, n) each."""
        whole = np.round(lengths)  # the nearest, for what is known at whole steps only: no stream ends by a late row
        wanted = [whole if channel.component.goes_in_steps else lengths for channel in self._channels]
        F, Q = zip(*(steps.over(own) for steps, own in zip(self._steps, wanted, strict=True)), strict=True)
        return read_only(np.concatenate(F)), read_only(np.concatenate(Q))

    def _open(self, c: int, channels: Channels, rows: Rows, work: Work, out: Out) -> None:
        """Take rows of a channel, from where it stopped, until they tell its state, or no more are there."""
        row = int(work.begun[c, at.FILTERED])
        while row < len(rows.elapsed):
            if work.anew[c, row]:
                self._forget(c)
            usable = float(work.usable[c, row])
            if self._known[c] is None and np.isnan(usable):
                break
            step = c * len(rows.lengths) + int(rows.step[row])
            told = self._gather(c, usable, channels.F[step], channels.Q[step])
            out.signal[row, self.columns[c]], out.sigma[row, self.columns[c]] = told
            work.normalised[c, row] = np.nan
            row += 1
            if self.moving.marks[c, at.KNOWN] == at.DETERMINED:
                break
        work.begun[c, at.FILTERED] = row

    def _forget(self, c: int) -> None:
        """Start a channel anew, with what is known of its sensor."""
        numbers, blank = self.moving.numbers[c], self._blank
        self._known[c], self.moving.marks[c, at.KNOWN] = None, at.UNKNOWN
        numbers[at.LEVEL], numbers[at.GATE : at.POWERS] = 0.0, 0.0
        numbers[at.FILTER :] = blank[at.FILTER :]

    def _gather(self, c: int, usable: float, F: Floats, Q: Floats) -> tuple[float, float]:
        """Take one reading of an opening, NaN where none came; return signal and sigma as far as they are known."""
        numbers, H, R = self.moving.numbers[c], self._even.H[c], self._even.R[c]
        now = self._known[c]
        if now is None:
            now, keeps = self._before[c], self._channels[c].component.keeps_level
            numbers[at.LEVEL] = level_by(usable, self._channels[c].noise_variance) if keeps else 0.0
        else:
            now = carry_on(now, F, Q, self._models[c])
        now = self._known[c] = learn(now, H, R, np.array([usable - numbers[at.LEVEL]]))
        self.moving.marks[c, at.KNOWN] = at.GATHERING
        determined = is_determined(now.Y)
        if determined:
            x, P = known_state(now)
            numbers[at.FILTER :] = new_memory(x, P, 1)[0]
            self._known[c], self.moving.marks[c, at.KNOWN] = None, at.DETERMINED
        if not self._channels[c].disturbed:
            signal, variance = estimable(now, H)
            return float(signal[0]) + float(numbers[at.LEVEL]), float(np.sqrt(variance[0]))
        if not determined:
            return np.nan, np.inf
        C = self._even.C[c][0]
        return float(C @ x) + float(numbers[at.LEVEL]), float(np.sqrt(max(C @ P @ C, 0.0)))

    def counts(self, place: int) -> dict[Verdict, int]:
        """Return how often a channel's readings met each verdict."""
        return dict(zip(Verdict, self.moving.marks[place, at.COUNTS :].tolist(), strict=True))

    def powers(self, place: int) -> Floats:
        """Return the sums of squares of a channel's last hops of innovations, in sigma^2, in no order."""
        hops = min(int(self.moving.marks[place, at.HOPS]), KEPT_HOPS)
        return self.moving.numbers[place, at.POWERS : at.POWERS + hops]

    def drift_since(self, place: int) -> int | None:
        """Return the row in which the first drift that was told of a channel began."""
        since = int(self.moving.marks[place, at.WATCH + DRIFT_SINCE])
        return None if since < 0 else since

    def is_silent(self, place: int) -> bool:
        """Whether a channel's last window of innovations was that of a dead sensor."""
        return bool(self.moving.marks[place, at.SILENT])

    def saved(self) -> dict[str, Floats | Integers]:
        """Return all that moves, as arrays."""
        n = len(self._states)
        known = np.zeros((len(self._known), n * n + n))
        for c, now in enumerate(self._known):
            if now is not None:
                known[c] = np.concatenate([now.Y.ravel(), now.y])
        return {"numbers": self.moving.numbers, "marks": self.moving.marks, "known": known}

    def restore(self, numbers: Floats, marks: Integers, known: Floats) -> None:
        """Take over what `saved` returned.

        Raises
        ------
        ModelError
            If these are not the arrays of such channels: kernels trust them.
        """
        own, n = self.saved(), len(self._states)
        for name, array in (("numbers", numbers), ("marks", marks), ("known", known)):
            if array.shape != own[name].shape or array.dtype != own[name].dtype:
                raise ModelError(f"The {name} of a snapshot are {array.dtype} of shape {array.shape}, not those here.")
        if not (
            (marks[:, at.KNOWN] >= at.UNKNOWN) & (marks[:, at.KNOWN] <= at.DETERMINED) & (marks[:, at.HOPS] >= 0)
        ).all():
            raise ModelError("The marks of a snapshot say what none can say; pass what snapshot() returned.")
        self.moving.numbers[:], self.moving.marks[:] = numbers, marks
        for c, row in enumerate(known):
            gathering = marks[c, at.KNOWN] == at.GATHERING
            self._known[c] = Information(row[: n * n].reshape(n, n), row[n * n :]) if gathering else None


def new_block(values: Floats, elapsed: Floats, step_s: float) -> tuple[Rows, Out]:
    """Lay a block out, values (B, m) and the steps before its rows (B,), and make room for what will be told of it."""
    rows = Rows(input_of(values), input_of(elapsed), np.zeros(len(elapsed), np.int64), np.ones(1), step_s)
    if not (elapsed == 1.0).all():
        lengths, step = np.unique(elapsed, return_inverse=True)
        rows = rows._replace(step=step.astype(np.int64), lengths=lengths)
    return rows, Out(np.empty(values.shape), np.empty(values.shape), np.zeros(values.shape, np.int8))


def _fixed(channel: StreamChannel) -> Floats:
    """Lay out the numbers of a channel, as kernels read them."""
    fixed = np.zeros(at.FIXED)
    limits, gate, widening = channel.limits, channel.gate, channel.widening
    reach = reach_of(channel.component, channel.noise_variance)
    fixed[at.LOW], fixed[at.HIGH], fixed[at.IMPOSSIBLE] = limits.low, limits.high, limits.largest
    fixed[at.STUCK] = min(limits.stuck_readings or 0, _ENDLESS)
    fixed[at.OUTLIERS :] = limits.outliers
    fixed[at.LARGEST], fixed[at.VARIANCE] = largest_beside(channel.noise_variance), channel.noise_variance
    fixed[at.ENOUGH] = COVARIANCE if channel.disturbed else GAIN
    fixed[at.LONGEST], fixed[at.SPANS], fixed[at.TELLING] = reach
    if gate is not None:
        level = level_of(channel.component.to_model(1.0, channel.noise_variance))
        fixed[at.GATED : at.LEVEL_STATE + 1] = 1.0, gate.threshold, gate.agree, gate.at_most, level
    fixed[at.DRIFT_AT] = np.ceil(min(channel.alarms.drift_threshold, NEVER) * PARTS)
    fixed[at.DEAD_BELOW] = channel.alarms.dead_variance
    fixed[at.FACTOR], fixed[at.UNKNOWN_FROM] = widening.factor, channel.unknown_from
    if widening.time_std_s is not None:
        fixed[at.TIMED], fixed[at.TIME_STD], fixed[at.TIME_INCLUDED] = (
            1.0,
            widening.time_std_s,
            widening.included_std**2,
        )
    if widening.calibration is not None:
        fixed[at.CALIBRATED], (fixed[at.RELATIVE], fixed[at.OFFSET]) = 1.0, widening.calibration
    return fixed
