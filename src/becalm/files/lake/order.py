"""Sort the files of a recording by the first time stamp in each, whatever their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Booleans, Floats
from becalm.core.time.repair import StepStatistics
from becalm.errors import TimeError
from becalm.files.source import HEAD_ROWS, RawTable
from becalm.files.timing import clock
from becalm.files.timing.time_column import NUMBERS, TEMPORAL, find_time, kind_of_column, numbers


def order_of_time(tables: Sequence[RawTable]) -> list[int]:
    """Return the order of tables with the same columns by the first time in each; only their first rows are read.

    Tables keep their order if they have no time column, if their times are only times of day, or if their time is a
    counter that wraps between them. Tables with equal times keep their order too.

    Parameters
    ----------
    tables : sequence of RawTable
        One table or more, each with rows.

    Returns
    -------
    list of int
        The numbers of the tables, counted from 0, in the order of time.
    """
    longest = max(tables, key=lambda table: table.count)
    candidates = find_time(replace(longest, count=min(longest.count, HEAD_ROWS)))
    if not candidates:
        return [*range(len(tables))]
    columns = candidates[0]
    kinds = [kind_of_column(longest.head.column(name)) for name in columns]
    cells = [_first_time(table, columns, kinds) for table in tables]
    firsts = [pa.chunked_array(of_all_tables) for of_all_tables in zip(*cells, strict=True)]
    times = _times(dict(zip(columns, firsts, strict=True)), kinds)
    if kinds == [NUMBERS] and _wraps(tables, columns[0], numbers(firsts[0])):
        times = None
    order: list[int] = [*range(len(tables))] if times is None else pc.sort_indices(times).to_pylist()
    return order


def _first_time(table: RawTable, columns: tuple[str, ...], kinds: Sequence[str]) -> list[pa.Array]:
    """Return the cells of the first row whose time columns are all present, (1,) each; nulls if there is none."""
    for block in table.blocks(columns, most_rows=HEAD_ROWS):
        present = [_present(column, kind) for column, kind in zip(block.columns, kinds, strict=True)]
        if (complete := np.logical_and.reduce(present)).any():
            return [column.slice(int(complete.argmax()), 1).combine_chunks() for column in block.columns]
    return [pa.nulls(1, table.type_of(name)) for name in columns]


def _present(column: pa.ChunkedArray, kind: str) -> Booleans:
    """Return a mask (n,) of the rows in which a time column has a value."""
    if kind == NUMBERS:
        return np.isfinite(numbers(column))
    if kind == TEMPORAL:
        return np.asarray(column.is_valid())
    return np.asarray(pc.fill_null(pc.not_equal(pc.utf8_trim_whitespace(column), ""), False))


def _times(firsts: Mapping[str, pa.ChunkedArray], kinds: Sequence[str]) -> pa.Array | None:
    """Return values that sort tables by time, (n,); None for times of day without a date, and for ambiguous dates."""
    only = next(iter(firsts.values()))
    if kinds in ([NUMBERS], [TEMPORAL]):
        return None if pa.types.is_time(only.type) else only
    if kinds == [clock.TIME_OF_DAY]:
        return None
    try:
        instants = [instants_of(*one) for one in zip(firsts, kinds, firsts.values(), strict=True)]
    except TimeError:  # the first rows alone do not show whether the day or the month comes first
        return None
    ns, missing = [one.ns for one in instants], [one.missing for one in instants]
    return pa.array(np.sum(ns, axis=0), mask=np.any(missing, axis=0))


def instants_of(name: str, kind: str, column: pa.ChunkedArray) -> clock.Instants:
    """Read times from a column of text of one kind; times of day are in nanoseconds since their own midnight."""
    instants = next(clock.ClockReader(name, kind, lambda: [column]).blocks())
    return replace(instants, ns=instants.ns % clock.DAY_NS) if kind == clock.TIME_OF_DAY else instants


def _wraps(tables: Sequence[RawTable], name: str, firsts: Floats) -> bool:
    """Return whether a counter wraps between the first two consecutive tables whose first stamps decrease."""
    falls = np.flatnonzero(np.diff(firsts) < 0.0)
    if not len(falls):
        return False
    before, after = tables[falls[0]], tables[falls[0] + 1]
    steps = StepStatistics(before.count + HEAD_ROWS)
    for column in before.column(name):
        steps.add(numbers(column))
    steps.add(numbers(next(after.blocks([name], most_rows=HEAD_ROWS)).column(0)))
    return steps.wraps_at is not None
