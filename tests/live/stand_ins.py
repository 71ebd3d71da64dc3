"""Sources and keepers of the tests' own: blocks from a list, kept in memory, with trouble on demand."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.live.block import Block, Checkpoint, Head, Output
from becalm.live.protocols import EndOfStream

RATE_HZ = 100.0


def recipe_of(names: Sequence[str] = ("ax", "ay"), **more: object) -> Recipe:
    channels = tuple(
        ChannelRecipe(name=name, model="motion", order=2, process_noise_density=0.5, noise_std=0.1 * (number + 1))
        for number, name in enumerate(names)
    )
    return Recipe(mode="causal", tuned_on=Origin(rate_hz=RATE_HZ), channel=channels).model_copy(update=more)


def drive(rows: int, channels: int = 2, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    slow = np.cumsum(np.cumsum(rng.normal(0, 1e-3, (rows, channels)), axis=0), axis=0)
    return np.asarray(slow + rng.normal(0, 0.1, (rows, channels)))


def blocks_of(values: Floats, sizes: int | Sequence[int], first: int = 0, *, elapsed: bool = False) -> list[Block]:
    """Cut rows at 100 Hz into blocks; sizes repeat."""
    cycle = [sizes] if isinstance(sizes, int) else list(sizes)
    names, at = tuple(("ax", "ay", "az", "gx")[: values.shape[1]]), first
    blocks: list[Block] = []
    while at < len(values):
        stop = min(at + cycle[len(blocks) % len(cycle)], len(values))
        steps = np.ones(stop - at)
        if at == 0:
            steps[0] = 0.0
        position = json.dumps({"row": stop})
        stamps = np.arange(at, stop) / RATE_HZ
        told = steps if elapsed else None
        blocks.append(Block(names, ("",) * len(names), stamps, values[at:stop].copy(), position, told))
        at = stop
    return blocks


class ListSource:
    """Gives blocks from a list, or from what a maker returns for the row to go on after."""

    rate_hz: float | None = None

    def __init__(self, make: Callable[[int], list[Block]], *, replays: bool = True, ends: bool = True) -> None:
        self._make, self.replays, self._ends = make, replays, ends
        self._blocks: list[Block] = []
        self.acknowledged: list[str] = []
        self.opened: list[str] = []
        self.trouble: list[BaseException] = []
        self._idle = threading.Event()

    def open(self, position: str) -> None:
        self.opened.append(position)
        self._fail()
        self._blocks = self._make(json.loads(position)["row"] if position else 0)

    def read(self, timeout_s: float) -> Block | None:
        self._fail()
        if self._blocks:
            return self._blocks.pop(0)
        if self._ends:
            raise EndOfStream
        self._idle.wait(min(timeout_s, 0.01))
        return None

    def _fail(self) -> None:
        if self.trouble:
            raise self.trouble.pop(0)

    def committed(self, position: str) -> None:
        self.acknowledged.append(position)

    def close(self) -> None:
        self._blocks = []


class MemoryKeeper:
    """Keeps everything in memory; raises what `trouble` holds first."""

    def __init__(self) -> None:
        self.outputs: list[Output] = []
        self.checkpoint: Checkpoint | None = None
        self.trouble: list[BaseException] = []
        self.heads: list[Head] = []
        self.closed = 0
        self.keeps_before_trouble = False

    def last(self) -> Checkpoint | None:
        return self.checkpoint

    def open(self, head: Head) -> None:
        if self.checkpoint is not None and self.checkpoint.recipe != head.recipe:
            raise UsageError("A stream that goes on has the head that it had.")
        self.heads.append(head)

    def commit(self, outputs: list[Output], checkpoint: Checkpoint) -> None:
        if self.trouble:
            if self.keeps_before_trouble:
                self._keep(outputs, checkpoint)
            raise self.trouble.pop(0)
        self._keep(outputs, checkpoint)

    def _keep(self, outputs: list[Output], checkpoint: Checkpoint) -> None:
        self.outputs += outputs
        self.checkpoint = checkpoint

    def close(self) -> None:
        self.closed += 1

    @property
    def signal(self) -> Floats:
        return np.concatenate([output.signal for output in self.outputs])

    @property
    def sigma(self) -> Floats:
        return np.concatenate([output.sigma for output in self.outputs])

    @property
    def rows(self) -> Floats:
        firsts = [np.arange(output.first_row, output.first_row + len(output)) for output in self.outputs]
        return np.concatenate(firsts)

    @property
    def losses(self) -> list[tuple[str, int | None]]:
        return [(loss.kind.value, loss.rows) for output in self.outputs for loss in output.losses]


class MemorySink:
    """Gets everything; goes away on demand."""

    def __init__(self) -> None:
        self.got: list[Output] = []
        self.flushed = 0
        self.trouble_writing: list[BaseException] = []
        self.trouble_flushing: list[BaseException] = []
        self.opens = 0

    def open(self, head: Head) -> None:
        self.opens += 1

    def write(self, output: Output) -> None:
        if self.trouble_writing:
            raise self.trouble_writing.pop(0)
        self.got.append(replace(output))

    def flush(self) -> None:
        if self.trouble_flushing:
            raise self.trouble_flushing.pop(0)
        self.flushed += 1

    def close(self) -> None:
        return
