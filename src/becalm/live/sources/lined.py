"""What sources of lines share: bytes that come in pieces, until a row is whole."""

from __future__ import annotations

import time
from collections.abc import Callable

from becalm.live.block import Block
from becalm.live.lines.feeding import Lines


def read_lines(lines: Lines, more: Callable[[float], bytes | None], timeout_s: float) -> Block | None:
    """Wait for rows.

    Parameters
    ----------
    lines : Lines
        Makes rows of bytes.
    more : callable
        Waits so many seconds at most for bytes; None where none came.
    timeout_s : float
        How long to wait in all.

    Returns
    -------
    Block or None
        None where no line ended in that time.
    """
    until = time.monotonic() + timeout_s
    while True:
        data = more(max(0.0, until - time.monotonic()))
        block = None if data is None else lines.feed(data, time.time())
        if block is not None or time.monotonic() >= until:
            return block
