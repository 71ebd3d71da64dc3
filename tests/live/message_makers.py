"""Messages of rows that hold their own numbers, and a reader of them."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Codes, Floats
from becalm.live.address import Address
from becalm.live.lines.columns import LineOptions
from becalm.live.messages.reading import MessageReader, MessageRows


def reader(options: str = "") -> MessageReader:
    """Return a reader with options as an address has them."""
    return MessageReader(LineOptions.of(Address.parsed(f"udp:9000{options}")))


def columns(rows: int, began_s: float = 0.0) -> dict[str, Floats | Codes]:
    """Return columns of rows that hold their own numbers, stamped 10 ms a row."""
    numbers = np.arange(rows, dtype=np.float64)
    return {"time": began_s + numbers / 100, "ax": numbers, "ay": -numbers}


def good(held: MessageReader, payload: bytes) -> MessageRows:
    """Return what a message holds, which has to be readable."""
    batch = held.read(payload, 1000.0)
    assert batch is not None, held.losses()
    return batch


def arrow(batch: pa.RecordBatch, *more: pa.RecordBatch) -> bytes:
    """Return batches as Arrow's own writer writes a stream."""
    file = BytesIO()
    with pa.ipc.new_stream(file, batch.schema) as stream:
        for part in (batch, *more):
            stream.write_batch(part)
    return file.getvalue()
