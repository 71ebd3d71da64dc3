"""The walk of a stream: read, learn if need be, filter, tell, keep; until it ends or someone stops it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from math import nan
from typing import TypeVar

from becalm.cleaning.recipe import Recipe
from becalm.cleaning.stream import ChannelHealth
from becalm.errors import UsageError
from becalm.live.block import Block, Checkpoint, Head, Loss, LossKind, Output
from becalm.live.keeping import Batch, Keeping, Outlets
from becalm.live.learning import Early, Learner, resolution_of
from becalm.live.protocols import AwayError, Source
from becalm.live.queueing import BlockQueue
from becalm.live.reader import BackOff, Reader
from becalm.live.retuning import Heard, Retuning
from becalm.live.settings import Settings
from becalm.live.stream import Stream
from becalm.live.watching.watch import Watch

_POLL_S = 0.25
_MOST_VALUES = 1 << 19  # that one commit holds
_HEALTH_S = 1.0

Answer = TypeVar("Answer")


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
    recipe : Recipe or None
        What to do; None goes on as before, or learns.
    learner : Learner
        Learns where nobody says what to do.
    learned : callable
        Is given a recipe that was learned, to save it.
    settings : Settings
        How.
    ready : callable
        Returns once kernels may run; called beside the opening of the source.
    """

    source: Source
    address: str
    outlets: Outlets
    watch: Watch
    recipe: Recipe | None
    learner: Learner
    learned: Callable[[Recipe], None] = lambda _: None
    settings: Settings = field(default_factory=Settings)
    ready: Callable[[], object] = lambda: None

    def __post_init__(self) -> None:
        """Make what does not depend on the wires."""
        self._stop, self._retuning = threading.Event(), Retuning()
        self._reader: Reader | None = None
        self._head: Head | None = None
        self._queue = BlockQueue(self.settings.queue_blocks, self.settings.when_full)
        self._outputs: list[Output] = []
        self._losses: list[Loss] = []
        self._before: list[Loss] = []  # of before the first row, which were said already
        self._position = ""
        self._given_s = self._health_s = 0.0
        self.rows = 0
        """Rows told, over the whole life of the stream."""

    def stop(self) -> None:
        """Read no more; filter, tell and keep what was read, and end. May be called by a signal's handler."""
        self._stop.set()

    def retune(self, recipe: Callable[[], Recipe], heard: Heard = lambda _: None) -> None:
        """Take another recipe for the same channels at the next block, without a jump; one that cannot be is refused.

        May be called by a signal's handler: the recipe is read later. Of several asked for meanwhile the last is taken.
        """
        self._retuning.ask(recipe, heard)

    def run(self) -> None:
        """Run until the source ends, or someone stops.

        Raises
        ------
        BecalmError
            If the source or a sink can never be reached, or something could not be kept; all else is kept.
        """
        last = None if self.outlets.keeper is None else self._insist(self.outlets.keeper.last)
        stream = None if last is None else self._resumed(last)
        reader = self._reader = Reader(self.source, self._queue, self.watch, self._position)
        reader.start()
        keeping: Keeping | None = None
        try:
            held: list[Block] = []
            if stream is None:
                stream, held = self._begun()
            if stream is not None:
                keeping = self._open(stream)
                try:
                    self._walk(stream, keeping, held)
                finally:
                    self._give(stream, keeping, at_once=True)
        finally:
            reader.stop()
            try:
                if keeping is not None:
                    keeping.finish(self.settings.patience_s)
            finally:
                self._close(reader)

    def _resumed(self, last: Checkpoint) -> Stream:
        if last.source.partition("?")[0] != self.address.partition("?")[0]:
            raise UsageError(
                f"What is kept there is the stream {last.source}, not {self.address}; name another place for this one."
            )
        self.ready()
        stream = Stream.resumed(last)
        self._head = stream.head  # that it had
        if self.recipe is not None and self.recipe != stream.recipe:
            stream.retuned(self.recipe)
        stream.opened()
        self._position = last.position
        if not self.source.replays:
            says = (
                "becalm was not running; what was sent meanwhile is lost, unless the sender keeps it and sends it yet."
            )
            self._losses.append(Loss(LossKind.GAP, None, says))
        return stream

    def _begun(self) -> tuple[Stream | None, list[Block]]:
        """Wait for the first rows; make a stream by the recipe, or by one learned from them."""
        early, stream = Early(), None
        self.watch.state("learning" if self.recipe is None else "running")
        try:
            stream = self._first_stream(early)
        finally:
            if stream is None:  # which would have told them
                self.watch.lost([*self._losses, *(loss for block in early.blocks for loss in block.losses)])
        if stream is None:
            self.watch.state("stopping" if self._stop.is_set() else "ended")
        return stream, early.blocks

    def _first_stream(self, early: Early) -> Stream | None:
        while True:
            block = self._next()
            if block is not None and (len(block) or early.rows):
                early.add(block)
            elif block is not None:
                self.watch.lost(block.losses)
                self._before += block.losses
            rate_hz = self.source.rate_hz
            if self.recipe is not None and early.rows:
                first = next(one for one in early.blocks if len(one))
                self.ready()
                resolution_s = 0.0 if first.elapsed is not None else resolution_of(first.time_s)
                return Stream(self.recipe, 1 / (rate_hz or self.recipe.nominal_rate_hz), resolution_s)
            ended = self._queue.ended
            if self.recipe is None and ((ended and early.rows) or self.learner.is_enough(early, rate_hz)):
                learned = self.learner.learn(early.blocks, rate_hz)
                self.learned(learned.recipe)
                return Stream(learned.recipe, learned.step_s, learned.resolution_s)
            if ended:
                return None

    def _open(self, stream: Stream) -> Keeping:
        head = self._head or stream.head
        self._insist(partial(self._open_keeper, head))
        for outlet in self.outlets.others:
            outlet.open(head)
        self.watch.meter.begin(head.names, stream.recipe.to_toml())
        self.watch.state("running")
        self._given_s = time.monotonic()
        return Keeping(self.outlets, self.source, self.watch, head)

    def _open_keeper(self, head: Head) -> None:
        keeper = self.outlets.keeper
        if keeper is None:
            return
        try:
            keeper.open(head)
        except AwayError:
            keeper.close()
            keeper.last()
            keeper.open(head)

    def _insist(self, do: Callable[[], Answer]) -> Answer:
        """Do something at the start of a stream until its other end is there, or someone stops."""
        back_off = BackOff()
        while True:
            try:
                return do()
            except AwayError as cause:
                self.watch.state("away", str(cause))
                if self._stop.is_set():
                    raise
            back_off.wait(self._stop)

    def _walk(self, stream: Stream, keeping: Keeping, held: list[Block]) -> None:
        if self._before:
            self._pass_on(stream.take(Block.of_losses(*self._before)))
        for early in held:
            self._take(early, stream, keeping)
        while not self._queue.ended:
            self._retuning.take(stream, self.watch)
            block = self._next()
            if block is not None:
                self._take(block, stream, keeping)
            self._give(stream, keeping)
            self._look_after(stream)
        self.watch.state("stopping" if self._stop.is_set() else "ended")
        if not self._stop.is_set():
            self._tell(stream.finish())

    def _next(self) -> Block | None:
        if self._stop.is_set() and self._reader is not None:
            self._reader.stop()
        block = self._queue.get(_POLL_S)
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
            keeping.give(Batch(outputs, stream.checkpoint(self._position, self.address)))
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
