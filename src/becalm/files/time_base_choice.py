"""Select one of the time bases of a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from becalm.errors import InputError, UsageError
from becalm.files.groups import TIME
from becalm.files.read_options import ReadOptions
from becalm.files.source import RawTable
from becalm.files.unit_spelling import parse_header

_MOST_NAMED = 8  # groups in a message, and channels per group


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
            f"{options.asker.name} names {options.channels[0]!r}, which is not in {path}; it holds"
            f" {listed(tables)}.{options.asker.way_out}"
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
