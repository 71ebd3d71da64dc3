"""Base class of sources of text lines: collect bytes until a row is complete."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence

from becalm.live.address import Address
from becalm.live.block import Block
from becalm.live.lines.columns import LineOptions
from becalm.live.lines.line_parser import LineParser


class LineSource(ABC):
    """A source of CSV or JSON lines that cannot replay; bytes that arrive while it is not read may be lost.

    Options of the address, all optional: `format=csv|json`, `columns=time,ax,ay`, `time=COLUMN`, `rate=100`,
    `channels=ax`.

    Parameters
    ----------
    address : Address
        Address with the options.
    own_options : sequence of str
        Names of the source's own options, in addition to the options for lines.

    Attributes
    ----------
    rate_hz : float or None
        Sample rate in hertz, if the option `rate` is given.

    Raises
    ------
    UsageError
        If an option is unknown, or its value is not possible.
    """

    replays = False

    def __init__(self, address: Address, own_options: Sequence[str] = ()) -> None:
        address.refuse_unknown((*own_options, *LineOptions.NAMES))
        options = LineOptions.of(address)
        self.rate_hz, self._lines = options.rate_hz, LineParser(options)

    def committed(self, position: str) -> None:  # noqa: B027  (there is nothing to do)
        """Do nothing: the sender needs no acknowledgement."""

    @abstractmethod
    def _read_bytes(self, timeout_s: float) -> bytes | None:
        """Return the next bytes; None if none arrive within `timeout_s`."""

    def _rows(self, timeout_s: float) -> Block | None:
        """Return the next rows; None if no line is completed within `timeout_s`."""
        until = time.monotonic() + timeout_s
        while True:
            data = self._read_bytes(max(0.0, until - time.monotonic()))
            block = None if data is None else self._lines.feed(data, time.time())
            if block is not None or time.monotonic() >= until:
                return block
