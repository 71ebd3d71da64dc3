"""What is kept of a stream as a table: row, time, and of each channel clean, raw, sigma and verdict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.files.roles import SIGMA
from becalm.files.tables import VERDICT, in_words
from becalm.live.block import Head, Output

ROW, TIME = "row", "time_s"
RAW = "_raw"
"""Ends the name of a column of readings as they came."""

EPOCH_S = 1e8
"""Stamps from here on (March 1973) are seconds since 1970; smaller ones count from some start of their own."""

_WORDS = pa.dictionary(pa.int8(), pa.string())


def column_names(head: Head) -> list[str]:
    """Return the columns of a table, in their order.

    Raises
    ------
    UsageError
        If two of them would have one name: a channel is called `row`, or one `a` and another `a_raw`.
    """
    names = [ROW, TIME, *(name + end for name in head.names for end in ("", RAW, SIGMA, VERDICT))]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise UsageError(
                f"Two columns would be called {name!r}: each channel NAME has NAME, NAME{RAW}, NAME{SIGMA} and"
                f" NAME{VERDICT}, beside {ROW} and {TIME}; give a channel another name at its source."
            )
    return names


def table_schema(head: Head) -> pa.Schema:
    """Return the columns of a table with their units; the schema's metadata holds `recipe` and `rate_hz`.

    Raises
    ------
    UsageError
        As `column_names`.
    """
    column_names(head)
    fields = [pa.field(ROW, pa.int64()), _numbers(TIME, "s")]
    for name, unit in zip(head.names, head.units, strict=True):
        fields += [_numbers(name + end, unit) for end in ("", RAW, SIGMA)]
        fields.append(pa.field(name + VERDICT, _WORDS))
    return pa.schema(fields, metadata={"recipe": head.recipe, "rate_hz": repr(head.rate_hz)})


def output_table(head: Head, outputs: Sequence[Output]) -> pa.Table:
    """Put some outputs below each other.

    Parameters
    ----------
    head : Head
        What all rows share.
    outputs : sequence of Output
        In their order; those without rows add none.

    Returns
    -------
    pyarrow.Table
        Columns `row`, `time_s` and for each channel NAME, NAME_raw, NAME_sigma (NaN stays NaN) and NAME_verdict, in
        words, a dictionary; one chunk each.
    """
    schema = table_schema(head)
    if not outputs:
        return schema.empty_table()
    rows = np.concatenate([np.arange(one.first_row, one.first_row + len(one)) for one in outputs])
    columns = [pa.array(rows), pa.array(np.concatenate([one.time_s for one in outputs]))]
    told = [_by_channel([getattr(one, part) for one in outputs]) for part in ("signal", "values", "sigma")]
    verdicts = np.ascontiguousarray(np.concatenate([one.verdicts for one in outputs]).T)
    for channel in range(len(head.names)):
        columns += [pa.array(part[channel]) for part in told]
        columns.append(in_words(verdicts[channel]))
    return pa.table(columns, schema=schema)


def _by_channel(parts: Sequence[Floats]) -> Floats:
    """Return blocks (B, m) one after the other as (m, rows), each channel contiguous, so that Arrow copies nothing."""
    return np.ascontiguousarray(np.concatenate(parts).T)


def _numbers(name: str, unit: str) -> pa.Field:
    return pa.field(name, pa.float64(), metadata={"unit": unit} if unit else None)
