"""A thread that reads the source into the queue, and reconnects when the connection is lost."""

from __future__ import annotations

import random
import threading
import time

from becalm.live.block import Block, Loss, LossKind
from becalm.live.protocols import AwayError, EndOfStream, Source
from becalm.live.running.queueing import BlockQueue
from becalm.live.watching.watch import Watch

_FIRST_S, _LONGEST_S = 0.25, 30.0  # shortest and longest wait between attempts, in seconds
_POLL_S = 0.25  # timeout of one read, in seconds
_DRAIN_S = 1.0  # longest time to read the rows that arrived before a stop, in seconds


class BackOff:
    """Exponential back-off between attempts: the wait doubles up to 30 s, with a random jitter of up to 25 %."""

    def __init__(self) -> None:
        self._next_s = _FIRST_S

    def wait(self, stop: threading.Event) -> None:
        """Wait before the next attempt, or until `stop` is set."""
        stop.wait(self._next_s * random.uniform(0.75, 1.25))
        self._next_s = min(2 * self._next_s, _LONGEST_S)

    def reset(self) -> None:
        """Start again with the shortest wait, after a success."""
        self._next_s = _FIRST_S


class Reader:
    """Reads a source in a separate thread.

    Parameters
    ----------
    source : Source
        Source of the blocks.
    queue : BlockQueue
        Queue that gets the blocks.
    watch : Watch
        Counts the blocks and records when the source is away.
    position : str
        Position after which to continue; "" for a new stream.
    """

    def __init__(self, source: Source, queue: BlockQueue, watch: Watch, position: str) -> None:
        self._source, self._queue, self._watch, self._position = source, queue, watch, position
        self._stop = threading.Event()
        self._away_since: float | None = None
        self._back_off = BackOff()
        self._thread = threading.Thread(target=self._run, name="reader", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop reading and end the queue; if the source cannot replay, rows that have arrived are still read."""
        self._stop.set()

    def join(self) -> None:
        """Wait until the thread has ended."""
        self._thread.join()

    def _run(self) -> None:
        failure: BaseException | None = None
        try:
            while not self._stop.is_set():
                try:
                    self._source.open(self._position)
                    self._read_until_stopped()
                except AwayError as cause:
                    self._record_away(cause)
        except EndOfStream:
            pass
        except BaseException as cause:  # the runner raises it, once all rows that were read are committed
            failure = cause
        finally:
            self._source.close()
            self._queue.end(failure)

    def _read_until_stopped(self) -> None:
        while not self._stop.is_set():
            block = self._source.read(_POLL_S)
            if block is None:
                continue
            self._record_back()
            self._take(block)
        # A source that cannot replay would lose the rows that have already arrived, so read them too.
        until = time.monotonic() + _DRAIN_S
        while not self._source.replays and time.monotonic() < until and (block := self._source.read(0.0)) is not None:
            self._take(block)

    def _take(self, block: Block) -> None:
        self._position = block.position or self._position
        self._watch.meter.count_block(block)
        self._queue.put(block, self._stop)

    def _record_away(self, cause: AwayError) -> None:
        self._source.close()
        if self._away_since is None:
            self._away_since = time.time()
            self._watch.state("away", str(cause))
            self._queue.report(Loss(LossKind.AWAY, None, str(cause)))
        self._back_off.wait(self._stop)

    def _record_back(self) -> None:
        if self._away_since is not None:
            away_s, self._away_since = time.time() - self._away_since, None
            self._watch.state("running")
            self._queue.report(Loss(LossKind.AWAY, None, f"The source is back after {away_s:.1f} s."))
        self._back_off.reset()
