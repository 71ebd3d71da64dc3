"""Start a stream: from its checkpoint, with a recipe, or with one that is tuned on its first rows."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from becalm.cleaning.recipe import Recipe
from becalm.errors import BecalmError, UsageError
from becalm.live.block import Block, Checkpoint, Head, Loss
from becalm.live.learning import Early, Learner, resolution_of
from becalm.live.protocols import AwayError, Keeper, Source
from becalm.live.queueing import BlockQueue
from becalm.live.reader import BackOff
from becalm.live.stream import Stream
from becalm.live.watching.watch import Watch

Answer = TypeVar("Answer")


class Begun(NamedTuple):
    """A stream that has its filters, and what came before it had them.

    Attributes
    ----------
    stream : Stream
        From its first row, or from where it stood.
    head : Head
        What sinks are told that all rows share.
    blocks : list of Block
        What came already, from the first row on.
    before : list of Loss
        What happened before the first row; the watch has heard of it.
    """

    stream: Stream
    head: Head
    blocks: list[Block]
    before: list[Loss]


@dataclass(frozen=True)
class Beginning:
    """Where a stream gets its filters from.

    Attributes
    ----------
    recipe : Recipe or None
        What to do; None goes on as before, or learns.
    learner : Learner
        Learns where nobody says what to do.
    learned : callable
        Is given a recipe that was learned, to save it.
    timed : callable or None
        Makes the source anew by the recipe that a stream had, which may tell how its rows are timed.
    """

    recipe: Recipe | None
    learner: Learner
    learned: Callable[[Recipe], None] = lambda _: None
    timed: Callable[[Recipe], Source] | None = None

    def resumed(self, last: Checkpoint, address: str) -> Begun:
        """Go on from a checkpoint, by another recipe if there is one.

        Raises
        ------
        UsageError
            If it is of the stream of another source.
        BecalmError
            If it is damaged, or the recipe does not fit the stream.
        """
        if last.source.partition("?")[0] != address.partition("?")[0]:
            raise UsageError(
                f"What is kept there is the stream {last.source}, not {address}; name another place for this one."
            )
        stream = Stream.resumed(last)
        head = stream.head  # that it had
        if self.recipe is not None and self.recipe != stream.recipe:
            stream.retuned(self.recipe)
        stream.opened()
        return Begun(stream, head, [], [])

    def begun(
        self, following: Callable[[], Block | None], queue: BlockQueue, source: Source, watch: Watch
    ) -> Begun | None:
        """Wait for the first rows, or for enough to learn from; None where the source ended before.

        Parameters
        ----------
        following : callable
            Waits a while for the next block of the queue.
        queue : BlockQueue
            Whether more may come.
        source : Source
            Which may know the rate.
        watch : Watch
            Hears what was lost where no stream can tell it.

        Raises
        ------
        BecalmError
            If nothing can be learned from what came.
        """
        early, stream, before = Early(), None, list[Loss]()
        watch.state("learning" if self.recipe is None else "running")
        ended = False
        try:
            while stream is None and not ended:
                block = following()
                if block is not None and (len(block) or early.rows):
                    early.add(block)
                elif block is not None:
                    watch.lost(block.losses)
                    before += block.losses
                ended = queue.closed
                stream = self._stream_of(early, source.rate_hz, ended=ended)
        except BecalmError:
            if ended:  # a reader that failed is why there is too little
                queue.raise_failure()
            raise
        finally:
            if stream is None:  # which would have told them
                watch.lost([loss for one in early.blocks for loss in one.losses])
        if stream is None:
            queue.raise_failure()
            return None
        return Begun(stream, stream.head, early.blocks, before)

    def _stream_of(self, early: Early, rate_hz: float | None, *, ended: bool) -> Stream | None:
        """Make a stream of what came; None where that is not enough yet."""
        if self.recipe is not None and early.rows:
            first = next(one for one in early.blocks if len(one))
            resolution_s = 0.0 if first.elapsed is not None else resolution_of(first.time_s)
            return Stream(self.recipe, 1 / (rate_hz or self.recipe.nominal_rate_hz), resolution_s)
        if self.recipe is None and ((ended and early.rows) or self.learner.is_enough(early, rate_hz)):
            learned = self.learner.learn(early.blocks, rate_hz)
            self.learned(learned.recipe)
            return Stream(learned.recipe, learned.step_s, learned.resolution_s)
        return None


def open_keeper(keeper: Keeper, head: Head) -> None:
    """Open a keeper; one that went away since it told the last checkpoint is reached once more.

    Raises
    ------
    AwayError
        If it cannot be reached now.
    BecalmError
        If it never can, or keeps another stream.
    """
    try:
        keeper.open(head)
    except AwayError:
        keeper.close()
        keeper.last()
        keeper.open(head)


def insist(do: Callable[[], Answer], watch: Watch, stop: threading.Event) -> Answer:
    """Do something until its other end is there.

    Raises
    ------
    AwayError
        If someone stops before.
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
