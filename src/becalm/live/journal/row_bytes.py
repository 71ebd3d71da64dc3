"""Pack rows into blocks and unpack them: Arrow IPC with fixed-size lists of channels, so that arrays are not copied."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from math import floor
from typing import Any

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Codes, Floats
from becalm.live.block import Output
from becalm.live.journal.records import BlockRow
from becalm.live.tables import EPOCH_S

_OPTIONS = {"compression": "lz4"}  # shrinks constant sigma and verdicts to almost nothing, but not readings
_PARTS = ("time_s", "values", "signal", "sigma", "verdicts")
_LATEST_S = 1e11  # a stamp beyond this (year 5138) is not a date


def join_outputs(outputs: Sequence[Output], first_row: int) -> Output | None:
    """Concatenate outputs; return None if they have no rows.

    Raises
    ------
    ValueError
        If the outputs are not consecutive from `first_row` on.
    """
    row = first_row
    for one in outputs:
        if one.first_row != row:
            raise ValueError(f"the rows begin at {one.first_row}, but the next row is {row}")
        row += len(one)
    full = [one for one in outputs if len(one)]
    if len(full) <= 1:
        return full[0] if full else None
    parts: list[Any] = [np.concatenate([getattr(one, part) for one in full]) for part in _PARTS]
    return Output(first_row, *parts)


def pack_rows(output: Output) -> bytes:
    """Return rows as the bytes of an Arrow IPC stream; NaN and infinities keep their bits."""
    channels = output.values.shape[1]
    lists = [_list_array(part, channels) for part in (output.values, output.signal, output.sigma, output.verdicts)]
    batch = pa.record_batch([_flat(output.time_s), *lists], names=["time_s", "raw", "signal", "sigma", "verdict"])
    stream = pa.BufferOutputStream()
    with pa.ipc.new_stream(stream, batch.schema, options=pa.ipc.IpcWriteOptions(**_OPTIONS)) as writer:
        writer.write_batch(batch)
    return bytes(stream.getvalue())


def unpack_rows(block: BlockRow) -> Output:
    """Return the rows of a block, which must not be empty."""
    with pa.ipc.open_stream(block.data) as reader:
        batch = reader.read_next_batch()
    raw, signal, sigma, verdicts = (_matrix(batch.column(number)) for number in range(1, 5))
    time_s: Floats = batch.column(0).to_numpy(zero_copy_only=False)
    return Output(block.first_row, time_s, raw, signal, sigma, verdicts.astype(np.int8, copy=False))


def split_by_period(output: Output, period_s: float, now_s: float) -> Iterator[tuple[int, bool, Output]]:
    """Split rows by hour, or another period; a file of the journal holds the rows of one period.

    Rows whose stamps are not dates, or go back to an earlier period, are not split.

    Yields
    ------
    tuple of (int, bool, Output)
        Start of the period in seconds since 1970, whether it comes from the stamps (else from `now_s`), and the rows.
    """
    stamps = output.time_s
    dated = bool(EPOCH_S <= stamps[0] < _LATEST_S and stamps[-1] < _LATEST_S)
    start = _start(float(stamps[0]) if dated else now_s, period_s)
    if not dated or start <= stamps[-1] < start + period_s:
        yield start, dated, output
        return
    periods = np.floor_divide(stamps, period_s)
    cuts = [0, *(np.flatnonzero(np.diff(periods)) + 1).tolist(), len(output)]
    if not (np.diff(periods) >= 0).all():  # also if a stamp is NaN
        cuts = [0, len(output)]
    for first, end in pairwise(cuts):
        yield _start(float(stamps[first]), period_s), True, _part(output, first, end)


def _start(moment_s: float, period_s: float) -> int:
    return int(floor(moment_s / period_s) * period_s)


def _part(output: Output, first: int, end: int) -> Output:
    cut = {part: getattr(output, part)[first:end] for part in _PARTS}
    return replace(output, first_row=output.first_row + first, losses=(), **cut)


def _list_array(values: Floats | Codes, channels: int) -> pa.FixedSizeListArray:
    return pa.FixedSizeListArray.from_arrays(_flat(values), channels)


def _flat(values: Floats | Codes) -> pa.Array:
    """Return numbers row by row without a copy; `pa.array` would import pandas where it is installed."""
    is_codes = values.dtype == np.int8
    contiguous = np.ascontiguousarray(values, dtype=np.int8 if is_codes else np.float64)
    buffers = [None, pa.py_buffer(contiguous)]
    return pa.Array.from_buffers(pa.int8() if is_codes else pa.float64(), contiguous.size, buffers)


def _matrix(column: Any) -> Any:
    return column.values.to_numpy(zero_copy_only=False).reshape(len(column), column.type.list_size)
