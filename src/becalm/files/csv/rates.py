"""The rate that stands above the rows of a CSV file, for tables without a column of times."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pyarrow as pa

from becalm.files.arrays.array_rates import hertz_of
from becalm.files.groups import TIME
from becalm.files.numbers import Numbers
from becalm.files.rows import TableRows
from becalm.files.source import RawTable, ToldTime
from becalm.files.text.cells import split
from becalm.files.timing.time_column import NUMBERS, find_time, kind_of_column, numbers
from becalm.files.unit_spelling import parse_header

_STEPS = {"Delta_X": "dt", "Increment": "dt", "tInc": "dt"}
"""What LabVIEW and oscilloscopes call the time step."""

_WRITTEN = re.compile(r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*([A-Za-z/]*)")
_TOLD = re.compile(r"\s*[:=]\s*")
_AGREE = 1e-9


def rate_above(lines: Sequence[str], separator: str) -> float | None:
    """Return the rate in Hz that all lines above a table agree on, None where none tells it.

    Parameters
    ----------
    lines : sequence of str
        All above the first row of data: `Sample rate: 100 Hz`, `Delta_X` and a step for each channel.
    separator : str
        Between two cells.
    """
    cut = [split(line.strip("#%/; \t"), separator) for line in lines]
    rows = [[cell.strip().strip('"') for cell in row] for row in cut if row]
    told = [rate for row in rows for rate in _told_in(row)]
    told += [rate for upper, lower in pairwise(rows) for rate in _told_below(upper, lower)]
    return told[0] if told and max(told) <= min(told) * (1.0 + _AGREE) else None


def with_rate(raw: RawTable, rate_hz: float | None) -> RawTable:
    """Give a table the rate that its head tells, unless it has times of its own."""
    if rate_hz is None or _has_times(raw):
        return raw
    own = next(name for number in range(len(raw.names) + 1) if (name := TIME + "_" * number) not in raw.names)
    rows = _CountedRows(raw.rows, own, rate_hz)
    return replace(raw, rows=rows, units={own: "s", **raw.units}, time=ToldTime(own, rate_hz))


def _told_in(row: Sequence[str]) -> Iterator[float]:
    """Give the rates in a row of cells: a name and a number in two cells, or in one."""
    pairs = [(row[0].rstrip(":= "), row[1:])]
    pairs += [(parts[0], parts[1:]) for cell in row if len(parts := _TOLD.split(cell, maxsplit=1)) == 2]
    for name, values in pairs:
        found = [match for value in values if (match := _WRITTEN.fullmatch(value))]
        if found and len({match[1] for match in found}) == 1:
            unit = found[0][2] or next((value for value in values if value and not value[0].isdigit()), "")
            rate = hertz_of(_STEPS.get(name, name), float(found[0][1]), unit)
            if rate is not None:
                yield rate


def _told_below(upper: Sequence[str], lower: Sequence[str]) -> Iterator[float]:
    """Give the rate of a step that stands below its name."""
    for name, value in zip(upper, lower, strict=False):
        if name in _STEPS and (match := _WRITTEN.fullmatch(value)):
            rate = hertz_of(_STEPS[name], float(match[1]), "")
            if rate is not None:
                yield rate


def _has_times(raw: RawTable) -> bool:
    """Tell whether a column could be the time, and does more than count rows."""
    found = find_time(raw)
    if len(found) != 1 or len(found[0]) != 1:
        return bool(found)
    name = found[0][0]
    if raw.units.get(name) or parse_header(name)[1] or kind_of_column(raw.head.column(name)) != NUMBERS:
        return True
    seen = Numbers(raw.count)
    for column in raw.column(name):
        seen.add(numbers(column))
    return not seen.counts


class _CountedRows:
    """Rows, and before them the seconds at which they are at an even rate."""

    def __init__(self, rows: TableRows, name: str, rate_hz: float) -> None:
        self._rows, self._name, self._step_s = rows, name, 1 / rate_hz
        self.schema: pa.Schema = rows.schema.insert(0, pa.field(name, pa.float64()))
        self.count = rows.count

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Give the rows, and when they were."""
        known = [name for name in names if name != self._name] or self._rows.schema.names[:1]
        for block in self._rows.blocks(known, most_rows, start):
            seconds = pa.array(np.arange(start, start + block.num_rows) * self._step_s)
            yield block.append_column(self._name, seconds).select(list(names))
            start += block.num_rows

    def close(self) -> None:
        """Give back what is held."""
        self._rows.close()
