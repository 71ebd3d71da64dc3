"""Restart the filter of a channel after a gap that is too long for float64; `channel_settings` derives the limit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from becalm.core.arrays import BLOCK, Booleans, Floats, input_of
from becalm.core.filter.channel import Channel
from becalm.core.filter.channel_settings import ChannelSettings, GapLimit
from becalm.core.filter.gate import Gate
from becalm.core.model.components import Component
from becalm.core.reading_verdicts import BEYOND_ANY_SENSOR
from becalm.core.reading_verdicts import judge as judge_readings
from becalm.core.rows import EstimatedRows

_ROWS_AT_ONCE = 4096  # rows that are searched for gaps at once
_SHORTEST = 1e-300  # steps; it replaces a time of 0, because inf * 0 is NaN


class PartialFlow(Protocol):
    """The interface of a filter or smoother for one part of a record, such as `ImmFlow`."""

    @property
    def log_likelihood(self) -> float:
        """Return the log-likelihood of the measurements so far."""
        ...

    @property
    def settled_row(self) -> int | None:
        """Return the first row of the part with the steady-state gain; None if there is none."""
        ...

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows; return the rows whose estimates are final."""
        ...

    def finish(self) -> list[EstimatedRows]:
        """End the part; return the rows that were waiting."""
        ...

    def state_dict(self) -> dict[str, Any] | None:
        """Return the state that later rows depend on, as arrays; None while rows wait."""
        ...

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`."""
        ...

    def set_level(self, reading: float) -> None:
        """Set the level, which is subtracted from readings, to the record's first reading; call it before any push."""
        ...


class _Part(NamedTuple):
    """The results of one part of the record."""

    rows: int  # number of rows
    weight: int  # number of rows from the first reading on
    log_likelihood: float
    settled_row: int | None
    shares: dict[str, float]  # share of the rows in each mode of an IMM


class RestartingFlow:
    """A filter or smoother of one channel that restarts after a gap beyond its limit.

    Until the first such gap, each push goes to the inner filter unchanged. After a restart, rows are collected into
    stretches, counted from the restart; a stretch is as long as the first push, rounded down to whole blocks. So the
    estimates of a part have the same bits as if it were a separate record.

    Parameters
    ----------
    open_flow : callable
        It returns a new filter or smoother for one part.
    gap_limit : GapLimit
        The gaps that the filter bridges; with a *small* limit the channel restarts more often.
    largest : float
        Magnitude, in unit, beyond which a value is not a reading; the inner filter must have the same limit.
    """

    def __init__(
        self, open_flow: Callable[[], PartialFlow], gap_limit: GapLimit, largest: float = BEYOND_ANY_SENSOR
    ) -> None:
        self._open_flow, self._largest = open_flow, largest
        self._gaps = GapDetector(gap_limit)
        self._flow = open_flow()
        self._finished: list[_Part] = []
        self._rows = self._weight = 0  # numbers of rows in the current part, see `_Part`
        self._stretch: int | None = None  # rows in a stretch; None before the first row
        self._incomplete = np.empty((2, 0))  # readings, and the steps before them, of an incomplete stretch

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return the rows whose estimates are final."""
        if self._stretch is None and len(z):
            self._stretch = max(BLOCK, len(z) // BLOCK * BLOCK)
        arrived = np.isfinite(judge_readings(z, self._largest).readings)
        estimates, begin = list[EstimatedRows](), 0
        for row in self._gaps.starts(arrived, elapsed):
            if row > begin:
                estimates += self._take(z[begin:row], elapsed[begin:row], arrived[begin:row])
            estimates += self._restart()
            begin = row
        return estimates + self._take(z[begin:], elapsed[begin:], arrived[begin:])

    def finish(self) -> list[EstimatedRows]:
        """End the record; return the rows that were waiting."""
        incomplete, self._incomplete = self._incomplete, np.empty((2, 0))
        estimates = self._flow.push(incomplete[0], incomplete[1]) if incomplete.shape[1] else []
        return estimates + self._flow.finish()

    def state_dict(self) -> dict[str, Any] | None:
        """Return the state that later rows depend on, as arrays; None while rows wait."""
        flow_state = None if self._incomplete.shape[1] else self._flow.state_dict()
        if flow_state is None:
            return None
        counts = np.array([self._stretch or 0, len(self._finished)])
        return flow_state | {"parted_gaps": self._gaps.state_dict(), "parted_told": counts}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`."""
        stretch, finished = arrays["parted_told"].tolist()
        self._stretch, self._finished = stretch or None, [_Part(0, 0, 0.0, None, {})] * finished
        self._gaps.load_state_dict(arrays["parted_gaps"])
        self._flow.load_state_dict(arrays)

    def set_level(self, reading: float) -> None:
        """Set the level, which is subtracted from readings, to the record's first reading; call it before any push."""
        self._flow.set_level(reading)

    def set_history(self, reading: float, readings: int, steps: float) -> None:
        """Set the history before the first row: the record's first reading, the number of readings, and of steps."""
        self.set_level(reading)
        self._gaps.load_state_dict(np.array([steps, steps, float(readings)]))

    @property
    def log_likelihood(self) -> float:
        """Return the log-likelihood of all measurements so far; the first of each part does not count."""
        return sum(part.log_likelihood for part in self._parts())

    @property
    def settled_row(self) -> int | None:
        """Return the first row with the steady-state gain; None if there is none."""
        begin = 0
        for part in self._parts():
            if part.settled_row is not None:
                return begin + part.settled_row
            begin += part.rows
        return None

    @property
    def shares(self) -> dict[str, float]:
        """Return the share of the rows so far in each mode of an IMM; empty for a single model."""
        parts = self._parts()
        if len(parts) == 1:
            return parts[0].shares
        total = max(sum(part.weight for part in parts), 1)
        return {name: sum(part.weight * part.shares[name] for part in parts) / total for name in parts[0].shares}

    def _parts(self) -> list[_Part]:
        flow = self._flow
        shares = dict(getattr(flow, "shares", {}))
        return [*self._finished, _Part(self._rows, self._weight, flow.log_likelihood, flow.settled_row, shares)]

    def _take(self, z: Floats, elapsed: Floats, arrived: Booleans) -> list[EstimatedRows]:
        self._rows += len(z)
        first_reading = int(arrived.argmax()) if arrived.any() else len(z)
        self._weight += len(z) if self._weight else len(z) - first_reading
        if not self._finished:
            return self._flow.push(z, elapsed)
        assert self._stretch is not None, "a part follows rows"
        self._incomplete = np.hstack([self._incomplete, [z, elapsed]])
        estimates = list[EstimatedRows]()
        while self._incomplete.shape[1] >= self._stretch:
            rows, self._incomplete = self._incomplete[:, : self._stretch], self._incomplete[:, self._stretch :]
            estimates += self._flow.push(rows[0].copy(), rows[1].copy())
        return estimates

    def _restart(self) -> list[EstimatedRows]:
        estimates = self.finish()
        self._finished = self._parts()
        self._flow, self._rows, self._weight = self._open_flow(), 0, 0
        return estimates


