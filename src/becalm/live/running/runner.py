"""Run a stream: read, filter, write and commit until the source ends or the stream is stopped."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from math import nan

from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.streaming.stream import ChannelHealth
from becalm.live.block import Block, Checkpoint, Loss, LossKind, Output
from becalm.live.protocols import Source
from becalm.live.running.commit_thread import CommitThread, StreamSinks, Transaction
from becalm.live.running.queueing import BlockQueue
from becalm.live.running.reader import Reader
from becalm.live.running.retuning import RetuneCallback, Retuning
from becalm.live.running.settings import Settings
from becalm.live.running.stream_start import StartedStream, StreamStarter, open_checkpoint_sink, retry_until_reachable
from becalm.live.stream import Stream
from becalm.live.watching.watch import Watch

_POLL_S = 0.25  # longest wait for a block, in seconds
_JOINED_ROWS = 1024  # queued blocks are filtered together up to this many rows
_MOST_VALUES = 1 << 19  # readings that wait for a commit; more are committed before the interval ends
_HEALTH_S = 1.0  # interval at which the meter gets the health of the channels, in seconds


@dataclass
class Runner:
    """Runs a stream, from its source through its filters to its sinks.

    Attributes
    ----------
    source : Source
        Source of the blocks.
    address : str
        The source's address without secrets; a checkpoint sink that holds another source's rows is refused.
    sinks : StreamSinks
        Checkpoint sink and other sinks that get the rows.
    watch : Watch
        Records states, counts and losses.
    starter : StreamStarter
        Makes the filters.
    settings : Settings
        Commit interval, queue and patience.
    """

    source: Source
    address: str
    sinks: StreamSinks
    watch: Watch
    starter: StreamStarter
    settings: Settings = field(default_factory=Settings)

    def __post_init__(self) -> None:
        """Make the queue and the state; nothing is opened yet."""
        self._stop, self._retuning = threading.Event(), Retuning()
        self._reader: Reader | None = None
        self._queue = BlockQueue(self.settings.queue_blocks, self.settings.when_full)
        self._outputs: list[Output] = []
        self._losses: list[Loss] = []
        self._position = ""
        self._submitted_s = 0.0  # time.monotonic() when rows were last passed to the commit thread
        self._health_s = 0.0  # time.monotonic() when the meter last got the health of the channels
        self.rows = 0
        """Number of rows returned since the stream was first started."""

    def stop(self) -> None:
        """Stop reading; rows that were read are filtered, written and committed, then the run ends."""
        self._stop.set()

    def retune(self, recipe: Callable[[], Recipe], on_result: RetuneCallback = lambda _: None) -> None:
        """Request another recipe for the same channels, used from the next block on without a jump of the signal.

        `recipe` is called later and returns the recipe; `on_result` is a `RetuneCallback`. If several recipes are
        requested before one is applied, the last one wins.
        """
        self._retuning.ask(recipe, on_result)

    def run(self) -> None:
        """Run until the source ends or `stop` is called.

        Raises
        ------
        BecalmError
            If the source or a sink can never be reached, or rows could not be committed; all other rows are committed.
        """
        checkpoint_sink = self.sinks.checkpoint_sink
        last = None if checkpoint_sink is None else retry_until_reachable(checkpoint_sink.last, self.watch, self._stop)
        started = None if last is None else self._resume(last)
        reader = self._reader = Reader(self.source, self._queue, self.watch, self._position)
        reader.start()
        commit_thread: CommitThread | None = None
        try:
            started = started or self._begin()
            if started is not None:
                commit_thread = self._open(started)
                try:
                    self._filter_all(started, commit_thread)
                finally:
                    self._commit(started.stream, commit_thread, at_once=True)
            self.watch.state("stopping" if self._stop.is_set() else "ended")
        finally:
            reader.stop()
            try:
                if commit_thread is not None:
                    commit_thread.finish(self.settings.patience_s)
            finally:
                self._close(reader)

    def _resume(self, last: Checkpoint) -> StartedStream:
        started = self.starter.resume(last, self.address)
        if self.starter.make_source is not None:
            self.source = self.starter.make_source(started.stream.recipe)
        self._position = last.position
        if not self.source.replays:
            message = (
                "becalm was not running for a while; rows sent in that time are lost, unless the sender stores them and"
                " sends them again."
            )
            self._losses.append(Loss(LossKind.GAP, None, message))
        return started

    def _begin(self) -> StartedStream | None:
        started = None
        try:
            started = self.starter.start_new(self._next, self._queue, self.source, self.watch)
        finally:
            if started is None:  # no output will carry the losses
                self.watch.record_losses(self._losses)
        return started

    def _open(self, started: StartedStream) -> CommitThread:
        head = started.head
        if self.sinks.checkpoint_sink is not None:
            retry_until_reachable(
                partial(open_checkpoint_sink, self.sinks.checkpoint_sink, head), self.watch, self._stop
            )
        for sink in self.sinks.others:
            sink.open(head)
        self.watch.meter.begin(head.names, started.stream.recipe.to_toml())
        self.watch.state("running")
        self._submitted_s = time.monotonic()
        return CommitThread(self.sinks, self.source, self.watch, head)

    def _filter_all(self, started: StartedStream, commit_thread: CommitThread) -> None:
        stream = started.stream
        if started.early_losses:
            self._write(stream.take(Block.of_losses(*started.early_losses)))
        for early in started.blocks:
            self._take(early, stream, commit_thread)
        while not self._queue.ended:
            self._retuning.apply(stream, self.watch)
            block = self._next()
            if block is not None:
                self._take(block, stream, commit_thread)
            self._commit(stream, commit_thread)
            self._record_health(stream)
        if not self._stop.is_set() or self.sinks.checkpoint_sink is None:  # otherwise a checkpoint has the delayed rows
            self._emit(stream.finish())

    def _next(self) -> Block | None:
        if self._stop.is_set() and self._reader is not None:
            self._reader.stop()
        block = self._queue.get(_POLL_S, _JOINED_ROWS)
        self._losses += self.watch.record_iteration(block is not None and len(block) > 0)
        self.watch.meter.set_queue(*self._queue.depth)
        return block

    def _take(self, block: Block, stream: Stream, commit_thread: CommitThread) -> None:
        self._emit(stream.take(block))
        self._position = block.position or self._position
        if sum(output.values.size for output in self._outputs) >= _MOST_VALUES:
            self._commit(stream, commit_thread, at_once=True)

    def _emit(self, output: Output) -> None:
        """Write rows to the sinks and count them, with the losses since the last output."""
        if self._losses:
            output, self._losses = replace(output, losses=(*self._losses, *output.losses)), []
        if not (len(output) or output.losses):
            return
        self._write(output)
        self.watch.record(output)

    def _write(self, output: Output) -> None:
        self.rows = output.first_row + len(output)
        self._outputs.append(output)  # before writing, so that it is committed even if a sink fails for good
        for sink in self.sinks.others:
            sink.write(output)

    def _commit(self, stream: Stream, commit_thread: CommitThread, *, at_once: bool = False) -> None:
        """Pass the rows since the last commit to the commit thread, `at_once` or if the commit interval has passed."""
        now = time.monotonic()
        if not at_once and now - self._submitted_s < self.settings.commit_s:
            return
        self._submitted_s = now
        if self._outputs:
            outputs, self._outputs = self._outputs, []
            commit_thread.submit(Transaction(outputs, stream.checkpoint(self._position, self.address)))
        self._losses += commit_thread.losses()

    def _record_health(self, stream: Stream) -> None:
        now = time.monotonic()
        if now - self._health_s >= _HEALTH_S:
            self._health_s = now
            for channel in stream.health():
                self.watch.meter.health(channel.name, nan if channel.nis is None else channel.nis, _alarms(channel))

    def _close(self, reader: Reader) -> None:
        reader.join()
        for sink in self.sinks.others:
            sink.close()
        if self.sinks.checkpoint_sink is not None:
            self.sinks.checkpoint_sink.close()


def _alarms(channel: ChannelHealth) -> list[str]:
    drift = channel.drift_since_row
    return [*([] if drift is None else [f"drifts since row {drift}"]), *(["is dead"] if channel.dead else [])]
