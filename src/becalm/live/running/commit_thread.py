"""The thread that commits rows, filters and position, while the next rows are filtered."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from becalm.live.block import Checkpoint, Head, Loss, LossKind, Output
from becalm.live.buffered_sink import BufferedSink
from becalm.live.protocols import AwayError, CheckpointSink, Source, StorageFullError
from becalm.live.running.reader import BackOff
from becalm.live.watching.watch import Watch

_BATCHES = 2  # most batches in the queue; while it is full, the filters wait for the disk
_POLL_S = 0.25  # seconds to wait for room in the queue before failures are checked again


class Transaction(NamedTuple):
    """Rows and checkpoint that are committed together."""

    outputs: list[Output]
    checkpoint: Checkpoint


class StreamSinks(NamedTuple):
    """The checkpoint sink of a stream, if it has one, and its other sinks."""

    checkpoint_sink: CheckpointSink | None
    others: tuple[BufferedSink, ...]


class CommitThread:
    """Commits batches in order in a separate thread; if the checkpoint sink is full or away, it tries again.

    Parameters
    ----------
    sinks : StreamSinks
        The sinks. The other sinks are flushed before each commit, so that they have received every committed row.
    source : Source
        Source; its method `committed` is called with each committed position.
    watch : Watch
        Counts the commits and records when the checkpoint sink is full or away.
    head : Head
        Names, units, rate and recipe of the stream.
    """

    def __init__(self, sinks: StreamSinks, source: Source, watch: Watch, head: Head) -> None:
        self._sinks, self._source, self._watch, self._head = sinks, source, watch, head
        self._batches: queue.Queue[Transaction | None] = queue.Queue(_BATCHES)
        self._stop_retrying = threading.Event()
        self._failure: BaseException | None = None
        self._losses: list[Loss] = []
        self._in_doubt = False  # True after a lost connection: the current batch may have been committed already
        self._thread = threading.Thread(target=self._run, name="keeper", daemon=True)
        self._thread.start()

    def submit(self, batch: Transaction) -> None:
        """Queue a batch for commit; wait while earlier batches wait for the disk.

        Raises
        ------
        BecalmError
            If an earlier batch can never be committed.
        """
        while True:
            self._raise_failure()
            try:
                self._batches.put(batch, timeout=_POLL_S)
            except queue.Full:
                continue
            return

    def losses(self) -> tuple[Loss, ...]:
        """Return the losses since the last call."""
        losses, self._losses = self._losses, []
        return tuple(losses)

    def finish(self, patience_s: float) -> None:
        """Commit the queued batches and end the thread; after `patience_s`, a full disk or absent server is a failure.

        Raises
        ------
        BecalmError
            If a batch could not be committed.
        """
        until = time.monotonic() + patience_s
        while self._thread.is_alive():
            try:
                self._batches.put(None, timeout=_POLL_S)
                break
            except queue.Full:
                if time.monotonic() > until:
                    self._stop_retrying.set()
        self._thread.join(max(0.0, until - time.monotonic()))
        self._stop_retrying.set()
        self._thread.join()
        self._raise_failure()

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        try:
            while (batch := self._batches.get()) is not None:
                self._commit(batch)
        except BaseException as cause:  # the runner raises it
            self._failure = cause

    def _commit(self, batch: Transaction) -> None:
        began_s = time.monotonic()
        for sink in self._sinks.others:
            self._retry(sink.flush, sink.mark_away)
        if self._sinks.checkpoint_sink is not None:
            self._retry(partial(self._commit_once, batch), self._mark_checkpoint_sink_away)
        rows = sum(len(output) for output in batch.outputs)
        self._watch.meter.count_commit(rows, time.monotonic() - began_s, batch.checkpoint.position)
        self._source.committed(batch.checkpoint.position)

    def _commit_once(self, batch: Transaction) -> None:
        checkpoint_sink = self._sinks.checkpoint_sink
        assert checkpoint_sink is not None
        if self._in_doubt:
            last = checkpoint_sink.last()
            checkpoint_sink.open(self._head)
            self._in_doubt = False
            if last is not None and last == batch.checkpoint:
                return  # the batch was committed before the connection was lost
        checkpoint_sink.commit(batch.outputs, batch.checkpoint)

    def _retry(self, do: Callable[[], None], mark_away: Callable[[], None]) -> None:
        """Call `do`; while the disk is full or the server is away, call it again."""
        back_off, troubled = BackOff(), False
        while True:
            try:
                do()
            except (StorageFullError, AwayError) as cause:
                if isinstance(cause, AwayError):
                    mark_away()
                if not troubled:
                    self._record(LossKind.STORAGE if isinstance(cause, StorageFullError) else LossKind.AWAY, str(cause))
                troubled = True
                if self._stop_retrying.is_set():
                    raise
                back_off.wait(self._stop_retrying)
                continue
            if troubled:
                self._watch.state("running")
            return

    def _mark_checkpoint_sink_away(self) -> None:
        assert self._sinks.checkpoint_sink is not None
        self._sinks.checkpoint_sink.close()
        self._in_doubt = True

    def _record(self, kind: LossKind, message: str) -> None:
        self._watch.state("full" if kind is LossKind.STORAGE else "away", message)
        self._losses.append(Loss(kind, None, message))