class GapDetector:
    """A detector of gaps beyond the limit.

    It sums times row by row from each restart, so that the boundaries between blocks do not change the sums.
    """

    def __init__(self, gap_limit: GapLimit) -> None:
        self._limit = gap_limit
        # Times since the first reading after a restart, in steps: of the last row, and of the last reading.
        self._now = self._last = 0.0
        self._readings = 0  # number of readings since a restart

    def starts(self, arrived: Booleans, elapsed: Floats) -> Iterator[int]:
        """Take the next B rows; yield the index of each row at which the filter restarts."""
        unusual = np.append(np.flatnonzero(~arrived | (elapsed != 1.0)), len(arrived))
        begin = 0
        while begin < len(arrived):
            usual = int(unusual[np.searchsorted(unusual, begin)])
            if (usual == len(arrived) or usual - begin > _ROWS_AT_ONCE) and self._advance_evenly(usual - begin):
                begin = usual
                continue
            rows = slice(begin, begin + _ROWS_AT_ONCE)
            start = self._first_start(arrived[rows], elapsed[rows])
            if start is not None:
                yield begin + start
                begin += start + 1
            else:
                begin += _ROWS_AT_ONCE

    def state_dict(self) -> Floats:
        """Return the state (3,): time of the last row and of the last reading, in steps, and the number of readings."""
        return np.array([self._now, self._last, float(self._readings)])

    def load_state_dict(self, state: Floats) -> None:
        """Restore the result of `state_dict`."""
        self._now, self._last, self._readings = float(state[0]), float(state[1]), int(state[2])

    def _advance_evenly(self, rows: int) -> bool:
        """Count `rows` readings one step apart, if no such step can be too long; return whether they were counted."""
        near = min(self._limit.longest, self._limit.spans * self._last) >= 1.0 and self._now.is_integer()
        in_gap = self._now != self._last  # the last row had no reading
        if in_gap or not (near and self._readings >= self._limit.readings):
            return False
        self._now += rows
        self._last, self._readings = self._now, self._readings + rows
        return True

    def _first_start(self, arrived: Booleans, elapsed: Floats) -> int | None:
        """Return the first row at which the filter restarts, or None; count the readings before this row."""
        rows = np.flatnonzero(arrived)
        times = np.append(self._now, elapsed)
        if not self._readings:  # time begins with the first reading
            times[: rows[0] + 2 if len(rows) else None] = 0.0
        times = np.cumsum(times)[1:]
        spans = np.append(self._last, times[rows[:-1]])[: len(rows)]
        gaps, before = times[rows] - spans, self._readings + np.arange(len(rows))
        determined = (before >= self._limit.readings) & (spans > 0)
        carried = np.where(determined, self._limit.spans * np.maximum(spans, _SHORTEST), np.inf)
        beyond = np.flatnonzero((gaps > np.minimum(self._limit.longest, carried)) & (before > 0))
        if len(beyond):
            self._now, self._last, self._readings = 0.0, 0.0, 1
            return int(rows[beyond[0]])
        self._now, self._readings = float(times[-1]), self._readings + len(rows)
        self._last = float(times[rows[-1]]) if len(rows) else self._last
        return None


# A causal filter of one channel with the interface of `SmoothedFlow`; it does not monitor the sensor.


class CausalFlow:
    """A causal filter of one channel, with the same estimates as a live stream.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    noise_variance : float
        R, in unit^2.
    gate : Gate, optional
        The innovation gate, which rejects spikes and follows steps; by default every reading is used.
    """

    def __init__(self, component: Component, noise_variance: float, gate: Gate | None = None) -> None:
        self._channel, self._has_rows = Channel(ChannelSettings(component, noise_variance, gate=gate)), False

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return their estimates."""
        z, elapsed = input_of(z), input_of(elapsed)
        if len(z) and not self._has_rows:
            elapsed, self._has_rows = np.concatenate([[1.0], elapsed[1:]]), True  # the first row is on time
        return [self._channel.process(z, elapsed).to_rows()]

    def finish(self) -> list[EstimatedRows]:
        """Return an empty list: no row waits."""
        return []
