"""The protocols of sources, sinks, and checkpoint sinks, from which a killed stream can be resumed."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from becalm.errors import BecalmError
from becalm.live.block import Block, Checkpoint, Head, Output


class EndOfStream(Exception):  # noqa: N818  (not an error)
    """Raised at the end of a source: the end of a file, a closed pipe."""


class AwayError(BecalmError):
    """A server, port or device cannot be reached now but may be later; the runner tries again with back-off."""

    exit_code = 3


class StorageFullError(BecalmError):
    """The disk is full, or writing fails in a way that a full disk can cause; nothing was half-written."""

    exit_code = 5


class Source(Protocol):
    """A source of blocks. One thread calls `open`, `read` and `close`; another thread calls `committed`."""

    replays: bool
    """True if the source can go back to a position, so that a killed stream loses nothing."""

    rate_hz: float | None
    """Sample rate in hertz, set once the source is open; None if unknown. With a rate, blocks may have `elapsed`."""

    def open(self, position: str) -> None:
        """Open the source and continue after `position`; "" starts a new stream. May be called again.

        Raises
        ------
        AwayError
            If the source cannot be reached now.
        BecalmError
            If it can never be opened: no such file, no such option.
        """
        ...

    def read(self, timeout_s: float) -> Block | None:
        """Return the next block, or None if nothing arrives within `timeout_s`.

        Input that cannot be parsed raises no error; it is counted in the losses of the next block.

        Raises
        ------
        EndOfStream
            If the source has ended.
        AwayError
            If the connection was lost; the reader then closes, waits, and opens again at the last block's position.
        """
        ...

    def committed(self, position: str) -> None:
        """Acknowledge the rows up to `position`, which are now committed, if the source has acknowledgements."""
        ...

    def close(self) -> None:
        """Close the connection; may be called twice."""
        ...


@runtime_checkable
class Sink(Protocol):
    """A sink for the outputs of a stream."""

    def open(self, head: Head) -> None:
        """Open the sink, before anything is written; raise AwayError if it cannot be reached now."""
        ...

    def write(self, output: Output) -> None:
        """Write rows; they need not be delivered when this returns. An output without rows may carry losses."""
        ...

    def flush(self) -> None:
        """Wait until all written rows are delivered and, if the receiver sends acknowledgements, acknowledged.

        The commit thread calls this, while another thread calls `write`.
        """
        ...

    def close(self) -> None:
        """Close the connection; may be called twice."""
        ...


@runtime_checkable
class CheckpointSink(Protocol):
    """A sink that commits rows, filters and position in one transaction, so that a crash leaves all or nothing."""

    def last(self) -> Checkpoint | None:
        """Return the last committed checkpoint; None for a new stream. Called before `open`."""
        ...

    def open(self, head: Head) -> None:
        """Prepare for a stream; a resumed stream has the same head as before."""
        ...

    def commit(self, outputs: list[Output], checkpoint: Checkpoint) -> None:
        """Commit rows and checkpoint, both or neither. Once this returns, a power cut loses none of them.

        Raises
        ------
        StorageFullError
            If the disk is full; nothing is committed, and the same call may be made again.
        AwayError
            If the connection was lost; after `close`, `last` shows whether the rows were committed.
        """
        ...

    def close(self) -> None:
        """Release all resources; may be called twice."""
        ...
