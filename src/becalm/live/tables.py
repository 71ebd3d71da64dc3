"""Make tables of a stream's outputs: row, time, and clean, raw, sigma and verdict columns for each channel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.files.outputs.tables import VERDICT, verdict_words
from becalm.files.roles import SIGMA
from becalm.live.block import Head, Output

ROW, TIME = "row", "time_s"
RAW = "_raw"
"""Suffix of the column names of raw readings."""

EPOCH_S = 1e8
"""Stamps from this value on (March 1973) are seconds since 1970; smaller stamps count from an unknown start."""

_WORDS = pa.dictionary(pa.int8(), pa.string())  # type of the verdict columns


def column_names(head: Head) -> list[str]:
    """Return the column names of a table, in order.

    Raises
    ------
    UsageError
        If two columns would have the same name: a channel is called `row`, or one `a` and another `a_raw`.
    """
    names = [ROW, TIME, *(name + end for name in head.names for end in ("", RAW, SIGMA, VERDICT))]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise UsageError(
                f"Two columns would be called {name!r}: each channel NAME has NAME, NAME{RAW}, NAME{SIGMA} and"
                f" NAME{VERDICT}, next to {ROW} and {TIME}; rename a channel at its source."
            )
    return names


def table_schema(head: Head) -> pa.Schema:
    """Return the schema of a table with units; its metadata holds `recipe` and `rate_hz`.

    Raises
    ------
    UsageError
        If two columns would have the same name: see `column_names`.
    """
    column_names(head)
    fields = [pa.field(ROW, pa.int64()), _number_field(TIME, "s")]
    for name, unit in zip(head.names, head.units, strict=True):
        fields += [_number_field(name + end, unit) for end in ("", RAW, SIGMA)]
        fields.append(pa.field(name + VERDICT, _WORDS))
    return pa.schema(fields, metadata={"recipe": head.recipe, "rate_hz": repr(head.rate_hz)})


def output_table(head: Head, outputs: Sequence[Output]) -> pa.Table:
    """Return a table of outputs, one after the other.

    Parameters
    ----------
    head : Head
        Names, units, rate and recipe of the stream.
    outputs : sequence of Output
        Outputs in order; they may have no rows.

    Returns
    -------
    pyarrow.Table
        Columns `row`, `time_s` and for each channel NAME, NAME_raw, NAME_sigma (NaN stays NaN) and NAME_verdict
        (words, dictionary-encoded); each column is one chunk.
    """
    schema = table_schema(head)
    if not outputs:
        return schema.empty_table()
    rows = np.concatenate([np.arange(one.first_row, one.first_row + len(one)) for one in outputs])
    columns = [pa.array(rows), pa.array(np.concatenate([one.time_s for one in outputs]))]
    numbers = [_by_channel([getattr(one, part) for one in outputs]) for part in ("signal", "values", "sigma")]
    verdicts = np.ascontiguousarray(np.concatenate([one.verdicts for one in outputs]).T)
    for channel in range(len(head.names)):
        columns += [pa.array(part[channel]) for part in numbers]
        columns.append(verdict_words(verdicts[channel]))
    return pa.table(columns, schema=schema)


def _by_channel(parts: Sequence[Floats]) -> Floats:
    """Return concatenated blocks (B, m) as (m, rows), each channel contiguous, so that Arrow makes no copy."""
    return np.ascontiguousarray(np.concatenate(parts).T)


def _number_field(name: str, unit: str) -> pa.Field:
    return pa.field(name, pa.float64(), metadata={"unit": unit} if unit else None)
