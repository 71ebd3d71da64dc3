"""Connections that do not wait for ever: a client says soon what it wants, or its place is given to others."""

from __future__ import annotations

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from becalm.web.access import COOKIE

REQUEST_S = 10.0  # from a connection, or a request's first byte, to the end of its headers; and to a wire that is open
MOST_SOCKETS = 200  # of 256 open files, the least that systems allow a process


class HurriedProtocol(H11Protocol):
    """uvicorn's HTTP, which by itself waits for a first request without end.

    Who sends no request, or its headers byte by byte, is left after `REQUEST_S`; where there are more than
    `MOST_SOCKETS`, the one that has waited longest without asking anything goes first.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Begin to wait for a request."""
        super().connection_made(transport)
        if len(self.connections) > MOST_SOCKETS:
            self._make_room()
        self._look()

    def data_received(self, data: bytes) -> None:
        """Take what came; it may end a request's headers, or begin the next ones."""
        super().data_received(data)
        self._look()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand over to a wire, without the cookies of other pages: it takes a few kilobytes of headers only."""
        self.headers = [(name, _own(value) if name == b"cookie" else value) for name, value in self.headers]
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        self._cancel()
        super().connection_lost(exc)

    def _look(self) -> None:
        if self.conn.their_state is not h11.IDLE:  # a request is here, or was none
            self._cancel()
        elif self._deadline is None and not self.transport.is_closing():
            self._deadline = self.loop.call_later(REQUEST_S, self.transport.abort)

    def _cancel(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _make_room(self) -> None:
        waiting = [
            (other._deadline.when(), other.transport)
            for other in self.connections
            if isinstance(other, HurriedProtocol | HurriedWebSocket) and other._deadline is not None
        ]
        _, longest = min(waiting, key=lambda pair: pair[0], default=(0.0, self.transport))
        longest.abort()


class HurriedWebSocket(WebSocketsSansIOProtocol):
    """uvicorn's WebSocket, which by itself waits without end for who opens none, and for who takes nothing.

    What comes by here has passed for HTTP, and knows no token yet.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin to wait for the end of the handshake."""
        super().connection_made(transport)
        self._deadline = self.loop.call_later(REQUEST_S, self.transport.abort)

    def data_received(self, data: bytes) -> None:
        """Take what came; hang up on a request that HTTP allows and WebSocket does not, as one with a body."""
        super().data_received(data)
        if self.conn.handshake_exc is not None and not self.transport.is_closing():
            answer = b"".join(self.conn.data_to_send()) or self.conn.reject(400, "This opens no wire.\n").serialize()
            self.transport.write(answer)
            self.transport.close()

    def start_keepalive(self) -> None:
        """Wait no more: the wire is open."""
        self._cancel()
        super().start_keepalive()

    def keepalive_timeout(self) -> None:
        """Let a page go that answers no ping; what it has not taken yet is not waited for."""
        super().keepalive_timeout()
        self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        self._cancel()
        super().connection_lost(exc)

    def _cancel(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


def _own(cookies: bytes) -> bytes:
    return b";".join(each for each in cookies.split(b";") if each.strip().startswith(COOKIE.encode()))
