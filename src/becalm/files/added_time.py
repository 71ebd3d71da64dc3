"""Files whose rows have no time in numbers of their own, written where a time base is expected."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pyarrow as pa

from becalm.files.groups import START, TIME
from becalm.files.opening import OpenSource
from becalm.files.timing.time_column import is_time_name


def with_time(source: OpenSource, write: Callable[[pa.Table], None]) -> Callable[[pa.Table], None]:
    """Return what writes the rows of a file with their time in seconds first, where no column tells it in numbers.

    Dates and times of day are text to other programs, and a rate that was said stands in no column.

    Parameters
    ----------
    source : OpenSource
        The file, whose rows come in order.
    write : callable
        Takes the next rows.
    """
    if TIME in source.schema.names or any(_tells_time(field) for field in source.schema):
        return write
    row, steps = 0, 0.0
    told = {key: text for key, text in ((START, source.start),) if text}

    def write_timed(table: pa.Table) -> None:
        nonlocal row, steps
        elapsed = steps + np.cumsum(source.elapsed_steps(row, table.num_rows))
        if len(elapsed):
            row, steps = row + table.num_rows, float(elapsed[-1])
        timed = table.add_column(0, _FIELD, pa.array(elapsed * source.clock.step_s))
        write(timed.replace_schema_metadata({**(table.schema.metadata or {}), **told}))

    return write_timed


_FIELD = pa.field(TIME, pa.float64(), metadata={b"unit": b"s"})


def _tells_time(field: pa.Field) -> bool:
    return is_time_name(field.name) and (pa.types.is_integer(field.type) or pa.types.is_floating(field.type))
