"""The two small protocols that every transport keeps, and the third of sinks that can bring a stream back."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from becalm.errors import BecalmError
from becalm.live.block import Block, Checkpoint, Head, Output


class EndOfStream(Exception):  # noqa: N818  (it is no error)
    """A source has told all there is: a file's end, a closed pipe."""


class AwayError(BecalmError):
    """What is at the other end cannot be reached now, and may be later: the runner tries again, with back-off."""

    exit_code = 3


class StorageFullError(BecalmError):
    """There is no room to write, or writing fails as it may when there is none; nothing was half-written."""

    exit_code = 5


class Source(Protocol):
    """Gives blocks of readings. `open`, `read` and `close` are called by one thread, `committed` by another."""

    replays: bool
    """Whether it can go back to a position, so that a stream that was killed loses nothing."""

    rate_hz: float | None
    """Readings a second where the source itself knows, once it is open; blocks then may tell `elapsed`."""

    def open(self, position: str) -> None:
        """Reach the other end and go on after `position`; "" begins at the beginning, or now. May be called again.

        Raises
        ------
        AwayError
            If the other end cannot be reached now.
        BecalmError
            If it never can: no such file, no such option.
        """
        ...

    def read(self, timeout_s: float) -> Block | None:
        """Return the next block, or None where nothing came within `timeout_s`.

        Whatever is read and cannot be understood is counted in the next block's losses, and never raises.

        Raises
        ------
        EndOfStream
            If no more will ever come.
        AwayError
            If the other end went away; the runner closes, waits and opens again at the last block's position.
        """
        ...

    def committed(self, position: str) -> None:
        """Hear that all rows up to `position` are kept for good: what can be acknowledged may be."""
        ...

    def close(self) -> None:
        """Let go of the other end; harmless twice."""
        ...


@runtime_checkable
class Sink(Protocol):
    """Takes what is told of a stream."""

    def open(self, head: Head) -> None:
        """Reach the other end; called before anything is written. AwayError if it cannot be reached now."""
        ...

    def write(self, output: Output) -> None:
        """Take some rows; they need not be out when this returns. Output of no rows may tell losses."""
        ...

    def flush(self) -> None:
        """Return once all that was written is with the other end, acknowledged where it acknowledges.

        The keeper's thread calls this, beside `write`.
        """
        ...

    def close(self) -> None:
        """Let go of the other end; harmless twice."""
        ...


@runtime_checkable
class Keeper(Protocol):
    """A sink that keeps rows, filters and position in one transaction, so that a crash leaves all or nothing."""

    def last(self) -> Checkpoint | None:
        """Return the last checkpoint that was kept; None of a new stream. Called before `open`."""
        ...

    def open(self, head: Head) -> None:
        """Make ready for a stream; one that goes on has the head that it had."""
        ...

    def keep(self, outputs: list[Output], checkpoint: Checkpoint) -> None:
        """Keep rows and checkpoint for good, both or neither. When this returns, a power cut loses nothing of them.

        Raises
        ------
        StorageFullError
            If there is no room; nothing is kept, and the same call may be made again.
        AwayError
            If the other end went away; whether it kept this call's rows is told by `last` after opening again.
        """
        ...

    def close(self) -> None:
        """Let go; harmless twice."""
        ...
