"""Clean one stretch in a task: warm up on the rows before it, write it, and return the states at its seams."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import accumulate, chain
from pathlib import Path, PurePosixPath
from time import monotonic
from typing import NamedTuple

import numpy as np

from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.recipe import Recipe
from becalm.cleaning.report import ChannelReport
from becalm.core.arrays import Floats
from becalm.core.filter.channel import History
from becalm.core.reading_verdicts import Verdict, counted
from becalm.core.snapshot_bytes import packed, unpacked
from becalm.files.chunked_cleaning import CleanChunk, answered, rows_of_chunks
from becalm.files.opening import select_table
from becalm.files.read_options import asked_by
from becalm.files.shared_source import SharedSource
from becalm.fleet.pieces import OutputFile, Pieces
from becalm.fleet.sensor_cleaning import metadata_of
from becalm.fleet.stretching.long_sensor import LongSensor, State, TaskStretch
from becalm.fleet.stretching.margins import ended, margin_of, warm_up_start

OVERLAP = 64
"""Largest number of rows that are compared where two smoothed stretches meet."""

Write = Callable[[CleanChunk], None]


class Seams(NamedTuple):
    """The values that are compared where a stretch meets its neighbours."""

    start: State | None = None  # comparable states of causal filters before the stretch
    end: State | None = None  # the same after the stretch
    left: State | None = None  # complete states after the stretch, from which the next one can run
    alive: tuple[bool, ...] = ()  # for each channel, whether the phase of its dead-sensor window does not matter
    head: Floats | None = None  # (m, 2, n) smoothed signal and sigma of its first rows, n <= OVERLAP
    beyond: Floats | None = None  # the same for the first rows after it


class StretchEstimates(NamedTuple):
    """The result of a stretch, without its estimates, which are in files."""

    stretch: TaskStretch
    seams: Seams | None = None  # None if the rows around the stretch are too few to warm up its filters
    reports: tuple[ChannelReport, ...] = ()
    counts: tuple[dict[Verdict, int], ...] = ()  # for each channel, how often each verdict was written
    pieces: tuple[OutputFile, ...] = ()
    took_s: float = 0.0


class _Work(NamedTuple):
    long: LongSensor
    stretch: TaskStretch
    recipe: Recipe
    source: SharedSource
    rows: int  # rows of a chunk

    @property
    def is_first(self) -> bool:
        return self.stretch.first == 0

    @property
    def is_last(self) -> bool:
        return self.stretch.stop == self.long.known.rows


def run_stretch(long: LongSensor, stretch: TaskStretch) -> StretchEstimates:
    """Clean a stretch of a long sensor.

    Parameters
    ----------
    long : LongSensor
        The sensor.
    stretch : TaskStretch
        The rows, and perhaps the filters' state after the rows before them.

    Raises
    ------
    BecalmError
        If the sensor cannot be read, or its estimates cannot be written.
    """
    began = monotonic()
    recipe = Recipe.from_toml(long.recipe)
    source = _reopened(long, recipe)
    work = _Work(long, stretch, recipe, source, rows_of_chunks(source, len(recipe.channel)))
    counts = [Counter[Verdict]() for _ in recipe.channel]
    pieces = pieces_of(long.files, stretch)
    try:
        with Pieces(Path(long.staged), pieces, metadata_of(recipe)) as out:

            def write(answer: CleanChunk) -> None:
                out.write(answer.output(recipe, verdicts=True))
                for own, estimates in zip(counts, answer.estimates, strict=True):
                    own.update(counted(estimates.verdicts))

            seams, reports = (_causal if recipe.mode == "causal" else _smoothed)(work, write)
    finally:
        source.close()
    return StretchEstimates(
        stretch, seams, reports, tuple(dict(own) for own in counts), tuple(pieces), monotonic() - began
    )


def pieces_of(files: tuple[OutputFile, ...], stretch: TaskStretch) -> list[OutputFile]:
    """Return the files that a stretch writes: one for each input file, or part of an input file, with rows of it."""
    pieces, begins = list[OutputFile](), accumulate((file.rows for file in files), initial=0)
    for (name, rows), begin in zip(files, begins, strict=False):
        first, stop = max(begin, stretch.first), min(begin + rows, stretch.stop)
        if first < stop:
            path = PurePosixPath(name)
            whole = stop - first == rows
            own = name if whole else str(path.with_name(f"{path.stem}.{stretch.number:06d}{path.suffix}"))
            pieces.append(OutputFile(own, stop - first))
    return pieces


def _reopened(long: LongSensor, recipe: Recipe) -> SharedSource:
    job, sensor = long.job, long.sensor
    options = asked_by(recipe, job.another)
    raw, _ = select_table(job.input_of(sensor), job.tables_of(sensor), options)
    return SharedSource(raw, long.known)


def _causal(work: _Work, write: Write) -> tuple[Seams | None, tuple[ChannelReport, ...]]:
    start, left = None, None
    if not work.is_first:
        with Cleaner(work.recipe, work.source.clock.step_s) as before:
            if not _warmed_up(work, before):
                return None, ()
            start, left = before.comparable_state(), before.saved()
        if start is None or left is None:
            return None, ()
    with Cleaner(work.recipe, work.source.clock.step_s) as own:
        if left is not None:
            own.restore(left)
        _, first, stop, _ = work.stretch
        for answer in answered(own, work.recipe, work.source.chunks(first, stop, work.rows), ends=work.is_last):
            write(answer)
        seams = Seams(_packed(start), _packed(own.comparable_state()), _packed(own.saved()), tuple(own.surely_alive()))
        return seams, own.reports()


def _warmed_up(work: _Work, cleaner: Cleaner) -> bool:
    """Bring filters into their state before a stretch; return whether the rows before it are enough."""
    if work.stretch.state is not None:
        cleaner.restore([unpacked(blob) for blob in work.stretch.state])
        return True
    margin, first = margin_of(work.recipe, work.source.clock.step_s), work.stretch.first
    begin = warm_up_start(work.source, work.recipe, margin, first, first)
    if begin is None:
        return False
    if begin:
        cleaner.set_history(_histories(work, begin))
    for _ in answered(cleaner, work.recipe, work.source.chunks(begin, first, work.rows), ends=False):
        pass
    return True


def _smoothed(work: _Work, write: Write) -> tuple[Seams | None, tuple[ChannelReport, ...]]:
    margin, (_, first, stop, _) = margin_of(work.recipe, work.source.clock.step_s), work.stretch
    most = 2 * (stop - first)
    begin = warm_up_start(work.source, work.recipe, margin, first, most)
    end = ended(work.source, work.recipe, margin, (stop, work.long.known.rows), most)
    if begin is None or end is None:
        return None, ()
    heads, tails = list[CleanChunk](), list[CleanChunk]()
    with Cleaner(work.recipe, work.source.clock.step_s) as own:
        if begin:
            own.set_history(_histories(work, begin))
        spans = (begin, first), (first, stop), (stop, end)
        chunks = chain.from_iterable(work.source.chunks(*span, work.rows) for span in spans if span[0] < span[1])
        for answer in answered(own, work.recipe, chunks):
            if first <= answer.chunk.first_row < stop:
                write(answer)
                heads += [answer] * (not heads)
            elif answer.chunk.first_row >= stop:
                tails += [answer] * (not tails)
        return Seams(head=_overlap(heads), beyond=_overlap(tails)), own.reports()


def _overlap(answers: list[CleanChunk]) -> Floats | None:
    """Return signal and sigma of the first rows of each channel, (m, 2, n); None if there are no rows."""
    if not answers:
        return None
    return np.array([[one.signal[:OVERLAP], one.sigma[:OVERLAP]] for one in answers[0].estimates])


def _histories(work: _Work, begin: int) -> list[History]:
    """Return each channel's history before the row at which the warm-up of a stretch begins."""
    earlier = [one for one in work.long.extremes if one.row <= begin]
    steps = work.source.steps_before(begin)
    nothing = (np.inf,) * len(work.recipe.channel)
    least = earlier[-1].least if earlier else nothing
    most = earlier[-1].most if earlier else tuple(-one for one in nothing)
    return [
        History(reading, begin, begin, steps, *between)
        for reading, *between in zip(work.long.first, least, most, strict=True)
    ]


def _packed(arrays: list[dict[str, Floats]] | None) -> State | None:
    return None if arrays is None else tuple(packed(own) for own in arrays)
