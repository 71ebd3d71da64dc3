"""Lines that another program writes into a pipe."""

from __future__ import annotations

import os
import select
import sys
import time

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Block
from becalm.live.protocols import EndOfStream
from becalm.live.sources.lined import LineSource

_PIECE = 1 << 18


class StdinSource(LineSource):
    """Lines from a pipe or a terminal, as `LineSource` tells.

    Parameters
    ----------
    address : Address
        `stdin:`, and the options of lines.
    descriptor : int
        The file descriptor to read; standard input.
    """

    def __init__(self, address: Address, descriptor: int = 0) -> None:
        super().__init__(address)
        if address.rest:
            raise UsageError(
                f"stdin: takes no name, {address.rest!r} came; write stdin: alone, or replay:FILE for a file."
            )
        self._descriptor, self._ended = descriptor, False

    def open(self, position: str) -> None:
        """See that there is a pipe.

        Raises
        ------
        InputError
            If standard input is closed: another file may have its number then.
        """
        if self._descriptor == 0 and sys.__stdin__ is None:
            raise InputError("Standard input is closed; pipe lines of CSV or JSON into becalm live stdin:.")

    def read(self, timeout_s: float) -> Block | None:
        """Return the rows that came, or None where none did within `timeout_s`.

        Raises
        ------
        EndOfStream
            If the pipe is closed, and all was read.
        InputError
            If standard input cannot be read: it is a folder, perhaps.
        UsageError
            If what was said of the lines does not fit them.
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
        """Leave the pipe open: it is not ours."""

    def _more(self, timeout_s: float) -> bytes | None:
        ready, _, _ = select.select([self._descriptor], [], [], timeout_s)
        if not ready:
            return None
        data = os.read(self._descriptor, _PIECE)
        if not data:
            self._ended = True
            raise EndOfStream
        return data
