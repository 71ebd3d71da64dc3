"""Stop the process at once at a signal, without leaving half-written files."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from queue import SimpleQueue
from types import FrameType

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_STOPPED = 128  # exit code after a signal: 128 + the number of the signal
_MESSAGE = b"becalm: Stopped; nothing half-written is left.\n"
_SHOW_CURSOR = b"\r\x1b[K\x1b[?25h"  # a progress bar hides it


def stop_cleanly(word: bytes = _MESSAGE) -> None:
    """Stop the process at signals, with the message `word`; signals that are ignored, as under nohup, stay so."""
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, partial(_stop, word))


def call_in_thread(act: Callable[[], None]) -> Callable[[], None]:
    """Return a function that calls `act` in a thread, for signal handlers.

    A handler may interrupt code that holds a lock, so it must not take a lock itself.
    """
    calls: SimpleQueue[None] = SimpleQueue()  # its put never waits

    def listen() -> None:
        while True:
            calls.get()
            act()

    threading.Thread(target=listen, daemon=True).start()
    return partial(calls.put, None)


def _stop(word: bytes, number: int, _: FrameType | None) -> None:
    """Remove temporary files and exit. An exception might not end the process: finalisers ignore it, for example."""
    if waiting := sys.modules.get("becalm.files.atomic_file"):  # if it is not loaded, there are no temporary files
        waiting.abandon()
    with suppress(OSError):
        os.write(2, _SHOW_CURSOR + word if os.isatty(2) else word)
    os._exit(_STOPPED + number)
