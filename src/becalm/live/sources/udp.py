"""Read UDP datagrams with one message each; sort them by their row numbers, and count lost rows."""

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
from becalm.live.position import parse_position
from becalm.live.protocols import AwayError, EndOfStream

_DATAGRAM = 65_536  # bytes; the longest datagram
_READ_BYTES = 4_000_000  # most bytes in one read, so that blocks are bounded
_BUFFER = 8 * 2**20  # size of the kernel's buffer in bytes: a third of a second at 25 MB/s
_REORDER = 8  # default of the option `reorder`
_LONGEST_GATHER_S = 1.0
_SHORTEST_PAUSE_S = 1e-3  # shortest time of gathering, however full the kernel's buffer is
_FILL = 0.25  # fraction of the kernel's buffer that gathering may fill

# Linux's constants SO_RCVBUFFORCE, SO_TIMESTAMPNS and SO_MEMINFO, which the module socket does not have
_BUFFER_FORCED, _STAMP, _MEMORY = 33, 35, 55
_TIMESPEC = struct.Struct("@ll")
_MEMORY_WORDS = struct.Struct("=9I")  # [0] bytes in the buffer, [1] size of the buffer, [8] datagrams dropped


class UdpSource:
    """A source that receives datagrams at `udp:PORT`; each holds one message in a format of `MessageStream`.

    Options, in addition to those of `MessageStream`: `host=` is the address to listen at, by default 127.0.0.1, so
    that other machines cannot send by mistake. `gather=50ms` leaves datagrams in the kernel's buffer for this time
    (less if the buffer would fill), so that each wake-up reads more of them. `buffer=` is that buffer's size in
    bytes. `reorder=8` is the number of messages that wait, for at most 20 ms, for a delayed one.

    Lost datagrams cannot be requested again. Missing rows are counted by the sender's row numbers. Datagrams that the
    kernel dropped because they were not read in time are counted as datagrams; with row numbers their rows are also
    counted as missing.

    Parameters
    ----------
    address : Address
        udp:PORT with the options.

    Attributes
    ----------
    rate_hz : float or None
        Sample rate in hertz from the option `rate=`.

    Raises
    ------
    UsageError
        If the address has no port, an option is unknown, or its value is not possible.
    """

    replays = False

    def __init__(self, address: Address) -> None:
        address.refuse_unknown((*MessageStream.OPTIONS, "reorder", "host", "gather", "buffer"))
        if not address.rest.isdecimal() or not 0 < int(address.rest) < 65_536:
            raise UsageError(f"udp:{address.rest} names no port; write a number from 1 to 65535, as udp:9000.")
        self._place = (address.options.get("host", "127.0.0.1"), int(address.rest))
        self._gather_s = address.seconds("gather", 0.0)
        if self._gather_s > _LONGEST_GATHER_S:
            raise UsageError(
                f"udp: gather={address.options['gather']} is longer than 1s; write for example gather=50ms."
            )
        self._buffer = int(address.number("buffer", _BUFFER, least=4096, greatest=2**30))
        self._pause_s = _SHORTEST_PAUSE_S
        self._stream = MessageStream(address, reorder=int(address.number("reorder", _REORDER, greatest=1000)))
        self.rate_hz = self._stream.rate_hz
        self._socket: socket.socket | None = None
        self._dropped = 0
        self._pending_losses: tuple[Loss, ...] = ()
        self._small_buffer = False
        self._reading = threading.Lock()  # held by read, so that close waits until select has returned
        self._wake: socket.socket | None = None
        self._woken: socket.socket | None = None

    def open(self, position: str) -> None:
        """Listen; row numbers continue after `position`, so that rows lost meanwhile are counted.

        Raises
        ------
        InputError
            If the port is in use or not permitted, or the address does not exist.
        AwayError
            If the network is not available now.
        """
        self.close()
        self._stream.resume(parse_position("udp", position, "rows").get("rows", {}))
        host, port = self._place
        try:
            family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except (socket.gaierror, UnicodeError) as cause:
            raise InputError(
                f"udp: {host} is not an address of this machine; write host=0.0.0.0 to listen at all its addresses."
            ) from cause
        udp_socket = socket.socket(family, kind, protocol)
        try:
            self._pending_losses = self._enlarge(udp_socket)
            if sys.platform == "linux":
                udp_socket.setsockopt(socket.SOL_SOCKET, _STAMP, 1)
            udp_socket.bind(place)
            udp_socket.setblocking(False)
        except OSError as cause:
            udp_socket.close()
            raise _error_of(cause, host, port) from cause
        self._dropped = 0
        self._wake, self._woken = socket.socketpair()
        self._socket = udp_socket

    def read(self, timeout_s: float) -> Block | None:
        """Return the rows of all received datagrams; None if there are none within `timeout_s`.

        With timeout 0 and no new datagram, rows that wait for a delayed datagram are returned too.

        Raises
        ------
        EndOfStream
            If the source is not open.
        AwayError
            If the network is no longer available.
        """
        with self._reading:
            if self._socket is None or self._woken is None:
                raise EndOfStream
            waiting_s = min(timeout_s, self._stream.wait_s())
            if self._pending_losses:
                waiting_s = 0.0
            try:
                readable, _, _ = select.select([self._socket, self._woken], [], [], max(0.0, waiting_s))
                if self._socket in readable and self._gather_s and timeout_s > 0:
                    select.select([self._woken], [], [], self._pause_s)
                lost = self._overrun(self._socket)
                messages = self._received(self._socket)
            except OSError as cause:
                raise _error_of(cause, *self._place) from cause
            self._stream.take_many(messages)
            if timeout_s <= 0 and not messages:
                self._stream.release_all()
            block = self._stream.block(extra=(*self._pending_losses, *lost))
            self._pending_losses = ()
            return block and replace(block, position=json.dumps({"rows": self._stream.state}))

    def committed(self, position: str) -> None:
        """Do nothing: the sender needs no acknowledgement."""

    def close(self) -> None:
        """Stop listening; a `read` in another thread returns."""
        wake = self._wake
        if wake is not None:
            with suppress(OSError):  # closed by another thread
                wake.send(b"\0")
        with self._reading:
            for each in (self._socket, self._wake, self._woken):
                if each is not None:
                    each.close()
            self._socket = self._wake = self._woken = None

    def _enlarge(self, udp_socket: socket.socket) -> tuple[Loss, ...]:
        """Request a large buffer; return a loss if the kernel grants less, at the first call only."""
        udp_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self._buffer)
        granted = udp_socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        if sys.platform == "linux":
            with suppress(PermissionError):  # only root may exceed the limit
                udp_socket.setsockopt(socket.SOL_SOCKET, _BUFFER_FORCED, self._buffer)
            granted = udp_socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # Linux returns twice the size
        if granted >= self._buffer or self._small_buffer:
            return ()
        self._small_buffer = True
        text = (
            f"The kernel grants a buffer of {granted} bytes instead of {self._buffer}: longer bursts are dropped. "
            f"Type sysctl -w net.core.rmem_max={self._buffer}, or set buffer={granted}."
        )
        return (Loss(LossKind.DROPPED, 0, text),)

    def _received(self, udp_socket: socket.socket) -> list[tuple[bytes, float]]:
        """Return all datagrams in the buffer, each with the time at which the kernel received it."""
        messages: list[tuple[bytes, float]] = []
        taken = 0
        try:
            while taken < _READ_BYTES:
                if sys.platform == "linux":
                    payload, ancillary, _, _ = udp_socket.recvmsg(_DATAGRAM, 64)
                else:  # Windows has no recvmsg, and only Linux gives the time of reception
                    payload, ancillary = udp_socket.recv(_DATAGRAM), []
                if ancillary:
                    seconds, nanoseconds = _TIMESPEC.unpack(ancillary[0][2])
                    messages.append((payload, seconds + nanoseconds * 1e-9))
                else:
                    messages.append((payload, time.time()))
                taken += len(payload) + 64  # so that a flood of empty datagrams also ends the loop
        except BlockingIOError:
            pass
        return messages

    def _overrun(self, udp_socket: socket.socket) -> tuple[Loss, ...]:
        """Return a loss for datagrams that the kernel dropped since the last call; adapt the pause to its buffer."""
        if sys.platform != "linux":
            return ()
        words = _MEMORY_WORDS.unpack(udp_socket.getsockopt(socket.SOL_SOCKET, _MEMORY, _MEMORY_WORDS.size))
        room = _FILL * words[1] / max(words[0], 1)
        self._pause_s = min(self._gather_s, max(_SHORTEST_PAUSE_S, self._pause_s * min(room, 2.0)))
        new = (words[8] - self._dropped) % 2**32
        self._dropped = words[8]
        if not new:
            return ()
        text = f"The kernel dropped {new} datagrams, which arrived faster than they were read."
        return (Loss(LossKind.DROPPED, new, text),)


def _error_of(cause: OSError, host: str, port: int) -> InputError | AwayError:
    """Return the error with a message for an error of a socket."""
    if cause.errno == errno.EADDRINUSE:
        return InputError(
            f"udp:{port} is used by another program; choose another port, or end that program (ss -ulpn shows it)."
        )
    if cause.errno == errno.EACCES:
        return InputError(f"You have no permission to use udp:{port}; choose a port from 1024 on.")
    return AwayError(f"becalm cannot listen at {host} now: {cause.strerror}.")
