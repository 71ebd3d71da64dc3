"""HTTP and WebSocket connections with time limits, so that idle clients cannot use up all sockets."""

from __future__ import annotations

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from becalm.web.access import COOKIE

REQUEST_S = 10.0  # time limit for the headers of a request, and for the handshake of a WebSocket
MOST_SOCKETS = 200  # limit of connections; every system allows a process at least 256 open files


class TimeLimitedHttp(H11Protocol):
    """The HTTP protocol of uvicorn with a time limit for requests; uvicorn does not limit a connection's first request.

    A client that sends no request, or sends its headers byte by byte, is disconnected after `REQUEST_S`. If there are
    more than `MOST_SOCKETS` connections, the connection whose time limit ends first is closed; if no connection has a
    time limit, the new one is closed.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # same as in uvicorn
        """Start the time limit for a request."""
        super().connection_made(transport)
        if len(self.connections) > MOST_SOCKETS:
            self._make_room()
        self._update_deadline()

    def data_received(self, data: bytes) -> None:
        """Process data, which may complete a request's headers or begin the next request."""
        super().data_received(data)
        self._update_deadline()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Switch to a WebSocket; remove cookies of other pages, because it accepts only a few kilobytes of headers."""
        self.headers = [(name, _becalm_cookies(value) if name == b"cookie" else value) for name, value in self.headers]
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel the time limit."""
        self._cancel()
        super().connection_lost(exc)

    def _update_deadline(self) -> None:
        if self.conn.their_state is not h11.IDLE:  # the headers are complete, or invalid
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
            if isinstance(other, TimeLimitedHttp | TimeLimitedWebSocket) and other._deadline is not None
        ]
        _, longest = min(waiting, key=lambda pair: pair[0], default=(0.0, self.transport))
        longest.abort()


class TimeLimitedWebSocket(WebSocketsSansIOProtocol):
    """The WebSocket protocol of uvicorn with time limits for the handshake and for pings, which uvicorn lacks.

    The requests that it gets are valid HTTP, but their tokens are not checked yet.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start the time limit for the handshake."""
        super().connection_made(transport)
        self._deadline = self.loop.call_later(REQUEST_S, self.transport.abort)

    def data_received(self, data: bytes) -> None:
        """Process data; reject a request that HTTP allows and WebSocket does not, such as one with a body."""
        super().data_received(data)
        if self.conn.handshake_exc is not None and not self.transport.is_closing():
            refusal = self.conn.reject(400, "This request cannot open a WebSocket.\n")
            answer = b"".join(self.conn.data_to_send()) or refusal.serialize()
            self.transport.write(answer)
            self.transport.close()

    def start_keepalive(self) -> None:
        """Cancel the time limit, because the WebSocket is open."""
        self._cancel()
        super().start_keepalive()

    def keepalive_timeout(self) -> None:
        """Disconnect a page that does not answer a ping, without sending the data that it has not received yet."""
        super().keepalive_timeout()
        self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel the time limit."""
        self._cancel()
        super().connection_lost(exc)

    def _cancel(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


def _becalm_cookies(cookies: bytes) -> bytes:
    return b";".join(each for each in cookies.split(b";") if each.strip().startswith(COOKIE.encode()))
