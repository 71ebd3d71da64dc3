"""Bins of a live page: the same however rows came, equal to a plain oracle, and no spike is lost."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.live.block import Output
from becalm.web.livepage.bins import COARSER, LEVELS, Bins, Span

CHANNELS, MODES, RATE_HZ = 2, 3, 600.0
EACH = 4  # rows of a bin of level 0 at this rate


def output_of(rows: int, first_row: int = 0, seed: int = 0) -> Output:
    """Return rows of every kind: missing, infinite, beyond any sensor, with either zero, not known yet."""
    rng = np.random.default_rng(seed)

    def some(columns: int) -> Floats:
        odd = rng.choice([np.nan, np.inf, -np.inf, 1e300, 0.0, -0.0], (rows, columns))
        return np.where(rng.random((rows, columns)) < 0.2, odd, rng.normal(size=(rows, columns)))

    verdicts = (rng.integers(0, len(Verdict), (rows, CHANNELS)) * (rng.random((rows, CHANNELS)) < 0.1)).astype(np.int8)
    row = np.arange(first_row, first_row + rows)
    return Output(
        first_row, row / RATE_HZ, some(CHANNELS), some(CHANNELS), abs(some(CHANNELS)), verdicts, modes=abs(some(MODES))
    )


def part_of(output: Output, begin: int, end: int) -> Output:
    some = slice(begin, end)
    return Output(
        output.first_row + begin,
        output.time_s[some],
        output.values[some],
        output.signal[some],
        output.sigma[some],
        output.verdicts[some],
        modes=output.modes[some],
    )


def pushed(output: Output, cuts: list[int], *, ended: bool = False) -> Bins:
    bins = Bins(CHANNELS, RATE_HZ, MODES)
    for begin, end in zip([0, *cuts], [*cuts, len(output)], strict=True):
        bins.push(part_of(output, begin, end))
    if ended:
        bins.finish()
    return bins


def oracle(output: Output, each: int, *, ended: bool = False) -> list[tuple[int, Floats, Floats, list[int]]]:
    """Say what is in every closed bin, row by row."""

    def best(columns: Floats, take: object) -> Floats:
        found = []
        for column in columns.T:
            drawn = [float(value) for value in column if abs(value) <= 1e30]
            found.append(take(drawn) if drawn else np.nan)  # type: ignore[operator]
        return np.array(found)

    told = []
    row = np.arange(output.first_row, output.first_row + len(output))
    for number in np.unique(row // each):
        own = row // each == number
        if not ended and row[-1] < (number + 1) * each - 1:
            continue
        lows = np.concatenate([output.values[own], output.signal[own]], axis=1)
        highs = np.concatenate([lows, output.sigma[own], output.modes[own]], axis=1)
        bits = [sum(1 << int(v) for v in set(column.tolist()) if v) for column in output.verdicts[own].T]
        told.append((int(number), best(lows, min), best(highs, max), bits))
    return told


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 900), st.integers(0, 5000), st.lists(st.integers(0, 900), max_size=12), st.booleans())
def test_any_cut_gives_the_bins_of_a_plain_oracle(rows: int, first_row: int, cuts: list[int], ended: bool) -> None:
    output = output_of(rows, first_row)
    bins = pushed(output, sorted(min(cut, rows) for cut in cuts), ended=ended)
    assert bins.rows_each == tuple(EACH * COARSER**level for level in range(LEVELS))
    for level, each in enumerate(bins.rows_each):
        expected = oracle(output, each, ended=ended)
        got = bins.read(level, 0, bins.newest(level))
        assert len(got) == len(expected)
        for k, (number, low, high, bits) in enumerate(expected):
            assert got.first + k == number
            assert got.low[k].tobytes() == (low + 0.0).tobytes()
            assert got.high[k].tobytes() == (high + 0.0).tobytes()
            assert got.verdicts[k].tolist() == bits
            assert got.time_s[k] == max(number * each, first_row) / RATE_HZ


def test_a_spike_of_one_row_is_in_every_level() -> None:
    output = output_of(EACH * COARSER ** (LEVELS - 1) * 2)
    row = 12_345
    output.values[:] = output.signal[:] = 0.0
    output.values[row, 1], output.signal[row, 0] = -99.0, 77.0
    bins = pushed(output, list(range(100, len(output), 100)))
    for level, each in enumerate(bins.rows_each):
        span = bins.read(level, row // each, row // each + 1)
        assert (span.low[0, 1], span.high[0, CHANNELS]) == (-99.0, 77.0)


def test_memory_is_bounded_and_what_has_left_is_left_out() -> None:
    bins = Bins(CHANNELS, RATE_HZ, MODES)
    output = output_of(10_000)
    for turn in range(5):
        bins.push(
            Output(
                turn * 10_000, *(getattr(output, name) for name in ("time_s", "values", "signal", "sigma", "verdicts"))
            )
        )
    newest = 50_000 // EACH
    assert (bins.oldest(0), bins.newest(0)) == (newest - bins.kept, newest)
    span = bins.read(0, 0, newest)
    assert (span.first, len(span)) == (newest - bins.kept, bins.kept)
    assert len(bins.read(0, newest, newest + 10)) == 0
    assert np.isnan(span.high[:, 3 * CHANNELS :]).all(), "of modes that nobody told nothing is known"
    many = Bins(100, RATE_HZ)
    assert 2048 <= many.kept < bins.kept


@pytest.mark.slow
def test_a_reader_beside_the_writer_sees_whole_bins() -> None:
    """Whatever a reader gets was written at once: low and high of a bin are its number."""
    bins, ended, seen = Bins(1, 150.0), threading.Event(), []
    column = np.arange(200_000.0)[:, np.newaxis]
    output = Output(0, column[:, 0], column, column, column, np.zeros(column.shape, np.int8))

    def look() -> None:
        while not ended.is_set():
            for level in range(LEVELS):
                seen.append((level, bins.read(level, bins.oldest(level), bins.newest(level))))
                del seen[:-2000]

    thread = threading.Thread(target=look)
    thread.start()
    for begin in range(0, 200_000, 37):
        bins.push(part_of(output, begin, begin + 37))
    ended.set()
    thread.join()
    assert any(len(span) for _, span in seen)
    for level, span in seen:
        check_whole(span, bins.rows_each[level])


def check_whole(span: Span, each: int) -> None:
    number = np.arange(span.first, span.first + len(span))
    np.testing.assert_array_equal(span.low[:, 0], number * each)
    np.testing.assert_array_equal(span.high[:, 0], (number + 1) * each - 1)
