"""A signal to stop ends the process at once, and leaves nothing half-written."""

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
_STOPPED = 128  # exit code of a process that a signal stopped, less the signal's number
_WORD = b"becalm: Stopped; nothing half-written is left.\n"
_SHOW_CURSOR = b"\r\x1b[K\x1b[?25h"  # which a progress bar hides


def stop_cleanly(word: bytes = _WORD) -> None:
    """Let signals to stop do so, with a word; what is ignored stays so, as under nohup."""
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, partial(_stop, word))


def beside(act: Callable[[], None]) -> Callable[[], None]:
    """Return what has a thread act, for a handler of signals: it may have interrupted whoever holds a lock."""
    asked: SimpleQueue[None] = SimpleQueue()  # whose put waits for nothing

    def listen() -> None:
        while True:
            asked.get()
            act()

    threading.Thread(target=listen, daemon=True).start()
    return partial(asked.put, None)


def _stop(word: bytes, number: int, _: FrameType | None) -> None:
    """Tidy up and end here: an exception might be raised where the interpreter ignores it, as in a finaliser."""
    if waiting := sys.modules.get("becalm.files.temporary_files"):  # not loaded, it has nothing half-written
        waiting.abandon()
    with suppress(OSError):
        os.write(2, _SHOW_CURSOR + word if os.isatty(2) else word)
    os._exit(_STOPPED + number)
