"""What notices that a stream stands still: its source fell silent, or, for systemd, this process hangs."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Mapping

from becalm.live.block import Loss, LossKind


class Silence:
    """Says when nothing came for too long: once, and once more when something comes again.

    Parameters
    ----------
    patience_s : float
        How long nothing may come, in seconds.
    clock : callable
        `time.monotonic`.
    """

    def __init__(self, patience_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._patience_s, self._clock = patience_s, clock
        self._last_s = clock()
        self.silent = False

    def came(self) -> Loss | None:
        """Hear that rows came; return how long nothing had come, if that had been said."""
        last_s, self._last_s = self._last_s, self._clock()
        if not self.silent:
            return None
        self.silent = False
        return Loss(LossKind.SILENT, None, f"The source is back after {self._last_s - last_s:.3g} s of silence.")

    def waited(self) -> Loss | None:
        """Hear that nothing came just now; return a loss the first time that it lasts too long."""
        past_s = self._clock() - self._last_s
        if self.silent or past_s <= self._patience_s:
            return None
        self.silent = True
        return Loss(LossKind.SILENT, None, f"Nothing came from the source for {past_s:.3g} s.")


class Systemd:
    """Tells systemd how the service fares, by its notify protocol; without systemd every call does nothing.

    The protocol is a datagram of NAME=value, so it needs no library. Nothing here fails a stream.

    Parameters
    ----------
    environment : mapping of str to str
        Where systemd leaves NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID.
    clock : callable
        `time.monotonic`.
    """

    def __init__(
        self, environment: Mapping[str, str] = os.environ, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock = clock
        self._socket = _connected(environment.get("NOTIFY_SOCKET", ""))
        self._every_s = _watchdog_s(environment) / 3
        self._next_s = clock() if self._every_s < float("inf") else float("inf")
        self._says = ""

    def ready(self) -> None:
        """Say that the stream is under way."""
        self._send("READY=1")

    def status(self, says: str) -> None:
        """Say in a sentence what the stream is doing; the same again is not sent."""
        if says != self._says:
            self._says = says
            self._send(f"STATUS={' '.join(says.split())}")

    def alive(self) -> None:
        """Say that the main loop has come round; only that loop may call this, or a hang goes unseen."""
        now_s = self._clock()
        if now_s >= self._next_s:
            self._next_s = now_s + self._every_s
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Say that the stream is being brought to its end."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Let go; harmless twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> None:
        if self._socket is not None:
            try:
                self._socket.send(text.encode())
            except OSError:
                return  # full, or nobody listens any more; the next one may get through


def _connected(address: str) -> socket.socket | None:
    if not address.startswith(("/", "@")) or not hasattr(socket, "AF_UNIX"):
        return None
    door = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    door.setblocking(False)
    try:
        door.connect(f"\0{address[1:]}" if address.startswith("@") else address)
    except OSError:
        door.close()
        return None
    return door


def _watchdog_s(environment: Mapping[str, str]) -> float:
    """Return how often systemd wants to hear of this process, in seconds; infinity if never."""
    asked, process = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", "")
    if not asked.isdecimal() or (process and process != str(os.getpid())):
        return float("inf")
    return int(asked) / 1e6
