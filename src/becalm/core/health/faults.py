"""Detect faults of readings as they arrive: clipped, stuck, late, repeated, after a gap.

The verdicts depend only on the channel's limits, not on a filter. The time since the first row is rounded to multiples
of 1/1024 step, so that sums are exact and the boundaries between blocks do not change the reported times.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Codes, Floats, Integers, input_of
from becalm.core.health.limits import Limits
from becalm.core.reading_verdicts import ADVICE, Verdict
from becalm.errors import ModelError, UsageError
from becalm.native.scans import LIMITS, new_limits, reduced_limits, restored, scan_faults

# Detect faults of the rows' times as rows arrive: late, repeated, after a gap.
#
# Times are rounded to multiples of 2^-20 step, so that sums are exact and the boundaries between blocks do not change
# the verdicts.

LONGEST = float(1 << 31)
"""Longest step between two rows; longer steps are reduced to this."""

_TICKS = 1 << 20  # number of ticks in a step; a tick is the unit of deviations from even time
_LATEST = 0.75  # after a gap, a row that is later than this, in steps, counts as the next row: another row was lost
_REFERENCES = (16, 32, 48)  # rows back: the median deviation of these three rows is the deviation of even time
_ON_TIME = 0.1  # a row this close to the even time of another row, in steps, is not late


def possible_steps(elapsed: Floats) -> Floats:
    """Return the steps between rows (B,), with 1 in place of NaN, and limited to the range from 0 to LONGEST."""
    if ((elapsed >= 0.0) & (elapsed <= LONGEST)).all():
        return elapsed
    steps: Floats = np.clip(np.nan_to_num(elapsed, nan=1.0), 0.0, LONGEST)
    return steps


class TimeFaults:
    """A detector of faults in the times of rows, in constant memory.

    Parameters
    ----------
    limits : Limits
        Limits that define a gap, and whether time is even.

    Attributes
    ----------
    offsets : (48,) int64 array
        Deviations of the last rows from even time, in ticks; this is the whole state.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.offsets = np.zeros(max(_REFERENCES), dtype=np.int64)

    @property
    def undisturbed(self) -> bool:
        """Return whether none of the last rows deviates from even time."""
        return not self.offsets.any()

    def write(self, codes: Codes, elapsed: Floats) -> None:
        """Write verdicts on the times of the next rows into `codes` (B,); `elapsed` (B,) has the steps before them."""
        if self._limits.even:
            codes[self._is_late(elapsed)] = Verdict.LATE
        codes[elapsed > self._limits.gap_steps] = Verdict.GAP
        codes[elapsed == 0] = Verdict.REPEATED

    def _is_late(self, elapsed: Floats) -> Booleans:
        """Return which rows deviate from even time by more than half a step, but not by whole steps.

        Lost rows before a row are not a deviation. Even time follows the median of earlier rows, so that the clock may
        run slightly fast or slow.
        """
        due = np.where(elapsed > self._limits.gap_steps, np.ceil(elapsed - _LATEST), 1.0)
        off = np.where(elapsed > 0, elapsed - due, 0.0)
        moved = np.cumsum(np.rint(off * _TICKS).astype(np.int64))
        offsets = np.append(self.offsets, self.offsets[-1] + moved)
        ahead = len(self.offsets)
        even = _middle([offsets[ahead - rows : len(offsets) - rows] for rows in _REFERENCES])
        late = (offsets[ahead:] - even) / _TICKS
        self.offsets = offsets[-ahead:].copy()
        return np.asarray((np.abs(late) > 0.5) & (np.abs(late - np.round(late)) > _ON_TIME))


def _middle(three: list[Integers]) -> Integers:
    """Return the elementwise medians of three arrays."""
    least, most = np.minimum(three[0], three[1]), np.maximum(three[0], three[1])
    return np.asarray(np.maximum(least, np.minimum(most, three[2])))


_TIME = 1 << 10  # number of units in a step, for the time since the first row


class FaultCount(NamedTuple):
    """The number of readings with a fault, and the place of the first one."""

    readings: int  # number of readings with the fault
    first_row: int  # row of the first such reading; 0 is the first row pushed
    first_step: float  # time of this row, in steps from the first row pushed


