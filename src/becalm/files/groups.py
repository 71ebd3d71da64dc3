"""Make one table for each time base of a file. Tables are never merged, and column names are unique in the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.files.library_reader import Foreign
from becalm.files.numbers import Column, ColumnRows
from becalm.files.source import FormatTime, RawTable
from becalm.files.text.csv_header import unique_names
from becalm.files.timing.time_column import is_time_name

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
        Columns in the order of the file; a time column is among them under the name `TIME`.
    rows : int
        Number of rows of each column.
    time : FormatTime, optional
        The time, if the format defines it; otherwise a time column is searched for among the columns.
    notes : tuple of str
        Sentences for the user.
    """

    name: str
    columns: Mapping[str, Column]
    rows: int
    time: FormatTime | None = None
    notes: tuple[str, ...] = ()


def tables(
    foreign: Foreign, form: str, groups: Sequence[Group], close: Callable[[], None] | None = None
) -> tuple[RawTable, ...]:
    """Return a table for each group.

    Parameters
    ----------
    foreign : Foreign
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
        raise foreign.holds_nothing()
    named = [group.name or f"group {number}" for number, group in enumerate(kept, start=1)]
    titles = unique_names(named) if len(kept) > 1 else ("",)
    uses = Counter(name for group in kept for name in group.columns if not is_time_name(name))
    shared = _SharedFile(len(kept), close)
    made = []
    for group, title in zip(kept, titles, strict=True):
        columns = {f"{title}/{name}" if uses[name] > 1 else name: column for name, column in _timed(group).items()}
        units = {name: column.unit for name, column in columns.items() if column.unit}
        start = group.time.start if group.time else ""
        metadata = {key: text for key, text in ((GROUP, title), (START, start)) if text}
        rows = ColumnRows(columns, group.rows, foreign, shared.closer(), metadata)
        made.append(RawTable(rows, group.rows, form, units, group=title, time=_time(group), notes=group.notes))
    return tuple(made)


def _timed(group: Group) -> Mapping[str, Column]:
    """Return the columns of a group; a time that is given as a rate becomes a column, so that outputs contain it."""
    if group.time is None or group.time.rate_hz is None:
        return group.columns
    step_s = 1 / group.time.rate_hz
    even = Column(pa.float64(), lambda start, stop: np.arange(start, stop) * step_s, "s")
    own, *names = unique_names([TIME, *group.columns])
    return {own: even, **dict(zip(names, group.columns.values(), strict=True))}


def _time(group: Group) -> FormatTime | None:
    return None if group.time is None else group.time._replace(column=TIME)


class _SharedFile:
    """A file that several tables share; it is closed when the last of them is closed."""

    def __init__(self, tables: int, close: Callable[[], None] | None) -> None:
        self._left, self._close = tables, close

    def closer(self) -> Callable[[], None]:
        """Return a function that closes one of the tables; further calls of it do nothing."""
        closed = False

        def close() -> None:
            nonlocal closed
            if closed:
                return
            closed = True
            self._left -= 1
            if not self._left and self._close is not None:
                self._close()

        return close
