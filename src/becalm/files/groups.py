"""Make one table for each time base of a file; except for times, a column name occurs in one table only."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.errors import InputError, UsageError
from becalm.files.column_statistics import Column, ColumnRows
from becalm.files.library_reader import LibraryFile
from becalm.files.read_options import ReadOptions
from becalm.files.source import FormatTime, RawTable, shared_closers
from becalm.files.text.csv_header import unique_names
from becalm.files.timing.time_column import is_time_name
from becalm.files.units.unit_spelling import parse_header

TIME = "time_s"
"""Name of the time column of a group."""

GROUP, START = "becalm.group", "becalm.start"
"""Keys of a table's metadata: the name of the group in the file, and the first instant as ISO 8601 text."""


class Group(NamedTuple):
    """Columns of a file that share one time base.

    Attributes
    ----------
    name : str
        The name of the group in the file; "" if it has none.
    columns : mapping of str to Column
        Columns in the order of the file. If the format defines a column as the time, its name is `TIME`.
    rows : int
        Number of rows of each column.
    time : FormatTime, optional
        The time, if the format defines it; if None, `find_time` later searches the columns for it.
    notes : tuple of str
        Sentences for the user.
    """

    name: str
    columns: Mapping[str, Column]
    rows: int
    time: FormatTime | None = None
    notes: tuple[str, ...] = ()


def tables(
    library_file: LibraryFile, form: str, groups: Sequence[Group], close: Callable[[], None] | None = None
) -> tuple[RawTable, ...]:
    """Return a table for each group.

    Parameters
    ----------
    library_file : LibraryFile
        The file.
    form : str
        The short name of its format, such as "mf4".
    groups : sequence of Group
        The groups; those without rows, or with only a time column, are left out.
    close : callable, optional
        Releases the file; called once all tables are closed.

    Raises
    ------
    InputError
        If no group has rows.
    """
    kept = [group for group in groups if group.rows and any(name != TIME for name in group.columns)]
    if not kept:
        if close is not None:
            close()
        raise library_file.no_rows_error()
    named = [group.name or f"group {number}" for number, group in enumerate(kept, start=1)]
    titles = unique_names(named) if len(kept) > 1 else ("",)
    uses = Counter(name for group in kept for name in group.columns if not is_time_name(name))
    made = []
    for group, title, close_own in zip(kept, titles, shared_closers(len(kept), close), strict=True):
        columns = {f"{title}/{name}" if uses[name] > 1 else name: column for name, column in _timed(group).items()}
        units = {name: column.unit for name, column in columns.items() if column.unit}
        start = group.time.start if group.time else ""
        metadata = {key: text for key, text in ((GROUP, title), (START, start)) if text}
        rows = ColumnRows(columns, group.rows, library_file, close_own, metadata)
        made.append(RawTable(rows, group.rows, form, units, group=title, time=_time(group), notes=group.notes))
    return tuple(made)


def _timed(group: Group) -> Mapping[str, Column]:
    """Return the columns of a group; if its time is a rate, add a time column, so that outputs contain it."""
    if group.time is None or group.time.rate_hz is None:
        return group.columns
    step_s = 1 / group.time.rate_hz
    even = Column(pa.float64(), lambda start, stop: np.arange(start, stop) * step_s, "s")
    own, *names = unique_names([TIME, *group.columns])
    return {own: even, **dict(zip(names, group.columns.values(), strict=True))}


def _time(group: Group) -> FormatTime | None:
    return None if group.time is None else group.time._replace(column=TIME)


# Select one of the time bases of a file.

_MOST_NAMED = 8  # largest number of groups in a message, and of channels per group


def chosen_table(path: Path, tables: Sequence[RawTable], options: ReadOptions) -> RawTable:
    """Return the table that the options select.

    Raises
    ------
    UsageError
        If the requested group is missing, or the requested channels are not all in one group.
    InputError
        If there are several groups, and no option selects one.
    """
    if options.group is not None:
        return _named(path, tables, options.group)
    if len(tables) == 1:
        return tables[0]
    if options.channels is None:
        raise InputError(f"{path} holds {listed(tables)}. Choose one with --group NAME, or its channels by name.")
    holding = [table for table in tables if any(holds(table, name) for name in options.channels)]
    if not holding:
        raise UsageError(
            f"{options.origin.name} names {options.channels[0]!r}, which is not in {path}; it holds"
            f" {listed(tables)}.{options.origin.advice}"
        )
    if len(holding) > 1:
        raise UsageError(
            f"The requested channels do not share one time: {path} holds {listed(holding)}."
            " Name channels of one of them, or choose it with --group NAME."
        )
    return holding[0]


def _named(path: Path, tables: Sequence[RawTable], group: str) -> RawTable:
    for table in tables:
        if table.group == group:
            return table
    if len(tables) == 1:
        raise UsageError(f"--group names {group!r}, but all channels of {path} share one time; leave --group out.")
    raise UsageError(f"--group names {group!r}, which is not in {path}; it holds {listed(tables)}.")


def holds(table: RawTable, name: str) -> bool:
    """Return whether a table has a column of that name, with or without its unit."""
    return name in table.names or any(parse_header(own)[0] == name.strip() for own in table.names)


def listed(tables: Sequence[RawTable]) -> str:
    """Return a phrase that lists the time bases with their rows and channels."""
    groups = [f"{table.group!r} ({table.count} rows of {_channels(table)})" for table in tables[:_MOST_NAMED]]
    more = f" and {len(tables) - _MOST_NAMED} more" if len(tables) > _MOST_NAMED else ""
    return f"channels at {len(tables)} times: {', '.join(groups)}{more}"


def _channels(table: RawTable) -> str:
    names = [name for name in table.names if name != TIME]
    more = ", ..." if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more
