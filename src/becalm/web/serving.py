"""Listen at a port, and serve a page there from a thread."""

from __future__ import annotations

import errno
import socket
import threading
from types import TracebackType
from typing import TYPE_CHECKING, Self

import uvicorn

from becalm.errors import UsageError
from becalm.web.access import OPTIONS, AccessOptions, address_of
from becalm.web.sockets import TimeLimitedHttp, TimeLimitedWebSocket

if TYPE_CHECKING:
    from starlette.types import ASGIApp

MAX_MESSAGE_BYTES = 1 << 20  # size limit of a message from a page
PING_S = 20.0  # time between two pings, and time limit for the answer of a page
_PORTS, _FIRST_FREE = 1 << 16, 1024  # number of ports, and the first that needs no permission
_HEADERS_BYTES = 1 << 16  # size limit of headers; browsers send the cookies of all ports
_ENDING_S = 1  # how long the server waits for unfinished answers when it ends
_PATIENCE_S = 4.0  # how long `close` waits for the thread of the server, which may be computing


class PortInUseError(UsageError):
    """Another program listens at the port."""


def listen(host: str, port: int, options: AccessOptions = OPTIONS) -> socket.socket:
    """Return a socket that listens at a port.

    Parameters
    ----------
    host : str
        Name or address of this machine; "0.0.0.0" or "::" for all addresses.
    port : int
        Port number; 0 means any free port.
    options : AccessOptions
        Names of the options for host and port, for error messages.

    Raises
    ------
    UsageError
        If the socket cannot listen there; a PortInUseError if another program uses the port.
    """
    wanted = f"No page can be served at {host}, port {port}"
    way_out = f"give another port with {options.port}, or 0 for any free one."
    if not 0 <= port < _PORTS:
        raise UsageError(f"{wanted}: the highest port is {_PORTS - 1}; {way_out}")
    try:
        found = socket.getaddrinfo(address_of(host), port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, _, _, _, address = found[0]
        both = family == socket.AF_INET6 and host == "::" and socket.has_dualstack_ipv6()
        return socket.create_server(address[:2], family=family, dualstack_ipv6=both)
    except OSError as cause:
        if cause.errno == errno.EADDRINUSE or (cause.errno == errno.EACCES and port >= _FIRST_FREE):
            raise PortInUseError(f"{wanted}: another program uses it; {way_out}") from cause
        why = str(cause.strerror).partition(" (while")[0]
        raise UsageError(
            f"{wanted} ({why}); give a name of this machine with {options.host}, and a port with {options.port}."
        ) from cause
    except UnicodeError as cause:
        raise UsageError(f"{host!r} is not a host name; give a name of this machine with {options.host}.") from cause


class Server:
    """Serves an application from a thread, until it is closed.

    Parameters
    ----------
    listener : socket
        Socket from `listen`; `close` closes it.
    app : ASGI application
        Application to serve.
    """

    def __init__(self, listener: socket.socket, app: ASGIApp) -> None:
        self._listener = listener
        config = uvicorn.Config(
            app,
            loop="asyncio",
            http=TimeLimitedHttp,
            ws=TimeLimitedWebSocket,
            lifespan="off",
            interface="asgi3",
            log_config=None,
            log_level="critical",  # clients' errors are not logged; the guard logs those of becalm
            access_log=False,
            proxy_headers=False,
            server_header=False,
            backlog=128,
            timeout_graceful_shutdown=_ENDING_S,
            h11_max_incomplete_event_size=_HEADERS_BYTES,
            ws_max_size=MAX_MESSAGE_BYTES,
            ws_ping_interval=PING_S,
            ws_ping_timeout=PING_S,
            ws_per_message_deflate=False,  # arrays of numbers hardly compress
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([listener],), name="page", daemon=True)

    def start(self) -> None:
        """Start to answer requests, including those that arrived since `listen`."""
        self._thread.start()

    def close(self) -> None:
        """Stop the server; a second call does nothing."""
        self._server.should_exit = True
        if self._thread.is_alive():
            self._thread.join(_PATIENCE_S)
        self._listener.close()

    def __enter__(self) -> Self:
        """Start the server."""
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, cause: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the server."""
        self.close()
