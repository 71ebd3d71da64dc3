"""Who may see a page: its address, the names that it is asked for by, and the token."""

from __future__ import annotations

import hmac
import ipaddress
import os
import re
import secrets
import socket
import stat
import time
from pathlib import Path
from typing import NamedTuple

from becalm.errors import BecalmError, UsageError

LOOPBACK = "127.0.0.1"
COOKIE = "becalm-"  # and the port
_PORT_UNSAID = 80  # which browsers leave out
_ANYWHERE = ("0.0.0.0", "::")
_TICKET_S = 30.0  # for a browser to start
_WATCHED_S = 600.0  # no browser is later than that: a ticket that comes again has been stolen before, not now
_STOLEN = (
    "The address that becalm gave the browser was used twice: somebody else on this machine may have opened the page."
    " Nobody is let in any more; end becalm, remove the file of --token-file if it has one, and start it again."
)
_TOKEN = re.compile(r"[A-Za-z0-9_-]{22,256}")  # of 128 bits and more, and harmless in an address or a cookie


class AccessOptions(NamedTuple):
    """What a person types to say where a page is."""

    host: str
    port: str


class PageAsked(NamedTuple):
    """Where a page shall be."""

    port: int
    host: str
    token_file: Path | None


OPTIONS = AccessOptions("--host", "--port")
"""Of a command that is there for its page."""


def address_of(host: str) -> str:
    """Return where to listen: "localhost" may be two addresses, and who took the other one would be sent our token."""
    return LOOPBACK if host.lower() == "localhost" else host.lower()


class StolenError(BecalmError):
    """An address that opens the page once was used twice."""


class Access:
    """Where a page is, and what a browser must bring to see it.

    Parameters
    ----------
    host : str
        Where it listens, as a person said it: a name or an address; "0.0.0.0" or "::" is every address of this machine.
    port : int
        Where it listens.
    token : str
        What the browser must bring.
    options : AccessOptions
        Where a person said the first two.
    """

    def __init__(self, host: str, port: int, token: str, options: AccessOptions = OPTIONS) -> None:
        self._options = options
        self.host, self.port = address_of(host), port
        self._token = token
        self._tickets: dict[str, float] = {}  # and when each was made
        self._spent: dict[str, float] = {}
        self.cookie = f"{COOKIE}{port}"
        own = {self.host} | ({"localhost", LOOPBACK, "::1"} if self.loopback or self.anywhere else set())
        self._names = {_written(name) for name in (own | {socket.gethostname().lower()} if self.anywhere else own)}

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach it."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def anywhere(self) -> bool:
        """Whether it listens at every address of this machine."""
        return self.host in _ANYWHERE

    @property
    def url(self) -> str:
        """What to open, with the token."""
        return f"{self._origin}/?token={self._token}"

    @property
    def warning(self) -> str | None:
        """What a person must know who lets other machines in."""
        if self.loopback:
            return None
        return (
            f"The page is open to other machines at {self._origin}, without TLS: whoever listens to that network can"
            f" read the token and all data. Where others use the network, leave {self._options.host} out, and reach"
            f" this machine from the other by ssh -L {self.port}:{LOOPBACK}:{self.port} instead."
        )

    def ticket(self) -> str:
        """Return an address that opens the page once, and soon: other users see what a browser is started with."""
        ticket = secrets.token_urlsafe()
        self._tickets[ticket] = time.monotonic()
        return f"http://{LOOPBACK if self.anywhere else _written(self.host)}:{self.port}/?token={ticket}"

    def admits(self, brought: str) -> bool:
        """Whether this is the token, or a ticket that serves now.

        Raises
        ------
        StolenError
            If a ticket came before: one of the two was not the browser, and from now on nobody is known.
        """
        now = time.monotonic()
        if any(_same(brought, ticket) and now - made < _WATCHED_S for ticket, made in self._spent.items()):
            self._token = secrets.token_urlsafe(32)  # that nobody is told
            self._tickets.clear()
            raise StolenError(_STOLEN)
        for ticket, made in list(self._tickets.items()):
            if _same(brought, ticket) and now - made < _TICKET_S:
                self._spent[ticket] = self._tickets.pop(ticket)
                return True
        return self.knows(brought)

    def knows(self, brought: str) -> bool:
        """Whether this is what the cookie holds."""
        return _same(brought, self._token)

    def set_cookie(self) -> str:
        """Return the header that leaves the token with a browser, for no other site to use and no script to read."""
        return f"{self.cookie}={self._token}; Path=/; HttpOnly; SameSite=Strict"

    def ours(self, host: str) -> bool:
        """Whether a page was asked for by a name of ours: a foreign one may have been made to lead here (rebinding).

        Parameters
        ----------
        host : str
            The header Host. Where we listen anywhere every address is ours, as no name could be bound to it.
        """
        name = host.lower().removesuffix(f":{self.port}")
        if name == host.lower() and self.port != _PORT_UNSAID:
            return False
        return name in self._names or (self.anywhere and _is_address(name))

    @staticmethod
    def same_origin(origin: str, host: str) -> bool:
        """Whether a request comes from the page that it asks."""
        return origin.lower() == f"http://{host.lower()}"

    @property
    def _origin(self) -> str:
        return f"http://{_written(socket.gethostname() if self.anywhere else self.host)}:{self.port}"


def token_of(path: Path | None) -> str:
    """Return a new token; or that of a file, which is made where it is not there, for its owner only.

    Raises
    ------
    UsageError
        If others may read the file, or it holds no token.
    """
    new = secrets.token_urlsafe(32)
    if path is None:
        return new
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(f"{new}\n")
        return new
    except FileExistsError:
        return _kept(path)
    except OSError as cause:
        raise UsageError(f"{path} cannot be written ({cause.strerror}); name another with --token-file.") from cause


def _kept(path: Path) -> str:
    try:
        with path.open("rb") as file:
            found = os.fstat(file.fileno())
            text = file.read(1000).decode("ascii", "replace").strip()
    except OSError as cause:
        raise UsageError(f"{path} cannot be read ({cause.strerror}); name another with --token-file.") from cause
    if os.name == "posix" and stat.S_IMODE(found.st_mode) & 0o077:
        raise UsageError(f"{path} can be read by others, so what it holds is no secret; type: rm {path}")
    if os.name == "posix" and found.st_uid != os.geteuid():
        raise UsageError(f"{path} belongs to another user, who knows what it holds; name another with --token-file.")
    if not _TOKEN.fullmatch(text):
        raise UsageError(f"{path} holds no token: 22 letters, digits, - and _ or more; remove it, and one is made.")
    return text


def _same(brought: str, wanted: str) -> bool:
    return hmac.compare_digest(brought.encode("utf-8", "replace"), wanted.encode())


def _written(name: str) -> str:
    """Return a name as addresses have it."""
    return f"[{name}]" if ":" in name else name


def _is_address(written: str) -> bool:
    try:
        return bool(ipaddress.ip_address(written.removeprefix("[").removesuffix("]")))
    except ValueError:
        return False
