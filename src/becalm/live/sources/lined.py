"""What sources of lines share: bytes that come in pieces, until a row is whole."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence

from becalm.live.address import Address
from becalm.live.block import Block
from becalm.live.lines.columns import LineOptions
from becalm.live.lines.feeding import Lines


class LineSource(ABC):
    """CSV or JSON lines from whatever gives bytes once; what comes while nobody reads is gone.

    Options of the address: `format=csv|json`, `columns=time,ax,ay`, `time=COLUMN`, `rate=100`, `channels=ax`, all of
    which may be left out.

    Parameters
    ----------
    address : Address
        With the options.
    own_options : sequence of str
        Names of those beside the options of lines.

    Attributes
    ----------
    rate_hz : float or None
        Rows a second, where it was told.

    Raises
    ------
    UsageError
        If an option is not known or not possible.
    """

    replays = False

    def __init__(self, address: Address, own_options: Sequence[str] = ()) -> None:
        address.refuse_unknown((*own_options, *LineOptions.NAMES))
        options = LineOptions.of(address)
        self.rate_hz, self._lines = options.rate_hz, Lines(options)

    def committed(self, position: str) -> None:  # noqa: B027  (there is nothing to do)
        """Do nothing: who sends need not hear it."""

    @abstractmethod
    def _more(self, timeout_s: float) -> bytes | None:
        """Wait so many seconds at most for bytes; None where none came."""

    def _rows(self, timeout_s: float) -> Block | None:
        """Wait for rows; None where no line ended in that time."""
        until = time.monotonic() + timeout_s
        while True:
            data = self._more(max(0.0, until - time.monotonic()))
            block = None if data is None else self._lines.feed(data, time.time())
            if block is not None or time.monotonic() >= until:
                return block
