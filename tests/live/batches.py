"""Batches of rows whose readings are their own numbers, so that a row out of place is seen."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.live.messages.reading import MessageRows
from becalm.live.messages.sequence import Sequence


def batch(seq: int, rows: int, began_s: float | None = 0.0, arrived_s: float = 0.0) -> MessageRows:
    """Return rows `seq` and on; stamped a second a row after `began_s`, or not at all."""
    numbers = np.arange(seq, seq + rows, dtype=np.float64)
    return MessageRows(seq, None if began_s is None else began_s + numbers, numbers[:, np.newaxis], arrived_s)


def told(sequence: Sequence) -> Floats:
    """Return the numbers of the rows that are ready, once their batches say the same."""
    numbers = [np.empty(0)]
    for ready in sequence.ready():
        assert ready.seq == ready.values[0, 0]
        numbers.append(ready.values[:, 0])
    return np.concatenate(numbers)
