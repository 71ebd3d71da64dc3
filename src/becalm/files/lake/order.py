"""The order of files of one recording: by the first stamp in each, whatever they are called."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Booleans, Floats
from becalm.core.time.repair import Steps
from becalm.errors import TimeError
from becalm.files.source import HEAD_ROWS, RawTable
from becalm.files.timing import clock
from becalm.files.timing.time_column import NUMBERS, TEMPORAL, find_time, kind_of_column, numbers


def order_of_time(tables: Sequence[RawTable]) -> list[int]:
    """Sort tables of the same columns by the first time in each; of each only its first rows are read.

    They stay as they came where no column tells the time, or only the time of day, or a counter that starts again from
    zero between them; so do those of equal times.

    Parameters
    ----------
    tables : sequence of RawTable
        One or more, none without rows.

    Returns
    -------
    list of int
        Which table comes where, counted from 0.
    """
    longest = max(tables, key=lambda table: table.count)
    found = find_time(replace(longest, count=min(longest.count, HEAD_ROWS)))
    if not found:
        return [*range(len(tables))]
    kinds = [kind_of_column(longest.head.column(name)) for name in found[0]]
    firsts = [pa.chunked_array(of_all) for of_all in zip(*[_first(t, found[0], kinds) for t in tables], strict=True)]
    times = _times(dict(zip(found[0], firsts, strict=True)), kinds)
    if kinds == [NUMBERS] and _wraps(tables, found[0][0], numbers(firsts[0])):
        times = None
    order: list[int] = [*range(len(tables))] if times is None else pc.sort_indices(times).to_pylist()
    return order


def _first(table: RawTable, columns: tuple[str, ...], kinds: Sequence[str]) -> list[pa.Array]:
    """Return the cells of the first row in which all of the time is told, (1,) each; nulls where there is none."""
    for block in table.blocks(columns, most_rows=HEAD_ROWS):
        told = [_told(column, kind) for column, kind in zip(block.columns, kinds, strict=True)]
        if (both := np.logical_and.reduce(told)).any():
            return [column.slice(int(both.argmax()), 1).combine_chunks() for column in block.columns]
    return [pa.nulls(1, table.type_of(name)) for name in columns]


def _told(column: pa.ChunkedArray, kind: str) -> Booleans:
    """Say in which rows a column tells a time, (n,)."""
    if kind == NUMBERS:
        return np.isfinite(numbers(column))
    if kind == TEMPORAL:
        return np.asarray(column.is_valid())
    return np.asarray(pc.fill_null(pc.not_equal(pc.utf8_trim_whitespace(column), ""), False))


def _times(firsts: Mapping[str, pa.ChunkedArray], kinds: Sequence[str]) -> pa.Array | None:
    """Return for each row what grows with its time, (n,); None where only the time of day is told, or nothing."""
    only = next(iter(firsts.values()))
    if kinds in ([NUMBERS], [TEMPORAL]):
        return None if pa.types.is_time(only.type) else only
    if kinds == [clock.TIME_OF_DAY]:
        return None
    try:
        read = [instants_of(*one) for one in zip(firsts, kinds, firsts.values(), strict=True)]
    except TimeError:  # whether day or month comes first, only all of the rows tell
        return None
    return pa.array(np.sum([one.ns for one in read], axis=0), mask=np.any([one.missing for one in read], axis=0))


def instants_of(name: str, kind: str, column: pa.ChunkedArray) -> clock.Instants:
    """Read times as text, those of day within their day."""
    read = next(clock.ClockReader(name, kind, lambda: [column]).blocks())
    return replace(read, ns=read.ns % clock.DAY_NS) if kind == clock.TIME_OF_DAY else read


def _wraps(tables: Sequence[RawTable], name: str, firsts: Floats) -> bool:
    """Whether a counter is seen to start again from zero, where the first stamps of tables as they came fall."""
    falls = np.flatnonzero(np.diff(firsts) < 0.0)
    if not len(falls):
        return False
    before, after = tables[falls[0]], tables[falls[0] + 1]
    steps = Steps(before.count + HEAD_ROWS)
    for column in before.column(name):
        steps.add(numbers(column))
    steps.add(numbers(next(after.blocks([name], most_rows=HEAD_ROWS)).column(0)))
    return steps.wraps_at is not None
