"""Read lines that another program writes to a pipe."""

from __future__ import annotations

import os
import sys
import threading
import time
from queue import Empty, Queue

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Block
from becalm.live.protocols import EndOfStream
from becalm.live.sources.lined import LineSource

_PIECE = 1 << 18  # most bytes of one read
_PIECES = 4  # most pieces that wait to be parsed


class StdinSource(LineSource):
    """A `LineSource` that reads standard input, from a pipe or a terminal.

    Parameters
    ----------
    address : Address
        `stdin:`, and the options of `LineSource`.
    descriptor : int
        File descriptor to read, by default standard input.
    """

    def __init__(self, address: Address, descriptor: int = 0) -> None:
        super().__init__(address)
        if address.rest:
            raise UsageError(
                f"stdin: takes no name, but {address.rest!r} was given; write stdin: alone, or replay:FILE for a file."
            )
        self._descriptor, self._ended = descriptor, False
        self._pieces: Queue[bytes | OSError] = Queue(_PIECES)

    def open(self, position: str) -> None:
        """Begin to read, in a thread, because Windows cannot wait for a pipe with a timeout.

        Raises
        ------
        InputError
            If standard input is closed; another file may then have its descriptor.
        """
        if self._descriptor == 0 and sys.__stdin__ is None:
            raise InputError("Standard input is closed; pipe lines of CSV or JSON into becalm live stdin:.")
        threading.Thread(target=self._read_pieces, name="standard input", daemon=True).start()

    def read(self, timeout_s: float) -> Block | None:
        """Return the received rows; None if none arrives within `timeout_s`.

        Raises
        ------
        EndOfStream
            If the pipe is closed, and all rows were read.
        InputError
            If standard input cannot be read, for example because it is a folder.
        UsageError
            If the options of the address do not fit the lines.
        """
        try:
            if not self._ended:
                return self._rows(timeout_s)
        except EndOfStream:
            last = self._lines.finish(time.time())
            if last is not None:
                return last
        except OSError as cause:
            raise InputError(f"Standard input cannot be read: {cause.strerror or cause}.") from cause
        raise EndOfStream

    def close(self) -> None:
        """Do nothing: the pipe was opened by the parent process."""

    def _read_pieces(self) -> None:
        """Queue what is read, until nothing comes any more or reading fails."""
        try:
            while data := os.read(self._descriptor, _PIECE):
                self._pieces.put(data)
            self._pieces.put(b"")
        except OSError as cause:
            self._pieces.put(cause)

    def _read_bytes(self, timeout_s: float) -> bytes | None:
        try:
            data = self._pieces.get(timeout_s > 0, timeout_s)
        except Empty:
            return None
        if isinstance(data, OSError):
            raise data
        if not data:
            self._ended = True
            raise EndOfStream
        return data
