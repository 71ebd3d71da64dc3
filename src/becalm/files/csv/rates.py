"""Find the sample rate in the lines above the rows of a CSV file, for a table without a time column."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from becalm.files.column_statistics import ColumnStatistics
from becalm.files.groups import TIME
from becalm.files.rows import RowsWithTime
from becalm.files.source import FormatTime, RawTable
from becalm.files.text.cells import split
from becalm.files.timing.time_column import NUMBERS, find_time, kind_of_column, numbers
from becalm.files.units.named_rates import hertz_of
from becalm.files.units.unit_spelling import parse_header

_NAMES_OF_STEPS = {"Delta_X": "dt", "Increment": "dt", "tInc": "dt"}
"""For names of the time step in files of LabVIEW and of oscilloscopes, the name that `hertz_of` knows."""

_NUMBER_AND_UNIT = re.compile(r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*([A-Za-z/]*)")
_NAME_END = re.compile(r"\s*[:=]\s*")
_AGREE = 1e-9  # largest relative difference of rates that count as equal


def rate_above(lines: Sequence[str], separator: str) -> float | None:
    """Return the rate in Hz that the lines above a table give; None if there is none, or if rates differ.

    A number with a comma, as in `Sample rate: 1,000 Hz` or `Sample interval: 1,5 ms`, gives no rate.

    Parameters
    ----------
    lines : sequence of str
        All lines above the first row of data, such as `Sample rate: 100 Hz`, or `Delta_X` with a step per channel.
    separator : str
        The separator between two cells.
    """
    split_lines = [split(line.strip("#%/; \t"), separator) for line in lines]
    rows = [[cell.strip().strip('"') for cell in row] for row in split_lines if row]
    rates = [rate for row in rows if not (separator == "," and _is_cut(row)) for rate in _rates_in(row)]
    rates += [rate for upper, lower in pairwise(rows) for rate in _rates_below(upper, lower)]
    return rates[0] if rates and max(rates) <= min(rates) * (1.0 + _AGREE) else None


def with_rate(raw: RawTable, rate_hz: float | None) -> RawTable:
    """Add a time column at the given rate to a table, unless the rate is None or the table has times."""
    if rate_hz is None or _has_times(raw):
        return raw
    time = next(name for number in range(len(raw.names) + 1) if (name := TIME + "_" * number) not in raw.names)
    rows = RowsWithTime(raw.rows, time, rate_hz)
    return replace(raw, rows=rows, units={time: "s", **raw.units}, time=FormatTime(time, rate_hz))


def _is_cut(row: Sequence[str]) -> bool:
    """Return whether a comma that separates cells may be one inside the number behind a name."""
    return any(
        re.search(r"[:=]\s*[-+]?[0-9]+$", cell) is not None and after[:1].isdigit() for cell, after in pairwise(row)
    )


def _rates_in(row: Sequence[str]) -> Iterator[float]:
    """Yield the rates in a row: a name and a number in two cells, or in one cell with `:` or `=` between them."""
    pairs = [(row[0].rstrip(":= "), row[1:])]
    pairs += [(parts[0], parts[1:]) for cell in row if len(parts := _NAME_END.split(cell, maxsplit=1)) == 2]
    for name, values in pairs:
        matches = [match for value in values if (match := _NUMBER_AND_UNIT.fullmatch(value))]
        if matches and len({match[1] for match in matches}) == 1:
            texts = (value for value in values if value and not _NUMBER_AND_UNIT.fullmatch(value))
            unit = matches[0][2] or next(texts, "")
            rate = hertz_of(_NAMES_OF_STEPS.get(name, name), float(matches[0][1]), unit)
            if rate is not None:
                yield rate


def _rates_below(upper: Sequence[str], lower: Sequence[str]) -> Iterator[float]:
    """Yield the rates of time steps that are in the row below their names."""
    for name, value in zip(upper, lower, strict=False):
        if name in _NAMES_OF_STEPS and (match := _NUMBER_AND_UNIT.fullmatch(value)):
            rate = hertz_of(_NAMES_OF_STEPS[name], float(match[1]))
            if rate is not None:
                yield rate


def _has_times(raw: RawTable) -> bool:
    """Return whether a column may be the time and does not merely count rows."""
    candidates = find_time(raw)
    if len(candidates) != 1 or len(candidates[0]) != 1:
        return bool(candidates)
    name = candidates[0][0]
    if raw.units.get(name) or parse_header(name)[1] or kind_of_column(raw.head.column(name)) != NUMBERS:
        return True
    statistics = ColumnStatistics(raw.count)
    for column in raw.column(name):
        statistics.add(numbers(column))
    return not statistics.counts
