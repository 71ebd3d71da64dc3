"""Stop the process at once when a signal arrives, without leaving half-written files."""

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

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))
_STOPPED = 128  # exit code after a signal: 128 + the number of the signal
_MESSAGE = b"becalm: Stopped; nothing half-written is left.\n"
_SHOW_CURSOR = b"\r\x1b[K\x1b[?25h"  # needed because a progress bar hides the cursor


def stop_cleanly(word: bytes = _MESSAGE) -> None:
    """Install handlers that stop the process with a message; signals that are ignored, as under nohup, stay ignored."""
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, partial(_stop, word))


def call_in_thread(act: Callable[[], None]) -> Callable[[], None]:
    """Return a function, for signal handlers, that makes a thread call `act`.

    A signal handler may interrupt code that holds a lock, so a handler must not acquire a lock itself.
    """
    calls: SimpleQueue[None] = SimpleQueue()  # `put` of this queue never waits for a lock

    def listen() -> None:
        while True:
            calls.get()
            act()

    threading.Thread(target=listen, daemon=True).start()
    return partial(calls.put, None)


def _stop(word: bytes, number: int, _: FrameType | None) -> None:
    """Remove temporary files and exit. An exception might not end the process; finalisers, for example, ignore it."""
    if waiting := sys.modules.get("becalm.files.atomic_file"):  # without this module, there are no temporary files
        waiting.abandon()
    with suppress(OSError):
        os.write(2, _SHOW_CURSOR + word if os.isatty(2) else word)
    os._exit(_STOPPED + number)
