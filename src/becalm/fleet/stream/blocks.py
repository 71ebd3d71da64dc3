"""Pack rows of one sensor into bytes, so that Spark moves few binary values instead of single samples."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats, Integers
from becalm.core.snapshot_bytes import packed, unpacked


class UnreadableInput(NamedTuple):
    """The loss of rows, blocks or messages that could not be read."""

    things: int | None  # number of rows, blocks or messages; None if unknown
    says: str  # a sentence on the loss


class SensorRows(NamedTuple):
    """Some rows of a sensor in the order of their source."""

    time_s: Floats  # (B,) stamps in seconds; NaN for a row without one
    values: Floats  # (B, m) readings of the channels, each in its unit; NaN where missing
    units: tuple[str, ...] = ()  # one for each channel; () if unknown
    garbled: tuple[UnreadableInput, ...] = ()  # losses to report with these rows

    def packed(self) -> bytes:
        """Return the rows as bytes."""
        words = json.dumps([self.units, self.garbled], separators=(",", ":")).encode()
        return packed({"time": self.time_s, "values": self.values, "words": np.frombuffer(words, np.int8)})

    @classmethod
    def unpacked(cls, blob: bytes) -> SensorRows:
        """Return the rows from the bytes that `packed` returned."""
        arrays = unpacked(blob)
        units, garbled = json.loads(arrays["words"].tobytes())
        return cls(arrays["time"], arrays["values"], tuple(units), tuple(UnreadableInput(*one) for one in garbled))


class EstimatedBlock(NamedTuple):
    """The estimates for some rows of a sensor."""

    places: Integers  # (k,) indices of the sensor's channels among all channels of the fleet
    time_s: Floats  # (B,) stamps in seconds
    signal: Floats  # (B, k) estimates, each in the unit of its channel
    sigma: Floats  # (B, k) standard deviations of the estimates
    verdicts: Codes  # (B, k) codes of `Verdict`

    def packed(self) -> bytes:
        """Return the estimates as bytes."""
        return packed(self._asdict())

    @classmethod
    def unpacked(cls, blob: bytes) -> EstimatedBlock:
        """Return the estimates from the bytes that `packed` returned."""
        return cls(**unpacked(blob))


class Event(NamedTuple):
    """An event in a sensor's stream, such as lost rows, silence, or another recipe."""

    kind: str  # a value of `becalm.live.block.LossKind`, or "refused", "recipe", "rate", "silent", "back"
    rows: int | None  # number of rows concerned; None if unknown
    says: str  # a sentence on the event
