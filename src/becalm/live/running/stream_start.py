"""Start a stream: from its checkpoint, with a given recipe, or with a recipe tuned on its first rows."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np

from becalm.cleaning.recipes.recipe import Recipe
from becalm.errors import BecalmError, UsageError
from becalm.live.block import Block, Checkpoint, Head, Loss
from becalm.live.protocols import AwayError, CheckpointSink, Source
from becalm.live.running.learning_buffer import FEW_STAMPS, Learner, LearningBuffer, resolution_of
from becalm.live.running.queueing import BlockQueue
from becalm.live.running.reader import BackOff
from becalm.live.stream import Stream
from becalm.live.watching.watch import Watch

_LONGEST_WAIT_S = 10.0  # longest time that a stream with a recipe waits for the resolution of its stamps

Result = TypeVar("Result")


class StartedStream(NamedTuple):
    """A stream that has its filters, with the blocks that arrived before the filters were ready.

    Attributes
    ----------
    stream : Stream
        A new stream, or one restored from its checkpoint.
    head : Head
        Names, units, rate and recipe for the sinks.
    blocks : list of Block
        Blocks that already arrived, from the first row on.
    early_losses : list of Loss
        Losses before the first row; the watch has already recorded them.
    """

    stream: Stream
    head: Head
    blocks: list[Block]
    early_losses: list[Loss]


@dataclass(frozen=True)
class StreamStarter:
    """Makes the filters of a stream, from a checkpoint, a recipe or the first rows.

    Attributes
    ----------
    recipe : Recipe or None
        Recipe to use; with None a resumed stream keeps its own recipe, and a new stream learns one.
    learner : Learner
        Tunes a recipe on the first rows if there is none.
    on_learned : callable
        Called with a learned recipe, to save it.
    make_source : callable or None
        Makes the source of a resumed stream from the stream's recipe, which may define how rows are timed.
    """

    recipe: Recipe | None
    learner: Learner
    on_learned: Callable[[Recipe], None] = lambda _: None
    make_source: Callable[[Recipe], Source] | None = None

    def resume(self, last: Checkpoint, address: str) -> StartedStream:
        """Continue from a checkpoint, with another recipe if one is given.

        Raises
        ------
        UsageError
            If the checkpoint belongs to a stream of another source, or has not the lag or channels that are asked for.
        BecalmError
            If the checkpoint is damaged, or the recipe does not fit the stream.
        """
        if last.source.partition("?")[0] != address.partition("?")[0]:
            raise UsageError(
                f"The checkpoint there belongs to the stream {last.source}, not {address}; choose another place for"
                " this stream."
            )
        stream = Stream.resumed(last)
        if self.recipe is None:
            self.learner.check_learned(stream.recipe)
        head = stream.head  # before retuning: sinks keep the head that the stream began with
        if self.recipe is not None and self.recipe != stream.recipe:
            stream.retune(self.recipe)
        stream.notify_source_opened()
        return StartedStream(stream, head, [], [])

    def start_new(
        self, next_block: Callable[[], Block | None], queue: BlockQueue, source: Source, watch: Watch
    ) -> StartedStream | None:
        """Wait for the first rows, or for enough rows to learn from; return None if the source ends without rows.

        Parameters
        ----------
        next_block : callable
            Returns the next block of the queue, or None after a timeout.
        queue : BlockQueue
            Queue between reader and filters; it knows when the source has ended.
        source : Source
            Source that is read; it may know the rate.
        watch : Watch
            Records the losses if no stream starts that could report them.

        Raises
        ------
        BecalmError
            If no recipe can be learned from the rows.
        """
        early, stream, before = LearningBuffer(), None, list[Loss]()
        watch.state("learning" if self.recipe is None else "running")
        ended = False
        try:
            while stream is None and not ended:
                block = next_block()
                if block is not None and (len(block) or early.rows):
                    early.add(block)
                elif block is not None:
                    watch.record_losses(block.losses)
                    before += block.losses
                ended = queue.closed
                stream = self._stream_of(early, source.rate_hz, ended=ended)
        except BecalmError:
            if ended:  # if the reader failed, its error is the cause of having too few rows
                queue.raise_failure()
            raise
        finally:
            if stream is None:  # no output will carry the losses
                watch.record_losses([loss for one in early.blocks for loss in one.losses])
        if stream is None:
            queue.raise_failure()
            return None
        return StartedStream(stream, stream.head, early.blocks, before)

    def _stream_of(self, early: LearningBuffer, rate_hz: float | None, *, ended: bool) -> Stream | None:
        """Make a stream from the first blocks; return None if they are not enough yet.

        The resolution of stamps is that of the first rows, however many come with them, so that any cut gives the same.
        A stream slower than 2 Hz does not wait for them; the rounding of its stamps is small against its steps.
        """
        is_timed = early.steps is not None  # by the source, and not by stamps
        if self.recipe is not None:
            step_s = 1 / (rate_hz or self.recipe.nominal_rate_hz)
            needed = FEW_STAMPS if FEW_STAMPS * step_s <= _LONGEST_WAIT_S else 1
            if early.rows >= needed or (early.rows and (ended or is_timed)):
                stamps = np.concatenate([one.time_s for one in early.blocks])[:needed]
                return Stream(self.recipe, step_s, 0.0 if is_timed else resolution_of(stamps))
        if self.recipe is None and ((ended and early.rows) or self.learner.is_enough(early, rate_hz)):
            learned = self.learner.learn(early.blocks, rate_hz)
            self.on_learned(learned.recipe)
            return Stream(learned.recipe, learned.step_s, learned.resolution_s)
        return None


def open_checkpoint_sink(checkpoint_sink: CheckpointSink, head: Head) -> None:
    """Open a checkpoint sink; if the connection was lost since its last checkpoint was read, connect once more.

    Raises
    ------
    AwayError
        If the sink cannot be reached now.
    BecalmError
        If the sink can never be reached, or holds another stream.
    """
    try:
        checkpoint_sink.open(head)
    except AwayError:
        checkpoint_sink.close()
        checkpoint_sink.last()
        checkpoint_sink.open(head)


def retry_until_reachable(do: Callable[[], Result], watch: Watch, stop: threading.Event) -> Result:
    """Call `do` until its server can be reached, with back-off between the attempts; return its result.

    Raises
    ------
    AwayError
        If `stop` is set before the server is reached.
    """
    back_off = BackOff()
    while True:
        try:
            return do()
        except AwayError as cause:
            watch.state("away", str(cause))
            if stop.is_set():
                raise
        back_off.wait(stop)
