"""Find where a sensor lies still, or take what a person says of it.

A sensor at rest shows its noise and nothing else, and noise has two marks that need no unit and no
datasheet: it keeps its power, and it cannot be foretold. See `becalm.identification.rest.windows`.
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
"""A shorter calm, as between two movements of a hand, is not taken for rest."""

MOST_FORETOLD = 1 / 3
"""Share of the power of block means that may be foretold at rest; see `Windows.foretold`."""

MOST_UNEVEN = 3.0
"""How many times more the power may vary at rest than by chance."""

_NEARLY_ALL = 0.95


class Stretch(NamedTuple):
    """Rows from `start` up to, not including, `stop`."""

    start: int
    stop: int


@dataclass(frozen=True)
class Stillness:
    """Where a record lies still.

    Attributes
    ----------
    stretches : tuple of Stretch
        In order and apart; empty where no rest was found.
    reason : str
        What was found, or why nothing was, in a sentence.
    """

    stretches: tuple[Stretch, ...]
    reason: str

    def mask(self, count: int) -> Booleans:
        """Return, for each of the `count` rows of the record, whether it is still."""
        still = np.zeros(count, dtype=bool)
        for start, stop in self.stretches:
            still[start:stop] = True
        return still


def find_still(recording: Recording, shortest_s: float = SHORTEST_S) -> Stillness:
    """Find where all channels of a record are still together.

    Parameters
    ----------
    recording : Recording
        The channels of one sensor, or one of them (`Recording.select`): rate, acceleration with
        gravity, strain with its offset; NaN where missing. Spikes and rounding do no harm. Channels of
        which more than a quarter is missing are not asked, if there are others.
    shortest_s : float
        Shortest rest that counts, in seconds; a *small* one trusts short calms.

    Returns
    -------
    Stillness
        Without stretches where there is no rest, or none that could be told from motion.

    Raises
    ------
    RecordingError
        If `shortest_s` is not positive.

    Notes
    -----
    What no reading tells, this cannot tell either: a gyroscope that turns evenly, or a carriage that
    rolls evenly, looks as at rest. The edges of a stretch are up to a quarter of a second inside it.
    """
    if not 0 < shortest_s < np.inf:
        raise RecordingError(f"shortest_s = {shortest_s} is no duration; give a positive number of seconds.")
    names = [name for name in recording.names if _varies(recording.channel(name))]
    if not names:
        return Stillness((), "No channel varies: without noise, rest cannot be told from a dead sensor.")
    names = [name for name in names if _mostly_there(recording.channel(name))] or names
    windows, count = Windows.of(recording.select(names)), len(recording)
    fewest = shortest_s * recording.rate_hz
    if windows is None or count < fewest:
        return Stillness((), f"The record is too short: {count} samples at {recording.rate_hz:.4g} Hz.")
    calm = windows.calm(min(max(2, int(np.ceil(fewest / windows.hop))), len(windows.sound)))
    placed = [(run, _rows(run, windows, count)) for run in runs_of(calm)]
    long = [(run, rows) for run, rows in placed if rows.stop - rows.start >= fewest]
    if not long:
        return Stillness((), f"Nowhere does the record keep its lowest noise for {shortest_s:g} s.")
    doubt = _doubt(windows.unevenness(calm), windows.foretold([run for run, _ in long]), names)
    if doubt:
        return Stillness((), doubt)
    stretches = tuple(rows for _, rows in long)
    return Stillness(stretches, _summary(stretches, recording))


def said_still(recording: Recording, spans_s: Iterable[tuple[float, float]]) -> Stillness:
    """Take the stretches that a person named.

    Parameters
    ----------
    recording : Recording
        Any channels.
    spans_s : iterable of (float, float)
        From and to, in seconds after the first sample; (0, 30) is the first half minute. Those that
        overlap are joined.

    Raises
    ------
    RecordingError
        If no span came, or one runs backwards, begins before the record or holds under 32 samples.
    """
    since_s = recording.times_s - recording.times_s[:1]
    found: list[Stretch] = []
    for begin_s, end_s in sorted(spans_s):
        if not 0 <= begin_s < end_s:
            raise RecordingError(f"{begin_s:g}:{end_s:g} is no stretch; give from:to in seconds, as 0:30.")
        start, stop = np.searchsorted(since_s, [begin_s, end_s]).tolist()
        if stop - start < FEWEST:
            raise RecordingError(
                f"From {begin_s:g} s to {end_s:g} s there are {stop - start} samples; {FEWEST} are needed. "
                f"The record lasts {recording.timebase.duration_s:g} s; give a longer stretch within it."
            )
        if found and start <= found[-1].stop:
            start, stop = found[-1].start, max(stop, found.pop().stop)
        found.append(Stretch(start, stop))
    if not found:
        raise RecordingError("No stretch was named; give from:to in seconds, as 0:30.")
    return Stillness(tuple(found), "Said to be still.")


def _varies(channel: Floats) -> bool:
    seen = channel[np.isfinite(channel)]
    return len(seen) > 0 and bool(np.any(seen != seen[0]))


def _mostly_there(channel: Floats) -> bool:
    """Tell whether a channel has readings enough to break a rest; one of a lower rate has not."""
    return bool(np.mean(~np.isfinite(channel)) <= MOST_MISSING)


def _rows(run: tuple[int, int], windows: Windows, count: int) -> Stretch:
    """Return the rows that no window outside a run of windows holds."""
    (first, last), hop = run, windows.hop
    whole = last == len(windows.sound) - 1
    return Stretch((first + 1) * hop if first else 0, count if whole else (last + 1) * hop)


def _doubt(unevenness: Floats, foretold: Floats, names: Sequence[str]) -> str:
    """Say why the quietest parts may not be at rest; nothing if they bear the marks of noise."""
    worst, smooth = int(np.argmax(unevenness)), int(np.argmax(foretold))
    if foretold[smooth] > MOST_FORETOLD:
        return (
            f"The quietest parts still move: {foretold[smooth]:.0%} of the power of {names[smooth]!r} there "
            f"can be foretold, drift aside; of noise at rest, under {MOST_FORETOLD:.0%}."
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
        return f"One even noise throughout, {share:.0%} of the record: at rest, unless it hums evenly all the time."
    rests = "1 rest" if len(stretches) == 1 else f"{len(stretches)} rests"
    return f"{rests}, {still / recording.rate_hz:.4g} s together, {still / len(recording):.0%} of the record."
