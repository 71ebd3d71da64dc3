"""Clean one stretch in a task: warm up on the rows before it, write its estimates, and return the values to compare."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import accumulate, chain
from pathlib import Path, PurePosixPath
from time import monotonic
from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels.report import ChannelReport
from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.arrays import Floats
from becalm.core.filter.channel import History
from becalm.core.reading_verdicts import Verdict, counted
from becalm.core.snapshot_bytes import packed, unpacked
from becalm.files.inputs.opening import select_table
from becalm.files.inputs.shared_source import SharedSource
from becalm.files.outputs.chunked_cleaning import CleanChunk, iter_clean_chunks, rows_of_chunks
from becalm.files.read_options import options_of_recipe
from becalm.fleet.pieces import OutputFile, Pieces
from becalm.fleet.sensor_cleaning import metadata_of
from becalm.fleet.stretching.long_sensor import LongSensor, State, TaskStretch
from becalm.fleet.stretching.margins import margin_end, margin_of, warm_up_start

OVERLAP = 64
"""Largest number of rows that are compared at the seam of two smoothed stretches."""

Write = Callable[[CleanChunk], None]


class Seams(NamedTuple):
    """The values of a stretch that are compared with those of the stretches before and after it."""

    start: State | None = None  # causal filters: their comparable states before the stretch
    end: State | None = None  # causal filters: their comparable states after the stretch
    complete_end: State | None = None  # complete states after the stretch, from which the next stretch can run
    alive: tuple[bool, ...] = ()  # for each channel, whether to ignore the phase of its dead-sensor window
    first_rows: Floats | None = None  # smoothers: (m, 2, n) signal and sigma of the stretch's first rows, n <= OVERLAP
    next_rows: Floats | None = None  # smoothers: the same for the first rows after the stretch


class StretchEstimates(NamedTuple):
    """The result of a stretch; its estimates are in files."""

    stretch: TaskStretch
    seams: Seams | None = None  # None if there are too few rows around the stretch to warm up the filters
    reports: tuple[ChannelReport, ...] = ()
    counts: tuple[dict[Verdict, int], ...] = ()  # for each channel, the number of rows with each verdict
    pieces: tuple[OutputFile, ...] = ()  # the files that were written
    took_s: float = 0.0


class _Work(NamedTuple):
    """A stretch that is being cleaned."""

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
        return self.stretch.stop == self.long.parsed_source.rows


def run_stretch(long: LongSensor, stretch: TaskStretch) -> StretchEstimates:
    """Clean a stretch of a long sensor.

    Parameters
    ----------
    long : LongSensor
        The sensor.
    stretch : TaskStretch
        The rows to clean, and the filters' state before them, if known.

    Raises
    ------
    BecalmError
        If the sensor cannot be read, or its estimates cannot be written.
    """
    began = monotonic()
    recipe = Recipe.from_toml(long.recipe)
    source = _reopen(long, recipe)
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
    """Return the files that a stretch writes: one for each input file with rows of the stretch."""
    pieces, begins = list[OutputFile](), accumulate((file.rows for file in files), initial=0)
    for (name, rows), begin in zip(files, begins, strict=False):
        first, stop = max(begin, stretch.first), min(begin + rows, stretch.stop)
        if first < stop:
            path = PurePosixPath(name)
            whole = stop - first == rows
            own = name if whole else str(path.with_name(f"{path.stem}.{stretch.number:06d}{path.suffix}"))
            pieces.append(OutputFile(own, stop - first))
    return pieces


def _reopen(long: LongSensor, recipe: Recipe) -> SharedSource:
    job, sensor = long.job, long.sensor
    options = options_of_recipe(recipe, job.tune_command)
    raw, _ = select_table(job.input_of(sensor), job.tables_of(sensor), options)
    return SharedSource(raw, long.parsed_source)


def _causal(work: _Work, write: Write) -> tuple[Seams | None, tuple[ChannelReport, ...]]:
    start, left = None, None
    if not work.is_first:
        with Cleaner(work.recipe, work.source.clock.step_s) as before:
            if not _warm_up(work, before):
                return None, ()
            start, left = before.comparable_state(), before.state_dict()
        if start is None or left is None:
            return None, ()
    with Cleaner(work.recipe, work.source.clock.step_s) as own:
        if left is not None:
            own.load_state_dict(left)
        _, first, stop, _ = work.stretch
        chunks = work.source.chunks(first, stop, work.rows)
        for answer in iter_clean_chunks(own, work.recipe, chunks, ends=work.is_last):
            write(answer)
        seams = Seams(_pack(start), _pack(own.comparable_state()), _pack(own.state_dict()), tuple(own.surely_alive()))
        return seams, own.reports()


def _warm_up(work: _Work, cleaner: Cleaner) -> bool:
    """Set filters to their state before a stretch; return False if there are too few rows before it for a warm-up."""
    if work.stretch.state is not None:
        cleaner.load_state_dict([unpacked(blob) for blob in work.stretch.state])
        return True
    margin, first = margin_of(work.recipe, work.source.clock.step_s), work.stretch.first
    begin = warm_up_start(work.source, work.recipe, margin, first, first)
    if begin is None:
        return False
    if begin:
        cleaner.set_history(_histories(work, begin))
    for _ in iter_clean_chunks(cleaner, work.recipe, work.source.chunks(begin, first, work.rows), ends=False):
        pass
    return True


def _smoothed(work: _Work, write: Write) -> tuple[Seams | None, tuple[ChannelReport, ...]]:
    margin, (_, first, stop, _) = margin_of(work.recipe, work.source.clock.step_s), work.stretch
    most = 2 * (stop - first)
    begin = warm_up_start(work.source, work.recipe, margin, first, most)
    end = margin_end(work.source, work.recipe, margin, (stop, work.long.parsed_source.rows), most)
    if begin is None or end is None:
        return None, ()
    heads, tails = list[CleanChunk](), list[CleanChunk]()
    with Cleaner(work.recipe, work.source.clock.step_s) as own:
        if begin:
            own.set_history(_histories(work, begin))
        spans = (begin, first), (first, stop), (stop, end)
        chunks = chain.from_iterable(work.source.chunks(*span, work.rows) for span in spans if span[0] < span[1])
        for answer in iter_clean_chunks(own, work.recipe, chunks):
            if first <= answer.chunk.first_row < stop:
                write(answer)
                heads += [answer] * (not heads)
            elif answer.chunk.first_row >= stop:
                tails += [answer] * (not tails)
        return Seams(first_rows=_overlap(heads), next_rows=_overlap(tails)), own.reports()


def _overlap(answers: list[CleanChunk]) -> Floats | None:
    """Return signal and sigma of the first rows of each channel, (m, 2, n); None if there is no chunk."""
    if not answers:
        return None
    return np.array([[one.signal[:OVERLAP], one.sigma[:OVERLAP]] for one in answers[0].estimates])


def _histories(work: _Work, begin: int) -> list[History]:
    """Return each channel's history before row `begin`, at which a warm-up starts."""
    earlier = [one for one in work.long.extremes if one.row <= begin]
    steps = work.source.steps_before(begin)
    nothing = (np.inf,) * len(work.recipe.channel)
    least = earlier[-1].least if earlier else nothing
    most = earlier[-1].most if earlier else tuple(-one for one in nothing)
    return [
        History(reading, begin, begin, steps, *between)
        for reading, *between in zip(work.long.first, least, most, strict=True)
    ]


def _pack(arrays: list[dict[str, Floats]] | None) -> State | None:
    return None if arrays is None else tuple(packed(own) for own in arrays)
