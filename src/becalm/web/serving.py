"""A server of its own: it holds its port before anyone is told of it, and runs in a thread beside the work."""

from __future__ import annotations

import errno
import socket
import threading
from types import TracebackType
from typing import TYPE_CHECKING, Self

import uvicorn

from becalm.errors import UsageError
from becalm.web.access import OPTIONS, AccessOptions, address_of
from becalm.web.sockets import HurriedProtocol, HurriedWebSocket

if TYPE_CHECKING:
    from starlette.types import ASGIApp

MOST_SAID_BYTES = 1 << 20  # in a message of a page
PING_S = 20.0  # how often a page must show that it is there, and how long it may take to
_PORTS = 1 << 16
_HEADERS_BYTES = 1 << 16  # browsers send the cookies of all ports
_ENDING_S = 1  # for answers on their way when the server ends
_PATIENCE_S = 4.0  # for its thread to end, which may be computing


class TakenError(UsageError):
    """Another program listens there."""


def listen(host: str, port: int, options: AccessOptions = OPTIONS) -> socket.socket:
    """Take a port.

    Parameters
    ----------
    host : str
        A name or an address of this machine; "0.0.0.0" or "::" for all.
    port : int
        0 takes any that is free.
    options : AccessOptions
        Where a person says both.

    Raises
    ------
    UsageError
        If it cannot be had; a TakenError where another program has it.
    """
    wanted = f"No page can be served at {host}, port {port}"
    way_out = f"name another with {options.port}, or 0 for any free one."
    if not 0 <= port < _PORTS:
        raise UsageError(f"{wanted}: ports end at {_PORTS - 1}; {way_out}")
    try:
        found = socket.getaddrinfo(address_of(host), port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, _, _, _, address = found[0]
        both = family == socket.AF_INET6 and host == "::" and socket.has_dualstack_ipv6()
        return socket.create_server(address[:2], family=family, dualstack_ipv6=both)
    except OSError as cause:
        if cause.errno == errno.EADDRINUSE:
            raise TakenError(f"{wanted}: another program is there; {way_out}") from cause
        why = str(cause.strerror).partition(" (while")[0]
        raise UsageError(
            f"{wanted} ({why}); name this machine with {options.host}, and a port with {options.port}."
        ) from cause
    except UnicodeError as cause:
        raise UsageError(f"{host!r} is no name of a machine; name this one with {options.host}.") from cause


class Server:
    """Serves an application from a thread, until it is closed.

    Parameters
    ----------
    listener : socket
        Of `listen`; it is closed with the server.
    app : ASGI application
        What is served.
    """

    def __init__(self, listener: socket.socket, app: ASGIApp) -> None:
        self._listener = listener
        config = uvicorn.Config(
            app,
            loop="asyncio",
            http=HurriedProtocol,
            ws=HurriedWebSocket,
            lifespan="off",
            interface="asgi3",
            log_config=None,
            log_level="critical",  # strangers' mistakes are no news; what fails in becalm the guard tells
            access_log=False,
            proxy_headers=False,
            server_header=False,
            backlog=128,
            timeout_graceful_shutdown=_ENDING_S,
            h11_max_incomplete_event_size=_HEADERS_BYTES,
            ws_max_size=MOST_SAID_BYTES,
            ws_ping_interval=PING_S,
            ws_ping_timeout=PING_S,
            ws_per_message_deflate=False,  # numbers hardly shrink
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([listener],), name="page", daemon=True)

    def start(self) -> None:
        """Begin to answer; who asked since the port was taken is answered now."""
        self._thread.start()

    def close(self) -> None:
        """Stop answering; harmless twice."""
        self._server.should_exit = True
        if self._thread.is_alive():
            self._thread.join(_PATIENCE_S)
        self._listener.close()

    def __enter__(self) -> Self:
        """Begin to answer."""
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, cause: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop answering."""
        self.close()
