"""What is wrong with readings themselves, told as they come: clipped, stuck, late, repeated, after a gap.

No filter is asked, only the limits of the channel. Time is counted in whole parts of a step, so that sums are
exact, and the verdicts those of the whole record wherever it is cut.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Codes, Floats, Integers
from becalm.core.limits import Limits, is_new
from becalm.core.verdict import ADVICE, Verdict

_TICKS = 1 << 20  # of a step, for what a row is off its time
_TIME = 1 << 10  # of a step, for the time since the first row
_LONGEST = float(1 << 31)  # steps between two rows; beyond, time is not told
_LATEST = 0.75  # of a step after it was due: a row that comes later is the next one, and the one due was lost
_REFERENCES = (16, 32, 48)  # rows before, whose median is the even time
_ON_TIME = 0.1  # steps off a whole one: there a row stands in a place of even time, if not its own


class Found(NamedTuple):
    """How often a fault was found."""

    readings: int
    first_row: int  # 0 is the first row pushed
    first_step: float  # steps from the first row to there


class Faults:
    """Watches the readings of one channel, in constant memory.

    Parameters
    ----------
    limits : Limits
        What the channel keeps to.

    Attributes
    ----------
    found : dict
        `Found` of each verdict but `USED` that was given so far.

    Notes
    -----
    A reading of 0 that is the least, or the greatest, so far is not stuck however long it is held: speeds
    and loads rest there.
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.found: dict[Verdict, Found] = {}
        self._rows = 0
        self._ticks = 0  # from the first row
        self._held, self._run = np.nan, 0  # the last reading, and how often in a row
        self._least, self._most = np.inf, -np.inf  # of the readings so far
        self._offsets = np.zeros(max(_REFERENCES), dtype=np.int64)  # of the rows before, in ticks off even time

    @property
    def stuck_delay(self) -> int | None:
        """How many readings a channel is stuck before it is told, itself among them; None: never."""
        return self.limits.stuck_readings

    def push(self, z: Floats, elapsed: Floats) -> Codes:
        """Take the next rows and tell what is wrong with each.

        Parameters
        ----------
        z : (B,) float array
            Readings, in unit; NaN where missing.
        elapsed : (B,) float array
            Steps since the row before; not looked at for the first row of all.

        Returns
        -------
        (B,) int8 array
            `USED` where nothing is. What is wrong with the reading goes before what is wrong with its time.
        """
        if not len(z):
            return np.empty(0, dtype=np.int8)
        elapsed = np.clip(np.nan_to_num(elapsed, nan=1.0), 0.0, _LONGEST)
        if not self._rows:
            elapsed[0] = 1.0  # it came when it was due
        largest = self.limits.largest
        possible = -largest <= z.min() <= z.max() <= largest
        codes = self._timing(elapsed)
        whole = possible and codes is None  # of which each reading says something new
        if self.limits.stuck_readings is not None:
            new = None if whole else is_new(z, elapsed, first=False, largest=largest)
            codes = _marked(codes, Verdict.STUCK, self._is_stuck(z, new, self.limits.stuck_readings))
        codes = _marked(codes, Verdict.CLIPPED, self.limits.rails.reached(z))
        if not possible:
            size = np.abs(z)
            codes = _marked(codes, Verdict.OVERRANGE, ~(size <= largest))
            codes = _marked(codes, Verdict.NONFINITE, np.isinf(z))
            codes = _marked(codes, Verdict.MISSING, np.isnan(z))
        self._count(codes, elapsed)
        return np.zeros(len(z), dtype=np.int8) if codes is None else codes

    def _is_stuck(self, z: Floats, new: Booleans | None, fewest: int) -> Booleans:
        """Tell which readings end a run of `fewest` equal ones or more; None of `new` is all of them."""
        stuck = np.zeros(len(z), dtype=np.bool_)
        readings = z if new is None else z[new]
        if not len(readings):
            return stuck
        rests = self._rests(readings)
        starts = np.flatnonzero(readings[1:] != readings[:-1]) + 1  # of all runs but the first
        before = self._run if readings[0] == self._held else 0
        lengths = np.diff(starts, prepend=-before, append=len(readings))
        self._held, self._run = float(readings[-1]), int(lengths[-1])
        found = np.zeros(len(readings), dtype=np.bool_)
        for run in np.flatnonzero(lengths >= fewest):
            first = (starts[run - 1] if run else -before) + fewest - 1
            found[max(first, 0) : starts[run] if run < len(starts) else None] = True
        stuck[slice(None) if new is None else new] = found & ~rests
        return stuck

    def _rests(self, readings: Floats) -> Booleans:
        """Tell which readings (B,) are 0 where that was an end of all before: there speeds and loads rest."""
        least, most = min(self._least, float(readings.min())), max(self._most, float(readings.max()))
        before, self._least, self._most = (self._least, self._most), least, most
        if least > 0 or most < 0 or max(before[0], -before[1]) < 0:
            return np.zeros(len(readings), dtype=np.bool_)
        lower = np.minimum(np.minimum.accumulate(readings), before[0])
        upper = np.maximum(np.maximum.accumulate(readings), before[1])
        return np.asarray((readings == 0) & ((lower == 0) | (upper == 0)))

    def _timing(self, elapsed: Floats) -> Codes | None:
        """Tell what is wrong with the time of each row; None where nothing can be."""
        if elapsed.min() == elapsed.max() == 1.0 and not self._offsets.any():
            return None
        codes = np.zeros(len(elapsed), dtype=np.int8)
        if self.limits.even:
            codes[self._is_late(elapsed)] = Verdict.LATE
        codes[elapsed > self.limits.gap_steps] = Verdict.GAP
        codes[elapsed == 0] = Verdict.REPEATED
        return codes

    def _is_late(self, elapsed: Floats) -> Booleans:
        """Tell which rows are off their even time by more than half a step, rows that were lost before left aside.

        Even time goes on from where most of the rows before had it, so that a clock may run a little fast or slow.
        """
        due = np.where(elapsed > self.limits.gap_steps, np.ceil(elapsed - _LATEST), 1.0)
        off = np.where(elapsed > 0, elapsed - due, 0.0)
        moved = np.cumsum(np.rint(off * _TICKS).astype(np.int64))
        offsets = np.append(self._offsets, self._offsets[-1] + moved)
        ahead = len(self._offsets)
        even = _middle([offsets[ahead - rows : len(offsets) - rows] for rows in _REFERENCES])
        late = (offsets[ahead:] - even) / _TICKS
        self._offsets = offsets[-ahead:].copy()
        return np.asarray((np.abs(late) > 0.5) & (np.abs(late - np.round(late)) > _ON_TIME))

    def _count(self, codes: Codes | None, elapsed: Floats) -> None:
        """Remember how often each verdict was given, and where first."""
        ticks = np.rint(elapsed * _TIME).astype(np.int64)
        if not self._rows:
            ticks[0] = 0
        counts = np.zeros(len(Verdict)) if codes is None else np.bincount(codes, minlength=len(Verdict))
        for code in np.flatnonzero(counts[1:]) + 1:
            verdict = Verdict(int(code))
            before = self.found.get(verdict)
            if before is None:
                at = int(np.argmax(codes == verdict))
                first = (self._ticks + int(ticks[: at + 1].sum())) / _TIME
                before = Found(0, self._rows + at, first)
            self.found[verdict] = before._replace(readings=before.readings + int(counts[verdict]))
        self._rows += len(elapsed)
        self._ticks += int(ticks.sum())


