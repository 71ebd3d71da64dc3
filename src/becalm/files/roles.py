"""Which columns are channels, which only pass through, and why."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Floats
from becalm.errors import InputError, UsageError
from becalm.files.cells import to_numbers
from becalm.files.source import CHANNEL, PASSED, TIME, ColumnLayout, RawTable
from becalm.files.time_column import NUMBERS, is_counter, kind_of_column, named_column, numbers
from becalm.files.units import parse_header, tidy_unit

SIGMA = "_sigma"
_EXACT = 2.0**53


def choose_channels(
    raw: RawTable, time: Sequence[str], other_times: Sequence[str], asked: Sequence[str] | None
) -> tuple[tuple[str, ...], tuple[ColumnLayout, ...]]:
    """Decide what each column is.

    Parameters
    ----------
    raw : RawTable
        The file.
    time : sequence of str
        Columns that are the time.
    other_times : sequence of str
        Columns that look like time and are not used as such.
    asked : sequence of str, optional
        Channels that a person asked for; by default all that look like signals.

    Returns
    -------
    tuple of str
        The channels: as asked, or in the order of the file.
    tuple of ColumnLayout
        All columns in the order of the file.

    Raises
    ------
    UsageError
        If a channel asked for does not exist or is the time.
    InputError
        If a numeric column has a cell that is no number, or there is no channel.
    """
    wanted = None if asked is None else _resolved(raw, asked, time)
    columns = []
    for name in raw.table.column_names:
        role, why = PASSED, ""
        if name in time:
            role = TIME
        elif wanted is not None:
            role, why = (CHANNEL, "asked for") if name in wanted else (PASSED, "not asked for")
        elif name in other_times:
            why = "another time" if time else "a time; rows are counted at the rate given"
        elif not (why := _why_passed(raw, name)):
            role = CHANNEL
        columns.append(ColumnLayout(name, role, why, unit_of(raw, name), _missing(raw.table.column(name))))
    channels = tuple(column.name for column in columns if column.role == CHANNEL)
    if not channels:
        reasons = "; ".join(f"{c.name!r}: {c.why or c.role}" for c in columns[:10])
        raise InputError(f"There is no column of numbers to clean ({reasons}). Name one with --channels to insist.")
    return (channels if wanted is None else wanted), tuple(columns)


def unit_of(raw: RawTable, name: str) -> str:
    """Return the unit of a column, "" where the file does not say."""
    return tidy_unit(raw.units[name]) if name in raw.units else parse_header(name)[1]


def samples_of(raw: RawTable, channels: Sequence[str]) -> Floats:
    """Return the channels as (N, m) float64, NaN where a cell is missing.

    Raises
    ------
    InputError
        If a cell is no number.
    """
    return np.column_stack([_values(raw, name) for name in channels])


def _resolved(raw: RawTable, asked: Sequence[str], time: Sequence[str]) -> tuple[str, ...]:
    wanted = tuple(dict.fromkeys(named_column(raw, name, "--channels") for name in asked))
    if not wanted:
        raise UsageError(f"--channels is empty; name some of {', '.join(map(repr, raw.table.column_names[:20]))}.")
    for name in wanted:
        if name in time:
            raise UsageError(f"--channels names {name!r}, which is the time column; leave it out.")
    return wanted


def _why_passed(raw: RawTable, name: str) -> str:
    """Say why a column is no channel, "" if it is one."""
    column = raw.table.column(name)
    if name.endswith(SIGMA) and name.removesuffix(SIGMA) in raw.table.column_names:
        return f"the uncertainty of {name.removesuffix(SIGMA)!r}"
    if pa.types.is_boolean(column.type):
        return "a flag (true and false)"
    if pa.types.is_null(column.type):
        return ""
    if kind_of_column(column) != NUMBERS:
        return _why_not_numbers(raw, name)
    values = numbers(column)
    if pa.types.is_integer(column.type) and np.abs(values).max(initial=0.0, where=np.isfinite(values)) > _EXACT:
        return "whole numbers beyond 2^53, which float64 cannot tell apart"
    if is_counter(values):
        return "a counter (steps of exactly 1)"
    return "a flag (only 0 and 1)" if _is_flag(values) else ""


def _why_not_numbers(raw: RawTable, name: str) -> str:
    kind = raw.table.column(name).type
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        if raw.format == "csv" and not kind_of_column(raw.table.column(name)):
            _refuse_few_bad_cells(raw, name)
        return "text"
    if pa.types.is_nested(kind):
        return "nested"
    return "dates or times" if pa.types.is_temporal(kind) else f"not numbers ({kind})"


def _is_flag(values: Floats) -> bool:
    zeros, ones = values == 0.0, values == 1.0
    return bool(zeros.any() and ones.any() and np.all(zeros | ones | np.isnan(values)))


def _refuse_few_bad_cells(raw: RawTable, name: str) -> None:
    """Refuse a column of numbers with a few cells of text; a column of text passes."""
    parsed, bad = to_numbers(raw.table.column(name).combine_chunks(), _decimal(raw))
    if bad.sum() < len(parsed) - parsed.null_count:
        raise _bad_cell(raw, name, int(np.flatnonzero(bad)[0]), int(bad.sum()))


def _bad_cell(raw: RawTable, name: str, row: int, count: int) -> InputError:
    cell = str(raw.table.column(name)[row].as_py())[:40]
    more = f" ({count} such cells)" if count > 1 else ""
    others = [n for n in raw.table.column_names if n != name and kind_of_column(raw.table.column(n)) == NUMBERS]
    listed = ",".join(others[:3]) or "..."
    return InputError(
        f"Column {name!r} holds {cell!r} in {raw.place(row)}, which is not a number{more}. "
        f"Mend the cell, or leave the column out by naming the others: --channels {listed!r}."
    )


def _decimal(raw: RawTable) -> str:
    return raw.text.decimal if raw.text else "."


def _values(raw: RawTable, name: str) -> Floats:
    column = raw.table.column(name)
    kind = column.type
    if pa.types.is_boolean(kind):
        return numbers(column.cast(pa.int8()))
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        parsed, bad = to_numbers(column.combine_chunks(), _decimal(raw))
        if bad.any():
            raise _bad_cell(raw, name, int(np.flatnonzero(bad)[0]), int(bad.sum()))
        return numbers(pa.chunked_array([parsed]))
    if kind_of_column(column) != NUMBERS and not pa.types.is_null(kind):
        raise InputError(f"Column {name!r} holds {kind}, not numbers; leave it out of --channels.")
    return numbers(column)


def _missing(column: pa.ChunkedArray) -> int:
    missing = column.null_count
    if pa.types.is_floating(column.type):
        missing += pc.sum(pc.is_nan(column)).as_py() or 0
    elif pa.types.is_string(column.type):
        missing += pc.sum(pc.equal(column, "")).as_py() or 0
    return int(missing)
