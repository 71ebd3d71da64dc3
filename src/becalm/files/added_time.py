"""Add a column of time in seconds to the rows of a file that has no numeric time column."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pyarrow as pa

from becalm.files.groups import START, TIME
from becalm.files.opening import OpenSource
from becalm.files.timing.time_column import is_time_name


def with_time(source: OpenSource, write: Callable[[pa.Table], None]) -> Callable[[pa.Table], None]:
    """Return a writer that puts a column of time in seconds first, unless the file has a numeric time column.

    Other programs read dates and times of day as text, and a rate from the command line is not in any column.

    Parameters
    ----------
    source : OpenSource
        The file. Its rows must be written in order.
    write : callable
        Writes the next rows, a pyarrow table.

    Returns
    -------
    callable
        `write` itself if the file has a numeric time column; else a function that adds the time and calls `write`.
    """
    if TIME in source.schema.names or any(_is_numeric_time(field) for field in source.schema):
        return write
    row, steps = 0, 0.0
    start = {START: source.start} if source.start else {}

    def write_timed(table: pa.Table) -> None:
        nonlocal row, steps
        elapsed = steps + np.cumsum(source.elapsed_steps(row, table.num_rows))
        if len(elapsed):
            row, steps = row + table.num_rows, float(elapsed[-1])
        timed = table.add_column(0, _FIELD, pa.array(elapsed * source.clock.step_s))
        write(timed.replace_schema_metadata({**(table.schema.metadata or {}), **start}))

    return write_timed


_FIELD = pa.field(TIME, pa.float64(), metadata={b"unit": b"s"})


def _is_numeric_time(field: pa.Field) -> bool:
    return is_time_name(field.name) and (pa.types.is_integer(field.type) or pa.types.is_floating(field.type))
