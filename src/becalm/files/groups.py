"""Channels of one file at several rates: a table for each time base, never merged; names that differ in all of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.files.columns import Column, ColumnRows
from becalm.files.library_reader import Foreign
from becalm.files.source import RawTable, ToldTime
from becalm.files.text.csv_header import unique_names
from becalm.files.timing.time_column import is_time_name

TIME = "time_s"
"""What the time of a group is called."""

GROUP, START = "becalm.group", "becalm.start"
"""Keys of a table's metadata: what the file calls it, and its first instant as ISO 8601 text."""


class Group(NamedTuple):
    """Columns that share one time base, as a reader found them.

    Attributes
    ----------
    name : str
        What the file calls them; "" where it does not.
    columns : mapping of str to Column
        In the order of the file; the time, if it has a column, is among them as `TIME`.
    rows : int
        Of each column.
    time : ToldTime, optional
        Their time, where the format itself tells it; else it is looked for among the columns.
    notes : tuple of str
        What a person must know, as sentences.
    """

    name: str
    columns: Mapping[str, Column]
    rows: int
    time: ToldTime | None = None
    notes: tuple[str, ...] = ()


def tables(
    foreign: Foreign, form: str, groups: Sequence[Group], close: Callable[[], None] | None = None
) -> tuple[RawTable, ...]:
    """Make a table of each group.

    Parameters
    ----------
    foreign : Foreign
        The file.
    form : str
        Its format in short, "mf4".
    groups : sequence of Group
        Those without rows, or with nothing but time, are left out.
    close : callable, optional
        Gives back what is held, once all tables are closed.

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
    met = Counter(name for group in kept for name in group.columns if not is_time_name(name))
    held = _Held(len(kept), close)
    made = []
    for group, title in zip(kept, titles, strict=True):
        columns = {f"{title}/{name}" if met[name] > 1 else name: column for name, column in _timed(group).items()}
        units = {name: column.unit for name, column in columns.items() if column.unit}
        start = group.time.start if group.time else ""
        told = {key: text for key, text in ((GROUP, title), (START, start)) if text}
        held_rows = ColumnRows(columns, group.rows, foreign, held.one_less(), told)
        made.append(RawTable(held_rows, group.rows, form, units, group=title, time=_time(group), notes=group.notes))
    return tuple(made)


def _timed(group: Group) -> Mapping[str, Column]:
    """Return the columns of a group; even time becomes one of them, so that what is written of it tells the time."""
    if group.time is None or group.time.rate_hz is None:
        return group.columns
    step_s = 1 / group.time.rate_hz
    even = Column(pa.float64(), lambda start, stop: np.arange(start, stop) * step_s, "s")
    own, *names = unique_names([TIME, *group.columns])
    return {own: even, **dict(zip(names, group.columns.values(), strict=True))}


def _time(group: Group) -> ToldTime | None:
    return None if group.time is None else group.time._replace(column=TIME)


class _Held:
    """Closes what several tables share when the last of them is closed."""

    def __init__(self, tables: int, close: Callable[[], None] | None) -> None:
        self._left, self._close = tables, close

    def one_less(self) -> Callable[[], None]:
        """Return what closes one of the tables, however often it is called."""
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
