"""Find where a sensor is at rest, or take rests that a person names.

A sensor at rest shows only its noise, and noise has two marks that need no unit and no datasheet: its power is
constant, and it cannot be predicted. See `becalm.identification.rest.windows`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.core.recording import Recording
from becalm.errors import RecordingError
from becalm.identification.rest.windows import FEWEST, MOST_MISSING, Windows, runs_of

SHORTEST_S = 1.0
"""Shortest rest, in seconds; a shorter calm, such as between two movements of a hand, does not count."""

MOST_PREDICTABLE = 1 / 3
"""Largest predictable share of the power of block means at rest; see `Windows.foretold`."""

MOST_UNEVEN = 3.0
"""Largest variation of the power at rest, as a multiple of that by chance."""

_NEARLY_ALL = 0.95


class Stretch(NamedTuple):
    """A range of rows, from `start` up to, not including, `stop`."""

    start: int
    stop: int


@dataclass(frozen=True)
class Stillness:
    """The rests of a record.

    Attributes
    ----------
    stretches : tuple of Stretch
        The rests, in order and without overlap; empty if there is none.
    reason : str
        A sentence on what was found, or why nothing was.
    """

    stretches: tuple[Stretch, ...]
    reason: str

    def mask(self, count: int) -> Booleans:
        """Return a mask of the `count` rows of the record, True at rest."""
        still = np.zeros(count, dtype=bool)
        for start, stop in self.stretches:
            still[start:stop] = True
        return still


def detect_rests(recording: Recording, shortest_s: float = SHORTEST_S) -> Stillness:
    """Find where all channels of a record are at rest together.

    Parameters
    ----------
    recording : Recording
        The channels of one sensor, or one of them (`Recording.select`): rate, acceleration with gravity, strain with
        its offset; NaN where missing. Spikes and rounding do no harm. A channel with more than a quarter of its
        readings missing is ignored, if there are others.
    shortest_s : float
        Duration of the shortest rest, in seconds; a *small* one trusts short calms.

    Returns
    -------
    Stillness
        The rests; none if there is no rest, or it cannot be distinguished from motion.

    Raises
    ------
    RecordingError
        If `shortest_s` is not positive.

    Notes
    -----
    A sensor in uniform motion cannot be distinguished from one at rest: a gyroscope that turns evenly, or a carriage
    that rolls evenly. The edges of a stretch are up to a quarter of a second inside the rest.
    """
    if not 0 < shortest_s < np.inf:
        raise RecordingError(f"shortest_s = {shortest_s} is not a duration; give a positive number of seconds.")
    names = [name for name in recording.names if _varies(recording.channel(name))]
    if not names:
        return Stillness((), "No channel varies: without noise, rest cannot be distinguished from a dead sensor.")
    names = [name for name in names if _mostly_there(recording.channel(name))] or names
    windows, count = Windows.of(recording.select(names)), len(recording)
    fewest = shortest_s * recording.rate_hz
    if windows is None or count < fewest:
        return Stillness((), f"The record is too short: {count} samples at {recording.rate_hz:.4g} Hz.")
    calm = windows.calm(min(max(2, int(np.ceil(fewest / windows.hop))), len(windows.sound)))
    placed = [(run, _rows(run, windows, count)) for run in runs_of(calm)]
    long = [(run, rows) for run, rows in placed if rows.stop - rows.start >= fewest]
    if not long:
        return Stillness((), f"The record does not keep its lowest noise for {shortest_s:g} s anywhere.")
    doubt = _doubt(windows.unevenness(calm), windows.foretold([run for run, _ in long]), names)
    if doubt:
        return Stillness((), doubt)
    stretches = tuple(rows for _, rows in long)
    return Stillness(stretches, _summary(stretches, recording))


def named_rests(recording: Recording, spans_s: Iterable[tuple[float, float]]) -> Stillness:
    """Return the stretches that a person named.

    Parameters
    ----------
    recording : Recording
        Any channels.
    spans_s : iterable of (float, float)
        Start and end of each, in seconds after the first sample; (0, 30) is the first half minute. Overlapping spans
        are joined.

    Raises
    ------
    RecordingError
        If there is no span, or one is reversed, starts before the record or holds under 32 samples.
    """
    since_s = recording.times_s - recording.times_s[:1]
    stretches: list[Stretch] = []
    for begin_s, end_s in sorted(spans_s):
        if not 0 <= begin_s < end_s:
            raise RecordingError(f"{begin_s:g}:{end_s:g} is not a stretch; give from:to in seconds, as 0:30.")
        start, stop = np.searchsorted(since_s, [begin_s, end_s]).tolist()
        if stop - start < FEWEST:
            raise RecordingError(
                f"From {begin_s:g} s to {end_s:g} s there are {stop - start} samples; {FEWEST} are needed. "
                f"The record lasts {recording.timebase.duration_s:g} s; give a longer stretch within it."
            )
        if stretches and start <= stretches[-1].stop:
            start, stop = stretches[-1].start, max(stop, stretches.pop().stop)
        stretches.append(Stretch(start, stop))
    if not stretches:
        raise RecordingError("No stretch was named; give from:to in seconds, as 0:30.")
    return Stillness(tuple(stretches), "Said to be still.")


def _varies(channel: Floats) -> bool:
    seen = channel[np.isfinite(channel)]
    return len(seen) > 0 and bool(np.any(seen != seen[0]))


def _mostly_there(channel: Floats) -> bool:
    """Return whether a channel has enough readings to interrupt a rest; one of a lower rate has not."""
    return bool(np.mean(~np.isfinite(channel)) <= MOST_MISSING)


def _rows(run: tuple[int, int], windows: Windows, count: int) -> Stretch:
    """Return the rows that belong only to windows of a run."""
    (first, last), hop = run, windows.hop
    whole = last == len(windows.sound) - 1
    return Stretch((first + 1) * hop if first else 0, count if whole else (last + 1) * hop)


def _doubt(unevenness: Floats, predictable: Floats, names: Sequence[str]) -> str:
    """Return why the quietest parts may not be at rest; "" if they have the marks of noise."""
    worst, smooth = int(np.argmax(unevenness)), int(np.argmax(predictable))
    if predictable[smooth] > MOST_PREDICTABLE:
        return (
            f"The quietest parts still move: {predictable[smooth]:.0%} of the power of {names[smooth]!r} there "
            f"can be predicted, apart from drift; for noise at rest it is under {MOST_PREDICTABLE:.0%}."
        )
    if unevenness[worst] > MOST_UNEVEN:
        return (
            f"The quietest parts are not evenly quiet: the power of {names[worst]!r} there varies "
            f"{unevenness[worst]:.1f} times as much as that of noise at rest."
        )
    return ""


def _summary(stretches: Sequence[Stretch], recording: Recording) -> str:
    still = sum(stop - start for start, stop in stretches)
    if still > _NEARLY_ALL * len(recording):
        share = still / len(recording)
        return f"The noise is even throughout, {share:.0%} of the record: at rest, unless a steady hum is part of it."
    rests = "1 rest" if len(stretches) == 1 else f"{len(stretches)} rests"
    return f"{rests}, {still / recording.rate_hz:.4g} s together, {still / len(recording):.0%} of the record."