class Faults:
    """A detector of faults in the readings of one channel, in constant memory.

    Parameters
    ----------
    limits : Limits
        The limits of the healthy channel.

    Attributes
    ----------
    found : dict
        `FaultCount` of each verdict given so far, except `USED`.

    Notes
    -----
    A run of 0 of any length is not stuck if 0 is the least or the greatest reading so far, because speeds and loads
    rest there. A run of 128 or more readings of 0 is also not stuck if the plausible range is known and its middle
    third does not include 0.
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.found: dict[Verdict, FaultCount] = {}
        self._settings, self._state = limits.packed(), new_limits()
        self._rows = 0
        self._ticks = 0  # time since the first row, in units of 1/1024 step
        self._rhythm = TimeFaults(limits)

    def push(self, z: Floats, elapsed: Floats, neighbour_verdicts: Codes | None = None) -> Codes:
        """Take the next rows and return a verdict for each.

        Parameters
        ----------
        z : (B,) float array
            Readings, in unit; NaN where missing.
        elapsed : (B,) float array
            Steps since the row before; ignored for the very first row.
        neighbour_verdicts : (B,) int8 array, optional
            Verdicts of `LookAhead`, from neighbours on both sides; 0 where the reading is good.

        Returns
        -------
        (B,) int8 array
            `USED` where there is no fault. A fault of a reading takes precedence over a fault of its time.

        Raises
        ------
        UsageError
            If there are not as many steps as readings.
        """
        require_steps(elapsed, len(z))
        codes = np.zeros(len(z), dtype=np.int8)
        if not len(z):
            return codes
        even = bool((elapsed[0 if self._rows else 1 :] == 1.0).all())
        if not even or not self._rows:
            elapsed = possible_steps(elapsed).copy()
            elapsed[0] = elapsed[0] if self._rows else 1.0  # the first row is on time
        if not even or not self._rhythm.undisturbed:
            self._rhythm.write(codes, elapsed)
        fault_count = scan_faults(self._settings, self._state, input_of(z), input_of(elapsed), codes)
        if neighbour_verdicts is not None and neighbour_verdicts.any():
            worse = (neighbour_verdicts > 0) & (codes != Verdict.CLIPPED)
            codes[worse] = neighbour_verdicts[worse]
            fault_count = 1
        ticks = np.full(1, _TIME) if even else np.rint(elapsed * _TIME).astype(np.int64)
        self._count(codes if fault_count else codes[:0], np.broadcast_to(ticks, z.shape))
        return codes

    def set_history(self, rows: int, steps: float, least: float, most: float) -> None:
        """Set the number of earlier rows and steps, and the least and the greatest of their readings, in unit."""
        self._rows, self._ticks = rows, round(steps * _TIME)
        self._state["least"], self._state["most"] = least, most

    def state_dict(self) -> dict[str, Any]:
        """Return the state that later verdicts depend on, as arrays, without the faults detected so far."""
        counts, state = np.array([self._rows, self._ticks]), np.frombuffer(self._state.tobytes(), np.int8)
        return {"faults_state": state, "faults_told": counts, "faults_offsets": self._rhythm.offsets}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`; raise a ModelError if it does not fit this channel."""
        state = restored(arrays["faults_state"], LIMITS)
        if state is None:
            raise ModelError("The readings in the snapshot are not valid: pass what snapshot() returned.")
        self._state, self._rhythm.offsets[:] = state, arrays["faults_offsets"]
        self._rows, self._ticks = arrays["faults_told"].tolist()

    def comparable_state(self) -> dict[str, Any]:
        """Return only the state that later verdicts depend on, for the comparison of two states."""
        offsets = self._rhythm.offsets
        readings = np.frombuffer(reduced_limits(self._settings, self._state), np.int8)
        return {"readings": readings, "rhythm": np.asarray(offsets - offsets[-1], np.float64)}

    def _count(self, codes: Codes, ticks: Integers) -> None:
        """Count each verdict and note its first row; time begins with the very first row."""
        offset = 0 if self._rows else -int(ticks[0])
        counts = np.bincount(codes, minlength=len(Verdict))
        for code in np.flatnonzero(counts[1:]) + 1:
            verdict = Verdict(int(code))
            before = self.found.get(verdict)
            if before is None:
                at = int(np.argmax(codes == verdict))
                before = FaultCount(0, self._rows + at, (self._ticks + offset + int(ticks[: at + 1].sum())) / _TIME)
            self.found[verdict] = before._replace(readings=before.readings + int(counts[verdict]))
        self._ticks += offset + int(ticks.sum())
        self._rows += len(ticks)


def require_steps(elapsed: Floats, rows: int) -> None:
    """Raise a UsageError unless there is one step for each row; otherwise C would read beyond the last one."""
    if len(elapsed) != rows:
        raise UsageError(
            f"{len(elapsed)} elapsed steps came with {rows} rows; each row needs the steps since the one before it, as"
            f" in elapsed = np.ones({rows})."
        )


def fault_messages(found: Mapping[Verdict, FaultCount], limits: Limits, step_s: float) -> list[str]:
    """Return a message for each detected fault: its kind, how often and where first it occurred, and what to do.

    Parameters
    ----------
    found : mapping
        `Faults.found`, joined with `InnovationMonitor.found` if there is a monitor.
    limits : Limits
        The limits of the channel.
    step_s : float
        One step, in seconds.

    Returns
    -------
    list of str
        The messages, in the order of the verdicts.
    """
    return [
        f"{_description(verdict, found[verdict].readings, limits)}, first at {found[verdict].first_step * step_s:.6g} s"
        f" (row {found[verdict].first_row + 1}). {ADVICE.get(verdict, '')}".rstrip()
        for verdict in sorted(found)
    ]


def _description(verdict: Verdict, count: int, limits: Limits) -> str:
    readings = f"{count} reading{'s' if count != 1 else ''}"
    if verdict == Verdict.CLIPPED:
        return f"{readings} at a rail or beyond ({_range(limits)})"
    if verdict == Verdict.OVERRANGE:
        return f"{readings} beyond {f'{limits.largest:.3g}'.replace('e+', 'e')}"
    if verdict == Verdict.OUTLIER:
        return f"{readings} far from all readings next to {'it' if count == 1 else 'them'}"
    if verdict == Verdict.STUCK:
        return f"{readings} in runs of {limits.stuck_readings} equal ones or more"
    if verdict == Verdict.GAP:
        return f"{count} gap{'s' if count != 1 else ''} of more than {limits.gap_steps:.3g} steps"
    return f"{readings} {_PHRASES.get(verdict, verdict.name.lower())}"


def _range(limits: Limits) -> str:
    if np.isfinite(limits.rails).all():
        return f"{limits.low:.6g} to {limits.high:.6g}"
    return f"{limits.low:.6g} and less" if np.isfinite(limits.low) else f"{limits.high:.6g} and more"


_PHRASES = {
    Verdict.NONFINITE: "not finite",
    Verdict.DEAD: "of a dead channel",
    Verdict.DRIFT: "at which a drift was seen",
    Verdict.REPEATED: "at the time of the row before",
}
