"""Decide which columns of a file are channels, and which are only copied to the output."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Floats
from becalm.errors import InputError, UsageError
from becalm.files.column_statistics import ChannelTest
from becalm.files.read_options import COMMAND_LINE, RequestOrigin
from becalm.files.rows import block_rows
from becalm.files.source import CHANNEL, PASSED_THROUGH, TIME, ColumnLayout, RawTable
from becalm.files.text.cells import bad_cell, find_bad_cells, is_text, to_numbers
from becalm.files.timing.time_column import NUMBERS, kind_of_column, named_column, numbers
from becalm.files.units.unit_spelling import on_sensor, parse_header, tidy_unit
from becalm.installation import typed

SIGMA = "_sigma"  # the ending of the name of a column of uncertainties
_COVARIANCE = re.compile(r".*_covariance_[0-9]+")  # a ROS driver writes its sensor's covariance with each reading
_MOST_NAMED = 8  # largest number of columns that a message names
_FIRST_ROWS = 1 << 16  # rows that suffice to decide for most columns whether they are channels


def choose_channels(
    raw: RawTable,
    time: Sequence[str],
    other_times: Sequence[str],
    asked: Sequence[str] | None,
    origin: RequestOrigin = COMMAND_LINE,
) -> tuple[tuple[str, ...], tuple[ColumnLayout, ...]]:
    """Decide the role of each column.

    Parameters
    ----------
    raw : RawTable
        The file.
    time : sequence of str
        The time column or columns.
    other_times : sequence of str
        Columns that look like a time but are not used as the time.
    asked : sequence of str, optional
        The requested channels; by default all columns that look like signals.
    origin : RequestOrigin
        The origin of the request, for messages.

    Returns
    -------
    tuple of str
        The channels, in the order of the request or of the file.
    tuple of ColumnLayout
        All columns in the order of the file.

    Raises
    ------
    UsageError
        If a requested channel does not exist or is the time.
    InputError
        If a numeric column has a cell that is not a number, or there is no channel.
    """
    times = (*time, *other_times)
    wanted = None if asked is None else _requested_columns(raw, asked, time, origin)
    why_not = _why_not_channels(raw, times) if wanted is None else {}
    columns = []
    for name in raw.names:
        role, why = PASSED_THROUGH, ""
        if name in time:
            role = TIME
        elif wanted is not None:
            role, why = (CHANNEL, "asked for") if name in wanted else (PASSED_THROUGH, "not asked for")
        elif name in other_times:
            why = "another time" if time else "a time; rows are counted at the rate given"
        elif not (why := why_not[name]):
            role = CHANNEL
        columns.append(ColumnLayout(name, role, why, unit_of(raw, name)))
    channels = tuple(column.name for column in columns if column.role == CHANNEL)
    if not channels:
        reasons = "; ".join(f"{c.name!r}: {c.why or c.role}" for c in columns[:10])
        raise InputError(f"There is no column of numbers to clean ({reasons}). Name one with --channels to insist.")
    for name in channels if wanted is None else wanted:
        refuse_no_numbers(raw, name, times)
    return (channels if wanted is None else wanted), tuple(columns)


def unit_of(raw: RawTable, name: str) -> str:
    """Return the unit of a column, "" if the file does not give one."""
    return on_sensor(name, tidy_unit(raw.units[name])) if name in raw.units else parse_header(name)[1]


def values_of(column: pa.ChunkedArray, decimal: str) -> Floats:
    """Return the cells of a channel as float64, (n,), NaN where one is missing; without a copy if possible."""
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.int8())
    elif is_text(column.type):
        column = pa.chunked_array([to_numbers(column.combine_chunks(), decimal)[0]])
    return numbers(column)


def missing_in(raw: RawTable) -> list[int]:
    """Count the missing cells of each column; this reads the file once."""
    counts = [0] * len(raw.names)
    for block in raw.blocks(raw.names):
        for position, column in enumerate(block.columns):
            counts[position] += _missing(column)
    return counts


def _requested_columns(
    raw: RawTable, asked: Sequence[str], time: Sequence[str], origin: RequestOrigin
) -> tuple[str, ...]:
    wanted = tuple(dict.fromkeys(named_column(raw, name, origin) for name in asked))
    if not wanted:
        raise UsageError(f"--channels is empty; name some of {', '.join(map(repr, raw.names[:20]))}.")
    for name in wanted:
        if name in time:
            raise UsageError(
                f"{origin.name} names {name!r}, which is the time column; leave it out, or name another time with"
                f" --time.{origin.advice}"
            )
    return wanted


def _why_not_channels(raw: RawTable, times: Sequence[str]) -> dict[str, str]:
    """Return for each column except the times why it is not a channel; "" if it is one."""
    reasons: dict[str, str] = {}
    signals = {}
    for name in raw.names:
        if name in times:
            continue
        kind = raw.type_of(name)
        if name.endswith(SIGMA) and name.removesuffix(SIGMA) in raw.names:
            reasons[name] = f"the uncertainty of {name.removesuffix(SIGMA)!r}"
        elif _COVARIANCE.fullmatch(name):
            reasons[name] = "a covariance that the sensor states"
        elif pa.types.is_boolean(kind):
            reasons[name] = "a flag (true and false)"
        elif pa.types.is_null(kind):
            reasons[name] = ""
        elif kind_of_column(raw.head.column(name)) != NUMBERS:
            reasons[name] = _why_not_numbers(raw, name, times)
        else:
            signals[name] = ChannelTest(pa.types.is_integer(kind))
    _examine(raw, signals, _FIRST_ROWS)
    undecided = {
        name: ChannelTest(pa.types.is_integer(raw.type_of(name))) for name in signals if not signals[name].decided
    }
    if raw.count > _FIRST_ROWS and undecided:
        _examine(raw, undecided, raw.count)
        signals |= undecided
    return reasons | {name: signal.why_not_channel for name, signal in signals.items()}


def _examine(raw: RawTable, signals: Mapping[str, ChannelTest], rows: int) -> None:
    """Read the first rows of columns into their `ChannelTest` objects, until all of them are decided."""
    if not signals:
        return
    for block in raw.blocks(list(signals), most_rows=min(rows, block_rows(raw.rows.schema))):
        for name, signal in signals.items():
            signal.add(numbers(block.column(name)))
        rows -= block.num_rows
        if rows <= 0 or all(signal.decided for signal in signals.values()):
            return


def _why_not_numbers(raw: RawTable, name: str, times: Sequence[str]) -> str:
    kind = raw.type_of(name)
    if is_text(kind):
        if raw.format == "csv" and not kind_of_column(raw.head.column(name)):
            bad = find_bad_cells(raw, name)
            if bad.few and not bad.cells:
                return "whole numbers that float64 would round"
            if bad.few:
                raise bad_cell(raw, name, bad, _exclusion_hint(raw, name, times))
        return "text"
    if pa.types.is_nested(kind):
        return "nested"
    return "dates or times" if pa.types.is_temporal(kind) else f"not numbers ({kind})"


def _exclusion_hint(raw: RawTable, name: str, times: Sequence[str]) -> str:
    """Return a phrase that says how to leave a column out; "" if there are no other columns of numbers."""
    others = [n for n in raw.names if n not in (name, *times) and kind_of_column(raw.head.column(n)) == NUMBERS]
    if len(others) > _MOST_NAMED:
        return ", or leave the column out: name all others with --channels"
    return f", or leave the column out by naming the others: --channels {typed(','.join(others))}" if others else ""


def refuse_no_numbers(raw: RawTable, name: str, times: Sequence[str]) -> None:
    """Refuse a requested channel that does not hold numbers.

    Parameters
    ----------
    raw : RawTable
        The file.
    name : str
        The column.
    times : sequence of str
        Time columns, which the message does not suggest as channels.

    Raises
    ------
    InputError
        If the column does not hold numbers; for text, the message shows its first cell that is not a number.
    """
    kind = raw.type_of(name)
    if is_text(kind):
        bad = find_bad_cells(raw, name)
        if bad.cells:
            raise bad_cell(raw, name, bad, _exclusion_hint(raw, name, times))
    elif not (pa.types.is_boolean(kind) or pa.types.is_null(kind) or kind_of_column(raw.head.column(name)) == NUMBERS):
        raise InputError(f"Column {name!r} holds {kind}, not numbers; name others with --channels.")


def _missing(column: pa.ChunkedArray) -> int:
    missing = column.null_count
    if pa.types.is_floating(column.type):
        missing += pc.sum(pc.is_nan(column)).as_py() or 0
    elif pa.types.is_string(column.type):
        missing += pc.sum(pc.equal(column, "")).as_py() or 0
    return int(missing)


def refuse_uncertainties(names: Sequence[str]) -> None:
    """Refuse to clean both NAME and NAME_sigma, because cleaning NAME writes a column NAME_sigma.

    Raises
    ------
    InputError
        If both are among the channels.
    """
    if twice := [name for name in names if name + SIGMA in names]:
        raise InputError(
            f"Column {twice[0] + SIGMA!r} has the name under which the uncertainty of {twice[0]!r} is written; clean"
            " one without the other, or rename it."
        )
