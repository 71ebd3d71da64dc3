"""Watchdogs of a stream: one for a silent source, and systemd's for a process that hangs."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Mapping

from becalm.live.block import Loss, LossKind


class Silence:
    """Reports once that a source has been silent for too long, and once that it is back.

    Parameters
    ----------
    patience_s : float
        Longest time without rows, in seconds.
    clock : callable
        Function that returns the time in seconds; by default `time.monotonic`.
    """

    def __init__(self, patience_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._patience_s, self._clock = patience_s, clock
        self._last_s = clock()
        self.silent = False

    def record_rows(self) -> Loss | None:
        """Record that rows arrived; return a loss with the length of the silence, if one was reported."""
        last_s, self._last_s = self._last_s, self._clock()
        if not self.silent:
            return None
        self.silent = False
        return Loss(LossKind.SILENT, None, f"The source is back after {self._last_s - last_s:.3g} s of silence.")

    def record_no_rows(self) -> Loss | None:
        """Record that no rows arrived; return a loss when the silence first exceeds the limit."""
        silence_s = self._clock() - self._last_s
        if self.silent or silence_s <= self._patience_s:
            return None
        self.silent = True
        return Loss(LossKind.SILENT, None, f"Nothing came from the source for {silence_s:.3g} s.")


class Systemd:
    """Reports the state of the service to systemd, by its notify protocol; without systemd every call does nothing.

    The protocol is a datagram of NAME=value, so no library is needed. Errors in sending are ignored.

    Parameters
    ----------
    environment : mapping of str to str
        Environment variables; systemd sets NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID.
    clock : callable
        Function that returns the time in seconds; by default `time.monotonic`.
    """

    def __init__(
        self, environment: Mapping[str, str] = os.environ, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock = clock
        self._socket = _connect(environment.get("NOTIFY_SOCKET", ""))
        self._every_s = _watchdog_s(environment) / 3
        self._next_s = clock() if self._every_s < float("inf") else float("inf")
        self._says = ""

    def ready(self) -> None:
        """Report that the stream is running."""
        self._send("READY=1")

    def status(self, says: str) -> None:
        """Report the state in a sentence; an unchanged sentence is not sent again."""
        if says != self._says:
            self._says = says
            self._send(f"STATUS={' '.join(says.split())}")

    def ping_watchdog(self) -> None:
        """Report that the main loop runs; only that loop may call this, so that its hang is noticed."""
        now_s = self._clock()
        if now_s >= self._next_s:
            self._next_s = now_s + self._every_s
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Report that the stream is stopping."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Close the socket; may be called twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> None:
        if self._socket is not None:
            try:
                self._socket.send(text.encode())
            except OSError:
                return  # the socket is full, or systemd no longer listens; the next datagram may arrive


def _connect(address: str) -> socket.socket | None:
    if not address.startswith(("/", "@")) or not hasattr(socket, "AF_UNIX"):
        return None
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    connection.setblocking(False)
    try:
        connection.connect(f"\0{address[1:]}" if address.startswith("@") else address)
    except OSError:
        connection.close()
        return None
    return connection


def _watchdog_s(environment: Mapping[str, str]) -> float:
    """Return the watchdog interval that systemd requires of this process, in seconds; infinity if none."""
    interval_us, process = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", "")
    if not interval_us.isdecimal() or (process and process != str(os.getpid())):
        return float("inf")
    return int(interval_us) / 1e6
