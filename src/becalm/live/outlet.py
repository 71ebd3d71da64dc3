"""A sink that the filters write to and the keeper's thread flushes: one that went away holds up no row but its own."""

from __future__ import annotations

import threading

from becalm.live.block import Head, Output
from becalm.live.protocols import AwayError, Sink


class Outlet:
    """A sink beside the keeper.

    Written by one thread and flushed by another. What cannot be written because the other end is away waits here until
    `flush` has reached it again; a stream that is not flushed hands no batch over, so that no more than a few wait.
    """

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._head: Head | None = None
        self._waiting: list[Output] = []
        self._is_away = False
        self._lock = threading.Lock()

    def open(self, head: Head) -> None:
        """Reach the other end; where it is away now, it is reached at the first flush."""
        self._head = head
        try:
            self._sink.open(head)
        except AwayError:
            self._is_away = True

    def write(self, output: Output) -> None:
        """Write some rows, or let them wait."""
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
        """Return once all that was written is with the other end.

        Raises
        ------
        AwayError
            If it is away.
        """
        with self._lock:
            if self._is_away:
                assert self._head is not None
                self._sink.close()
                self._sink.open(self._head)
                self._is_away = False
                while self._waiting:
                    self._sink.write(self._waiting[0])
                    del self._waiting[0]
        self._sink.flush()

    def away(self) -> None:
        """Hear that the other end went away."""
        with self._lock:
            self._is_away = True

    def close(self) -> None:
        """Let go of the other end."""
        with self._lock:
            self._sink.close()
