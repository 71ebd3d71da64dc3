"""Rows to send through brokers, what comes of them, and waiting for it."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from becalm.core.arrays import Floats
from becalm.live.block import Block, Head, Loss, LossKind, Output
from becalm.live.messages.encoding import Encoder
from becalm.live.protocols import AwayError, Sink, Source
from brokers import DEADLINE_S

HEAD = Head(("ax", "ay"), ("m/s^2", "g"), 100.0, "")
ENCODER = Encoder("arrow", {"ax": "m/s^2", "ay": "g"})


def rows(first: int, count: int) -> dict[str, Floats]:
    """Return rows whose readings tell their numbers: ax is the number, ay its half."""
    number = np.arange(first, first + count, dtype=float)
    return {"time": number / 100, "ax": number, "ay": number / 2}


def message(first: int, count: int) -> bytes:
    """Return these rows as a message."""
    return ENCODER.message(rows(first, count), first)


def output(first: int, count: int) -> Output:
    """Return these rows as sinks get them."""
    told = rows(first, count)
    signal = np.stack([told["ax"], told["ay"]], axis=1)
    return Output(first, told["time"], signal + 0.1, signal, np.full_like(signal, 0.5), np.zeros(signal.shape, np.int8))


def among_garbage() -> list[bytes]:
    """Return ten rows as two messages, and five between them that hold none."""
    good = message(0, 5)
    return [good, b"", b"\x00" * 50, good[: len(good) // 2], b'{"seq": 5}', b"[" * 5000, message(5, 5)]


class Heard:
    """What a source told: all blocks, in order."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.blocks: list[Block] = []
        self.returns = 0
        """How often it was opened again, after its broker was away."""

    @property
    def numbers(self) -> list[int]:
        """The numbers of the rows that came."""
        return [int(value) for block in self.blocks if len(block) for value in block.values[:, 0]]

    @property
    def losses(self) -> list[Loss]:
        """All that happened to the stream."""
        return [loss for block in self.blocks for loss in block.losses]

    @property
    def position(self) -> str:
        """Where the last block ends."""
        return self.blocks[-1].position if self.blocks else ""

    def count(self, kind: LossKind) -> int:
        """Return how many rows a kind of loss touched."""
        return sum(loss.rows or 0 for loss in self.losses if loss.kind is kind)

    def assert_garbage_was_counted(self) -> None:
        """Check what came of `among_garbage`."""
        assert self.numbers == list(range(10))
        assert self.count(LossKind.GARBLED) == 5
        assert {loss.kind for loss in self.losses} == {LossKind.GARBLED}

    def until(self, ready: Callable[[], bool], *, commit: bool = True) -> None:
        """Read until something is so, opening again after the broker was away, as a runner does."""
        end = time.monotonic() + DEADLINE_S
        while not ready():
            assert time.monotonic() < end, f"{len(self.numbers)} rows came, and {self.losses}"
            try:
                block = self.source.read(0.1)
            except AwayError:
                reopened(self.source, self.position)
                self.returns += 1
                continue
            if block is not None:
                self.blocks.append(block)
                if commit:
                    self.source.committed(block.position)


def reopened(source: Source, position: str) -> None:
    """Open a source again and again until its broker is there."""
    end = time.monotonic() + DEADLINE_S
    while True:
        source.close()
        try:
            return source.open(position)
        except AwayError:
            assert time.monotonic() < end, "the broker did not come back"
            time.sleep(0.05)


def flushed(sink: Sink, head: Head = HEAD) -> None:
    """Flush a sink, opening it again until all is out, as a runner does."""
    end = time.monotonic() + DEADLINE_S
    while True:
        try:
            return sink.flush()
        except AwayError:
            assert time.monotonic() < end, "the broker did not come back"
        try:
            sink.open(head)
        except AwayError:
            time.sleep(0.05)