def _marked(codes: Codes | None, verdict: Verdict, which: Booleans) -> Codes | None:
    """Write a verdict over others, where it is given at all."""
    if not which.any():
        return codes
    codes = np.zeros(len(which), dtype=np.int8) if codes is None else codes
    codes[which] = verdict
    return codes


def said(found: Mapping[Verdict, Found], limits: Limits, step_s: float) -> list[str]:
    """Say what was found, where first, and what to do about it: a sentence or two for each verdict.

    Parameters
    ----------
    found : mapping
        As `Faults.found`, with `InnovationMonitor.found` joined in where there is one.
    limits : Limits
        What the channel was held against.
    step_s : float
        One step, in seconds.

    Returns
    -------
    list of str
        In the order of the verdicts.
    """
    return [
        f"{_what(verdict, found[verdict].readings, limits)}, first at {found[verdict].first_step * step_s:.6g} s"
        f" (row {found[verdict].first_row + 1}). {ADVICE.get(verdict, '')}".rstrip()
        for verdict in sorted(found)
    ]


def _what(verdict: Verdict, count: int, limits: Limits) -> str:
    readings = f"{count} reading{'s' if count != 1 else ''}"
    if verdict == Verdict.CLIPPED:
        return f"{readings} at a rail or beyond ({_range(limits)})"
    if verdict == Verdict.OVERRANGE:
        return f"{readings} beyond {f'{limits.largest:.3g}'.replace('e+', 'e')}"
    if verdict == Verdict.STUCK:
        return f"{readings} in runs of {limits.stuck_readings} equal ones or more"
    if verdict == Verdict.GAP:
        return f"{count} gap{'s' if count != 1 else ''} of more than {limits.gap_steps:.3g} steps"
    return f"{readings} {_WORDS.get(verdict, verdict.name.lower())}"


def _range(limits: Limits) -> str:
    if np.isfinite(limits.rails).all():
        return f"{limits.low:.6g} to {limits.high:.6g}"
    return f"{limits.low:.6g} and less" if np.isfinite(limits.low) else f"{limits.high:.6g} and more"


_WORDS = {
    Verdict.NONFINITE: "not finite",
    Verdict.DEAD: "of a dead channel",
    Verdict.DRIFT: "at which a drift was seen",
    Verdict.REPEATED: "at the time of the row before",
}


def _middle(three: list[Integers]) -> Integers:
    """Return the medians of three rows of numbers."""
    least, most = np.minimum(three[0], three[1]), np.maximum(three[0], three[1])
    return np.asarray(np.maximum(least, np.minimum(most, three[2])))
