"""The walk of a stream: read, filter, tell, keep; until it ends or someone stops it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from math import nan

from becalm.cleaning.recipe import Recipe
from becalm.cleaning.stream import ChannelHealth
from becalm.live.block import Block, Checkpoint, Loss, LossKind, Output
from becalm.live.commit_thread import Keeping, Outlets, Transaction
from becalm.live.protocols import Source
from becalm.live.queueing import BlockQueue
from becalm.live.reader import Reader
from becalm.live.retuning import Heard, Retuning
from becalm.live.settings import Settings
from becalm.live.stream import Stream
from becalm.live.stream_start import Beginning, Begun, insist, open_keeper
from becalm.live.watching.watch import Watch

_POLL_S = 0.25
_AT_ONCE = 1024  # rows, of blocks that wait
_MOST_VALUES = 1 << 19  # that one commit holds
_HEALTH_S = 1.0


@dataclass
class Runner:
    """Runs a stream.

    Attributes
    ----------
    source : Source
        Where blocks come from.
    address : str
        Its name, without secrets; a keeper that has another stream's rows is refused.
    outlets : Outlets
        Where rows go.
    watch : Watch
        Hears of all.
    beginning : Beginning
        Where filters come from.
    settings : Settings
        How.
    """

    source: Source
    address: str
    outlets: Outlets
    watch: Watch
    beginning: Beginning
    settings: Settings = field(default_factory=Settings)

    def __post_init__(self) -> None:
        """Make what does not depend on the wires."""
        self._stop, self._retuning = threading.Event(), Retuning()
        self._reader: Reader | None = None
        self._queue = BlockQueue(self.settings.queue_blocks, self.settings.when_full)
        self._outputs: list[Output] = []
        self._losses: list[Loss] = []
        self._position = ""
        self._given_s = 0.0  # time.monotonic() when rows were handed to the keeper last
        self._health_s = 0.0  # and when the meter last heard how channels are
        self.rows = 0
        """Rows told, over the whole life of the stream."""

    def stop(self) -> None:
        """Read no more; filter, tell and keep what was read, and end."""
        self._stop.set()

    def retune(self, recipe: Callable[[], Recipe], heard: Heard = lambda _: None) -> None:
        """Take another recipe for the same channels at the next block, without a jump; one that cannot be is refused.

        The recipe is read later. Of several asked for meanwhile the last is taken,
        and the others hear so.
        """
        self._retuning.ask(recipe, heard)

    def run(self) -> None:
        """Run until the source ends, or someone stops.

        Raises
        ------
        BecalmError
            If the source or a sink can never be reached, or something could not be kept; all else is kept.
        """
        keeper = self.outlets.keeper
        last = None if keeper is None else insist(keeper.last, self.watch, self._stop)
        begun = None if last is None else self._resumed(last)
        reader = self._reader = Reader(self.source, self._queue, self.watch, self._position)
        reader.start()
        keeping: Keeping | None = None
        try:
            begun = begun or self._begun()
            if begun is not None:
                keeping = self._open(begun)
                try:
                    self._walk(begun, keeping)
                finally:
                    self._give(begun.stream, keeping, at_once=True)
            self.watch.state("stopping" if self._stop.is_set() else "ended")
        finally:
            reader.stop()
            try:
                if keeping is not None:
                    keeping.finish(self.settings.patience_s)
            finally:
                self._close(reader)

    def _resumed(self, last: Checkpoint) -> Begun:
        begun = self.beginning.resumed(last, self.address)
        if self.beginning.timed is not None:
            self.source = self.beginning.timed(begun.stream.recipe)
        self._position = last.position
        if not self.source.replays:
            says = (
                "becalm was not running; what was sent meanwhile is lost, unless the sender keeps it and sends it yet."
            )
            self._losses.append(Loss(LossKind.GAP, None, says))
        return begun

    def _begun(self) -> Begun | None:
        begun = None
        try:
            begun = self.beginning.begun(self._next, self._queue, self.source, self.watch)
        finally:
            if begun is None:  # whose first rows would have told them
                self.watch.lost(self._losses)
        return begun

    def _open(self, begun: Begun) -> Keeping:
        head = begun.head
        if self.outlets.keeper is not None:
            insist(partial(open_keeper, self.outlets.keeper, head), self.watch, self._stop)
        for outlet in self.outlets.others:
            outlet.open(head)
        self.watch.meter.begin(head.names, begun.stream.recipe.to_toml())
        self.watch.state("running")
        self._given_s = time.monotonic()
        return Keeping(self.outlets, self.source, self.watch, head)

    def _walk(self, begun: Begun, keeping: Keeping) -> None:
        stream = begun.stream
        if begun.before:
            self._pass_on(stream.take(Block.of_losses(*begun.before)))
        for early in begun.blocks:
            self._take(early, stream, keeping)
        while not self._queue.ended:
            self._retuning.take(stream, self.watch)
            block = self._next()
            if block is not None:
                self._take(block, stream, keeping)
            self._give(stream, keeping)
            self._look_after(stream)
        if not self._stop.is_set():
            self._tell(stream.finish())

    def _next(self) -> Block | None:
        if self._stop.is_set() and self._reader is not None:
            self._reader.stop()
        block = self._queue.get(_POLL_S, _AT_ONCE)
        self._losses += self.watch.turned(block is not None)
        self.watch.meter.queued(*self._queue.depth)
        return block

    def _take(self, block: Block, stream: Stream, keeping: Keeping) -> None:
        self._tell(stream.take(block))
        self._position = block.position or self._position
        if sum(output.values.size for output in self._outputs) >= _MOST_VALUES:
            self._give(stream, keeping, at_once=True)

    def _tell(self, output: Output) -> None:
        if self._losses:
            output, self._losses = replace(output, losses=(*self._losses, *output.losses)), []
        if not (len(output) or output.losses):
            return
        self._pass_on(output)
        self.watch.told(output)

    def _pass_on(self, output: Output) -> None:
        self.rows = output.first_row + len(output)
        self._outputs.append(output)  # first: a sink that fails for good does not keep it from being kept
        for outlet in self.outlets.others:
            outlet.write(output)

    def _give(self, stream: Stream, keeping: Keeping, *, at_once: bool = False) -> None:
        """Hand over what was told since the last time, if it is time."""
        now = time.monotonic()
        if not at_once and now - self._given_s < self.settings.commit_s:
            return
        self._given_s = now
        if self._outputs:
            outputs, self._outputs = self._outputs, []
            keeping.give(Transaction(outputs, stream.checkpoint(self._position, self.address)))
        self._losses += keeping.losses()

    def _look_after(self, stream: Stream) -> None:
        now = time.monotonic()
        if now - self._health_s >= _HEALTH_S:
            self._health_s = now
            for channel in stream.health():
                self.watch.meter.health(channel.name, nan if channel.nis is None else channel.nis, _alarms(channel))

    def _close(self, reader: Reader) -> None:
        reader.join()
        for outlet in self.outlets.others:
            outlet.close()
        if self.outlets.keeper is not None:
            self.outlets.keeper.close()


def _alarms(channel: ChannelHealth) -> list[str]:
    drift = channel.drift_since_row
    return [*([] if drift is None else [f"drifts since row {drift}"]), *(["is dead"] if channel.dead else [])]
