"""A channel that starts anew after gaps so long that float64 cannot hold what was read before them: see `gap_limit`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from becalm.core.arrays import BLOCK, Booleans, Floats
from becalm.core.filter.gap_limit import GapLimit
from becalm.core.rows import EstimatedRows
from becalm.core.verdict import BEYOND_ANY_SENSOR
from becalm.core.verdict import judge as judge_readings

_LOOK = 4096  # rows
_SHORTEST = 1e-300  # steps: no time at all, of which inf times is no number


class PartialFlow(Protocol):
    """What filters or smooths one part of a record, such as `ImmFlow`."""

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of its measurements so far."""
        ...

    @property
    def settled_row(self) -> int | None:
        """The first of its rows with a settled gain; None if there is none."""
        ...

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows; return what can be told for good."""
        ...

    def finish(self) -> list[EstimatedRows]:
        """Say that no more rows will come; return the rest."""
        ...

    def saved(self) -> dict[str, Any] | None:
        """Return what later rows depend on, as arrays; None where rows wait."""
        ...

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        ...

    def tell_from(self, reading: float) -> None:
        """Tell all readings from one that came first, before those that will be pushed."""
        ...


class _Part(NamedTuple):
    """What is known of one part."""

    rows: int
    weight: int  # rows from the first reading on
    log_likelihood: float
    settled_row: int | None
    shares: dict[str, float]  # of each mode of a bank


class RestartingFlow:
    """A filter, or a smoother, of one channel that starts anew after a gap beyond its limit.

    Without one its flow sees every push as it is. After one, pushes are joined into stretches as long as the
    first push, counted from the new start, so that the rest has the bits of a record of its own.

    Parameters
    ----------
    open_flow : callable
        Opens what filters one part.
    gap_limit : GapLimit
        Which gaps it bridges; with a *small* one the channel starts anew more often.
    largest : float
        Magnitude beyond which a value is no reading, as the flow itself takes it, in unit.
    """

    def __init__(
        self, open_flow: Callable[[], PartialFlow], gap_limit: GapLimit, largest: float = BEYOND_ANY_SENSOR
    ) -> None:
        self._open_flow, self._largest = open_flow, largest
        self._gaps = Gaps(gap_limit)
        self._flow = open_flow()
        self._finished: list[_Part] = []
        self._rows = self._weight = 0  # of the part that is open
        self._stretch: int | None = None
        self._few = np.empty((2, 0))  # readings, and steps before them, that make no stretch yet

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return what can be told for good."""
        if self._stretch is None and len(z):
            self._stretch = max(BLOCK, len(z) // BLOCK * BLOCK)
        arrived = np.isfinite(judge_readings(z, self._largest).readings)
        told, begin = list[EstimatedRows](), 0
        for row in self._gaps.starts(arrived, elapsed):
            if row > begin:
                told += self._take(z[begin:row], elapsed[begin:row], arrived[begin:row])
            told += self._start_anew()
            begin = row
        return told + self._take(z[begin:], elapsed[begin:], arrived[begin:])

    def finish(self) -> list[EstimatedRows]:
        """Say that no more rows will come; return what was waiting for them."""
        few, self._few = self._few, np.empty((2, 0))
        told = self._flow.push(few[0], few[1]) if few.shape[1] else []
        return told + self._flow.finish()

    def saved(self) -> dict[str, Any] | None:
        """Return what later rows depend on, as arrays; None where rows wait."""
        held = None if self._few.shape[1] else self._flow.saved()
        if held is None:
            return None
        told = np.array([self._stretch or 0, len(self._finished)])
        return held | {"parted_gaps": self._gaps.saved(), "parted_told": told}

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        stretch, finished = arrays["parted_told"].tolist()
        self._stretch, self._finished = stretch or None, [_Part(0, 0, 0.0, None, {})] * finished
        self._gaps.restore(arrays["parted_gaps"])
        self._flow.restore(arrays)

    def tell_from(self, reading: float) -> None:
        """Tell all readings from one that came first, before those that will be pushed."""
        self._flow.tell_from(reading)

    def begin_after(self, reading: float, readings: int, steps: float) -> None:
        """Say what went before: the first reading of all, how many came, and how many steps went by."""
        self.tell_from(reading)
        self._gaps.restore(np.array([steps, steps, float(readings)]))

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of all measurements so far but the first of each part."""
        return sum(part.log_likelihood for part in self._parts())

    @property
    def settled_row(self) -> int | None:
        """The first row with a settled gain."""
        begin = 0
        for part in self._parts():
            if part.settled_row is not None:
                return begin + part.settled_row
            begin += part.rows
        return None

    @property
    def shares(self) -> dict[str, float]:
        """What share of the rows so far each mode of a bank was in force; nothing where there is no bank."""
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
        unread = int(arrived.argmax()) if arrived.any() else len(z)
        self._weight += len(z) if self._weight else len(z) - unread
        if not self._finished:
            return self._flow.push(z, elapsed)
        assert self._stretch is not None, "a part follows rows"
        self._few = np.hstack([self._few, [z, elapsed]])
        told = list[EstimatedRows]()
        while self._few.shape[1] >= self._stretch:
            rows, self._few = self._few[:, : self._stretch], self._few[:, self._stretch :]
            told += self._flow.push(rows[0].copy(), rows[1].copy())
        return told

    def _start_anew(self) -> list[EstimatedRows]:
        told = self.finish()
        self._finished = self._parts()
        self._flow, self._rows, self._weight = self._open_flow(), 0, 0
        return told


class Gaps:
    """Finds the readings before which a gap is beyond the limit.

    Times are summed row by row from each start, so that they are the same wherever rows are cut.
    """

    def __init__(self, gap_limit: GapLimit) -> None:
        self._limit = gap_limit
        self._now = self._last = 0.0  # steps from the first reading since the start to the last row, and last reading
        self._readings = 0

    def starts(self, arrived: Booleans, elapsed: Floats) -> Iterator[int]:
        """Give the rows, of the next (B,), that start anew."""
        unusual = np.append(np.flatnonzero(~arrived | (elapsed != 1.0)), len(arrived))
        begin = 0
        while begin < len(arrived):
            usual = int(unusual[np.searchsorted(unusual, begin)])
            if (usual == len(arrived) or usual - begin > _LOOK) and self._bridges(usual - begin):
                begin = usual
                continue
            rows = slice(begin, begin + _LOOK)
            found = self._first_start(arrived[rows], elapsed[rows])
            if found is not None:
                yield begin + found
                begin += found + 1
            else:
                begin += _LOOK

    def saved(self) -> Floats:
        """Return what moves."""
        return np.array([self._now, self._last, float(self._readings)])

    def restore(self, moved: Floats) -> None:
        """Take over what `saved` returned."""
        self._now, self._last, self._readings = float(moved[0]), float(moved[1]), int(moved[2])

    def _bridges(self, rows: int) -> bool:
        """Take rows of which none is missing in even time at once, as mostly; say whether they were taken."""
        near = min(self._limit.longest, self._limit.spans * self._last) >= 1.0 and self._now.is_integer()
        waits = self._now != self._last  # rows without a reading came last
        if waits or not (near and self._readings >= self._limit.readings):
            return False
        self._now += rows
        self._last, self._readings = self._now, self._readings + rows
        return True

    def _first_start(self, arrived: Booleans, elapsed: Floats) -> int | None:
        """Return the first row that starts anew, and count the readings up to it."""
        rows = np.flatnonzero(arrived)
        times = np.append(self._now, elapsed)
        if not self._readings:  # time begins with the first reading
            times[: rows[0] + 2 if len(rows) else None] = 0.0
        times = np.cumsum(times)[1:]
        spans = np.append(self._last, times[rows[:-1]])[: len(rows)]
        gaps, before = times[rows] - spans, self._readings + np.arange(len(rows))
        told = (before >= self._limit.readings) & (spans > 0)
        carried = np.where(told, self._limit.spans * np.maximum(spans, _SHORTEST), np.inf)
        beyond = np.flatnonzero((gaps > np.minimum(self._limit.longest, carried)) & (before > 0))
        if len(beyond):
            self._now, self._last, self._readings = 0.0, 0.0, 1
            return int(rows[beyond[0]])
        self._now, self._readings = float(times[-1]), self._readings + len(rows)
        self._last = float(times[rows[-1]]) if len(rows) else self._last
        return None
