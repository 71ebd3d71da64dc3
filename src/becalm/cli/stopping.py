"""A signal to stop ends the work as an error does, so that nothing half-written is left."""

from __future__ import annotations

import math
import signal
import time
from types import FrameType

STOPPED = 128
"""Exit code of a process that a signal stopped, less the signal's number."""

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_TIDYING_S = 1.0


def stop_cleanly() -> None:
    """Let signals to stop raise SystemExit; what is ignored stays so, as under nohup."""
    stop = _Stop()
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, stop)


class _Stop:
    """Raises, but not again at once: a closing terminal sends two signals, and the second would stop the tidying up."""

    def __init__(self) -> None:
        self._last = -math.inf

    def __call__(self, number: int, _: FrameType | None) -> None:
        now = time.monotonic()
        if now - self._last > _TIDYING_S:
            self._last = now
            raise SystemExit(STOPPED + number)
