"""A wrapper of a sink that buffers rows while the sink cannot be reached."""

from __future__ import annotations

import threading

from becalm.live.block import Head, Output
from becalm.live.protocols import AwayError, Sink


class BufferedSink:
    """A sink that buffers rows while the wrapped sink cannot be reached.

    The filtering thread calls `write` and the commit thread calls `flush`. Rows that cannot be written are buffered
    until `flush` has reached the sink again. The buffer stays small: a batch is committed only after all sinks are
    flushed, and the filters wait while several batches are uncommitted.

    Parameters
    ----------
    sink : Sink
        The sink to write to.
    """

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._head: Head | None = None
        self._waiting: list[Output] = []
        self._is_away = False
        self._lock = threading.Lock()

    def open(self, head: Head) -> None:
        """Open the sink; if it cannot be reached now, the first flush opens it."""
        self._head = head
        try:
            self._sink.open(head)
        except AwayError:
            self._is_away = True

    def write(self, output: Output) -> None:
        """Write rows, or buffer them if the sink cannot be reached."""
        with self._lock:
            if self._is_away:
                self._waiting.append(output)
                return
            try:
                self._sink.write(output)
            except AwayError:
                self._waiting.append(output)
                self._is_away = True

    def flush(self) -> None:
        """Wait until the sink has delivered all written rows.

        Raises
        ------
        AwayError
            If the sink cannot be reached.
        """
        with self._lock:
            if self._is_away:
                assert self._head is not None
                self._sink.close()
                self._sink.open(self._head)
                while self._waiting:
                    self._sink.write(self._waiting[0])
                    del self._waiting[0]
                self._is_away = False  # not before: rows written meanwhile come after those that wait
        self._sink.flush()

    def mark_away(self) -> None:
        """Mark the sink as unreachable."""
        with self._lock:
            self._is_away = True

    def close(self) -> None:
        """Close the sink."""
        with self._lock:
            self._sink.close()
