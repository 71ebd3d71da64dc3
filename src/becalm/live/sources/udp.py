"""Datagrams: one message of rows each, put in order by their numbers, with what was lost on the way counted."""

from __future__ import annotations

import errno
import json
import select
import socket
import struct
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Block, Loss, LossKind
from becalm.live.messages.stream import MessageStream
from becalm.live.position import told_by
from becalm.live.protocols import AwayError, EndOfStream

_DATAGRAM = 65_536  # bytes: none is longer
_AT_ONCE = 4_000_000  # bytes in one read, so that a block stays bounded
_BUFFER = 8 * 2**20  # bytes in the kernel: a third of a second at 25 MB/s
_REORDER = 8
_LONGEST_GATHER_S = 1.0
_SHORTEST_PAUSE_S = 1e-3
_FILL = 0.25  # of the kernel's buffer, which gathering is to leave unexceeded

# What Linux has and the module socket does not name
_BUFFER_FORCED, _STAMP, _MEMORY = 33, 35, 55
_TIMESPEC = struct.Struct("@ll")
_MEMORY_WORDS = struct.Struct("=9I")  # [0] bytes that wait, [1] bytes that may, [8] datagrams dropped


class UdpSource:
    """`udp:PORT`: datagrams that each hold one message, as `MessageStream` reads them, with its options.

    `host=` is the address to listen at, 127.0.0.1 unless it is said: nothing beyond this machine is heard by
    mistake. `gather=50ms` leaves datagrams in the kernel's buffer for so long (less where it would fill), so that
    fewer wake-ups take more. `buffer=` is that buffer's size in bytes. `reorder=8` is how many messages may wait, for
    20 ms at most, for one that is behind.

    Datagrams cannot be asked for again. What never came is counted in rows by the sender's numbers, and what the
    kernel dropped because nobody read it in time is counted in datagrams: with numbers, both tell of the same rows.

    Parameters
    ----------
    address : Address
        udp:PORT with the options.

    Attributes
    ----------
    rate_hz : float or None
        What `rate=` says.
    """

    replays = False

    def __init__(self, address: Address) -> None:
        address.refuse_unknown((*MessageStream.OPTIONS, "reorder", "host", "gather", "buffer"))
        if not address.rest.isdecimal() or not 0 < int(address.rest) < 65_536:
            raise UsageError(f"udp:{address.rest} names no port; write a number from 1 to 65535, as udp:9000.")
        self._place = (address.options.get("host", "127.0.0.1"), int(address.rest))
        self._gather_s = address.seconds("gather", 0.0)
        if self._gather_s > _LONGEST_GATHER_S:
            raise UsageError(f"udp: gather={address.options['gather']} is longer than 1s; say gather=50ms.")
        self._buffer = int(address.number("buffer", _BUFFER, least=4096, greatest=2**30))
        self._pause_s = _SHORTEST_PAUSE_S
        self._stream = MessageStream(address, reorder=int(address.number("reorder", _REORDER, greatest=1000)))
        self.rate_hz = self._stream.rate_hz
        self._socket: socket.socket | None = None
        self._dropped = 0
        self._noticed: tuple[Loss, ...] = ()
        self._small_buffer = False
        self._reading = threading.Lock()  # held by read, so that close takes no socket away that is waited for
        self._wake: socket.socket | None = None
        self._woken: socket.socket | None = None

    def open(self, position: str) -> None:
        """Listen; numbers go on after `position`, so that rows that were missed meanwhile are counted.

        Raises
        ------
        InputError
            If the port is taken or forbidden, or there is no such address.
        AwayError
            If the network is not there now.
        """
        self.close()
        self._stream.resume(told_by("udp", position, "rows").get("rows", {}))
        host, port = self._place
        try:
            family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except (socket.gaierror, UnicodeError) as cause:
            raise InputError(f"udp: {host} is no address of this machine; say host=0.0.0.0 for all it has.") from cause
        opened = socket.socket(family, kind, protocol)
        try:
            self._noticed = self._enlarge(opened)
            if sys.platform == "linux":
                opened.setsockopt(socket.SOL_SOCKET, _STAMP, 1)
            opened.bind(place)
            opened.setblocking(False)
        except OSError as cause:
            opened.close()
            raise _said(cause, host, port) from cause
        self._dropped = 0
        self._wake, self._woken = socket.socketpair()
        self._socket = opened

    def read(self, timeout_s: float) -> Block | None:
        """Return the rows of all datagrams that wait; with no timeout also those that waited for one before.

        Raises
        ------
        EndOfStream
            If it is not open.
        AwayError
            If the network went away.
        """
        with self._reading:
            if self._socket is None or self._woken is None:
                raise EndOfStream
            waiting_s = min(timeout_s, self._stream.wait_s())
            if self._noticed:
                waiting_s = 0.0
            try:
                there, _, _ = select.select([self._socket, self._woken], [], [], max(0.0, waiting_s))
                if self._socket in there and self._gather_s and timeout_s > 0:
                    select.select([self._woken], [], [], self._pause_s)
                lost = self._overrun(self._socket)
                messages = self._received(self._socket)
            except OSError as cause:
                raise _said(cause, *self._place) from cause
            self._stream.take_many(messages)
            if timeout_s <= 0 and not messages:
                self._stream.rest()
            block = self._stream.block(extra=(*self._noticed, *lost))
            self._noticed = ()
            return block and replace(block, position=json.dumps({"rows": self._stream.state}))

    def committed(self, position: str) -> None:
        """Do nothing: nobody waits to hear it."""

    def close(self) -> None:
        """Stop listening; a `read` in another thread ends."""
        wake = self._wake
        if wake is not None:
            with suppress(OSError):  # closed by another thread
                wake.send(b"\0")
        with self._reading:
            for opened in (self._socket, self._wake, self._woken):
                if opened is not None:
                    opened.close()
            self._socket = self._wake = self._woken = None

    def _enlarge(self, opened: socket.socket) -> tuple[Loss, ...]:
        """Ask for a large buffer; tell once where the kernel grants less."""
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self._buffer)
        granted = opened.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        if sys.platform == "linux":
            with suppress(PermissionError):  # root gets what it asks for
                opened.setsockopt(socket.SOL_SOCKET, _BUFFER_FORCED, self._buffer)
            granted = opened.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # its own use is counted in it
        if granted >= self._buffer or self._small_buffer:
            return ()
        self._small_buffer = True
        says = (
            f"The kernel grants a buffer of {granted} bytes and not {self._buffer}: longer bursts are dropped. "
            f"Type sysctl -w net.core.rmem_max={self._buffer}, or say buffer={granted}."
        )
        return (Loss(LossKind.DROPPED, 0, says),)

    def _received(self, opened: socket.socket) -> list[tuple[bytes, float]]:
        """Take datagrams until none waits, each with the time at which the kernel had it."""
        messages: list[tuple[bytes, float]] = []
        taken = 0
        try:
            while taken < _AT_ONCE:
                payload, told, _, _ = opened.recvmsg(_DATAGRAM, 64)
                if told:
                    seconds, nanoseconds = _TIMESPEC.unpack(told[0][2])
                    messages.append((payload, seconds + nanoseconds * 1e-9))
                else:
                    messages.append((payload, time.time()))
                taken += len(payload) + 64  # even empty ones end
        except BlockingIOError:
            pass
        return messages

    def _overrun(self, opened: socket.socket) -> tuple[Loss, ...]:
        """Return what the kernel dropped since this was asked last, and pause less where its buffer fills."""
        if sys.platform != "linux":
            return ()
        words = _MEMORY_WORDS.unpack(opened.getsockopt(socket.SOL_SOCKET, _MEMORY, _MEMORY_WORDS.size))
        room = _FILL * words[1] / max(words[0], 1)
        self._pause_s = min(self._gather_s, max(_SHORTEST_PAUSE_S, self._pause_s * min(room, 2.0)))
        new = (words[8] - self._dropped) % 2**32
        self._dropped = words[8]
        if not new:
            return ()
        says = f"The kernel dropped {new} datagrams, which came faster than they were read."
        return (Loss(LossKind.DROPPED, new, says),)


def _said(cause: OSError, host: str, port: int) -> InputError | AwayError:
    """Turn what a socket says into a sentence."""
    if cause.errno == errno.EADDRINUSE:
        return InputError(f"udp:{port} is taken by another program; choose another port, or end it (ss -ulpn tells).")
    if cause.errno == errno.EACCES:
        return InputError(f"udp:{port} is not allowed to you; choose a port from 1024 on.")
    return AwayError(f"{host} cannot be listened at now: {cause.strerror}.")
