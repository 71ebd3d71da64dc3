"""Leave out rows of only separators, which some loggers write at the end of a text."""

from __future__ import annotations

import pyarrow as pa

from becalm.files.source import RawTable


def without_blank_end(raw: RawTable, found: list[tuple[str, ...]]) -> int:
    """Return the number of rows without blank rows at the end; only for text files with a time column.

    Parameters
    ----------
    raw : RawTable
        The file.
    found : list of tuple of str
        The candidates for the time from `find_time`; if there are none, all rows count.
    """
    rows = raw.count
    if raw.format != "csv" or not found:
        return rows
    length = 256
    while rows > 1:
        start = max(0, rows - length)
        table = pa.concat_tables(list(raw.blocks(raw.names, start, most_rows=length)))
        last = table.num_rows - (raw.count - rows)
        while last > 0 and rows > 1 and _is_blank(table, last - 1):
            last -= 1
            rows -= 1
        if last > 0:
            return rows
    return rows


def _is_blank(table: pa.Table, row: int) -> bool:
    return all(column[row].as_py() in (None, "") for column in table.columns)
