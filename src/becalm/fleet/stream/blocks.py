"""What the engine carries: rows of one sensor as bytes, so that it moves a few things, and no sample by itself."""

from __future__ import annotations

import json
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats, Integers
from becalm.core.snapshot_bytes import packed, unpacked


class Garbled(NamedTuple):
    """Something that could not be read."""

    things: int | None  # how many: rows, blocks, messages; None where nobody can know
    says: str  # one sentence


class SensorRows(NamedTuple):
    """Some rows of a sensor as they came."""

    time_s: Floats  # (B,) NaN of a row without a stamp
    values: Floats  # (B, m) NaN where missing
    units: tuple[str, ...] = ()  # of the channels; () where nothing tells any
    garbled: tuple[Garbled, ...] = ()

    def packed(self) -> bytes:
        """Return them as bytes."""
        words = json.dumps([self.units, self.garbled], separators=(",", ":")).encode()
        return packed({"time": self.time_s, "values": self.values, "words": np.frombuffer(words, np.int8)})

    @classmethod
    def unpacked(cls, blob: bytes) -> SensorRows:
        """Return what `packed` held."""
        arrays = unpacked(blob)
        units, garbled = json.loads(arrays["words"].tobytes())
        return cls(arrays["time"], arrays["values"], tuple(units), tuple(Garbled(*one) for one in garbled))


class EstimatedBlock(NamedTuple):
    """What is told of some rows."""

    places: Integers  # (k,) where its channels stand among those of the fleet
    time_s: Floats  # (B,)
    signal: Floats  # (B, k)
    sigma: Floats  # (B, k)
    verdicts: Codes  # (B, k)

    def packed(self) -> bytes:
        """Return it as bytes."""
        return packed(self._asdict())

    @classmethod
    def unpacked(cls, blob: bytes) -> EstimatedBlock:
        """Return what `packed` held."""
        return cls(**unpacked(blob))


class Event(NamedTuple):
    """Something that befell a sensor's stream."""

    kind: str  # a kind of `becalm.live.block.LossKind`, or "refused", "recipe", "silent", "back"
    rows: int | None  # how many rows it touched; None where nobody can know
    says: str  # one sentence
