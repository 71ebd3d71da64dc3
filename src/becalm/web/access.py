"""Decide by host name and token whether a request may open a page."""

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
COOKIE = "becalm-"  # prefix of the cookie's name; the port follows
_DEFAULT_PORT = 80  # browsers leave this port out of the Host header
_ANYWHERE = ("0.0.0.0", "::")  # hosts that mean all addresses of this machine
_TICKET_S = 30.0  # a ticket is valid for this long; a browser starts in less
_WATCHED_S = 600.0  # a ticket that is used again within this time counts as stolen; later it is only refused
_REUSED = (
    "The address that becalm gave the browser was used twice: another user of this machine may have opened the page."
    " The page is now closed to everyone; end becalm, remove the file of --token-file if it has one, and start again."
)
_TOKEN = re.compile(r"[A-Za-z0-9_-]{22,256}")  # at least 128 bits, and safe in an address or a cookie


class AccessOptions(NamedTuple):
    """The names of the command-line options for the host and the port of a page."""

    host: str
    port: str


class PageOptions(NamedTuple):
    """The port, the host and the token file of a page, from the command line."""

    port: int
    host: str
    token_file: Path | None


OPTIONS = AccessOptions("--host", "--port")
"""Option names of a command whose main purpose is a page."""


def address_of(host: str) -> str:
    """Return the address to listen at.

    "localhost" becomes 127.0.0.1: the name may have a second address, and a program that listens there would get the
    token.
    """
    return LOOPBACK if host.lower() == "localhost" else host.lower()


class TicketReusedError(BecalmError):
    """A ticket, which opens the page once, was used twice."""


class Access:
    """The address of a page, and the token that a browser needs to open it.

    Parameters
    ----------
    host : str
        Name or address to listen at, as the person typed it; "0.0.0.0" or "::" is every address of this machine.
    port : int
        Port to listen at.
    token : str
        Secret that the browser must send.
    options : AccessOptions
        Names of the options for host and port, for error messages.
    """

    def __init__(self, host: str, port: int, token: str, options: AccessOptions = OPTIONS) -> None:
        self._options = options
        self.host, self.port = address_of(host), port
        self._token = token
        self._tickets: dict[str, float] = {}  # unused tickets: the monotonic time at which each was made
        self._spent: dict[str, float] = {}  # used tickets: the same times
        self.cookie = f"{COOKIE}{port}"
        own = {self.host} | ({"localhost", LOOPBACK, "::1"} if self.loopback or self.anywhere else set())
        self._names = {_in_url(name) for name in (own | {socket.gethostname().lower()} if self.anywhere else own)}

    @property
    def loopback(self) -> bool:
        """Return whether only this machine can reach the page."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def anywhere(self) -> bool:
        """Return whether the page listens at every address of this machine."""
        return self.host in _ANYWHERE

    @property
    def url(self) -> str:
        """Return the address of the page, with the token."""
        return f"{self._origin}/?token={self._token}"

    @property
    def warning(self) -> str | None:
        """Return a warning if other machines can reach the page."""
        if self.loopback:
            return None
        return (
            f"The page is open to other machines at {self._origin}, without TLS: anyone who listens to that network can"
            f" read the token and all data. If other people use the network, leave {self._options.host} out, and"
            f" connect to this machine with ssh -L {self.port}:{LOOPBACK}:{self.port} instead."
        )

    def ticket(self) -> str:
        """Return an address for the arguments of a browser, which other users can see; it works once, within 30 s."""
        ticket = secrets.token_urlsafe()
        self._tickets[ticket] = time.monotonic()
        return f"http://{LOOPBACK if self.anywhere else _in_url(self.host)}:{self.port}/?token={ticket}"

    def admits(self, secret: str) -> bool:
        """Return whether the secret in a request is the token or a valid ticket.

        Raises
        ------
        TicketReusedError
            If a ticket is used a second time: one of the two senders was not the browser. Afterwards no request is
            admitted.
        """
        now = time.monotonic()
        if any(_same(secret, ticket) and now - made < _WATCHED_S for ticket, made in self._spent.items()):
            self._token = secrets.token_urlsafe(32)  # nobody gets the new token
            self._tickets.clear()
            raise TicketReusedError(_REUSED)
        for ticket, made in list(self._tickets.items()):
            if _same(secret, ticket) and now - made < _TICKET_S:
                self._spent[ticket] = self._tickets.pop(ticket)
                return True
        return self.is_token(secret)

    def is_token(self, secret: str) -> bool:
        """Return whether the secret in a cookie is the token."""
        return _same(secret, self._token)

    def set_cookie(self) -> str:
        """Return the value of a Set-Cookie header; other sites cannot send the cookie, and scripts cannot read it."""
        return f"{self.cookie}={self._token}; Path=/; HttpOnly; SameSite=Strict"

    def is_own_host(self, host: str) -> bool:
        """Return whether a Host header has a name of this page; another name may be a DNS rebinding attack.

        Parameters
        ----------
        host : str
            The Host header. A page at every address of this machine accepts all IP addresses: DNS cannot rebind them.
        """
        name = host.lower().removesuffix(f":{self.port}")
        if name == host.lower() and self.port != _DEFAULT_PORT:
            return False
        return name in self._names or (self.anywhere and _is_address(name))

    @staticmethod
    def same_origin(origin: str, host: str) -> bool:
        """Return whether a request was sent by a page of the host that it is sent to."""
        return origin.lower() == f"http://{host.lower()}"

    @property
    def _origin(self) -> str:
        return f"http://{_in_url(socket.gethostname() if self.anywhere else self.host)}:{self.port}"


def token_of(path: Path | None) -> str:
    """Return a new token, or the token in a file; a missing file is created, readable by its owner only.

    Raises
    ------
    UsageError
        If the file cannot be read or written, belongs to another user or can be read by one, or contains no token.
    """
    new = secrets.token_urlsafe(32)
    if path is None:
        return new
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(f"{new}\n")
        return new
    except FileExistsError:
        return _read_token(path)
    except OSError as cause:
        raise UsageError(
            f"{path} cannot be written ({cause.strerror}); give another file with --token-file."
        ) from cause


def _read_token(path: Path) -> str:
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            text = file.read(1000).decode("ascii", "replace").strip()
    except OSError as cause:
        raise UsageError(f"{path} cannot be read ({cause.strerror}); give another --token-file.") from cause
    if os.name == "posix" and stat.S_IMODE(status.st_mode) & 0o077:
        raise UsageError(f"{path} can be read by others, so its token is not secret; type: rm {path}")
    if os.name == "posix" and status.st_uid != os.geteuid():
        raise UsageError(f"{path} belongs to another user, who knows its token; give another --token-file.")
    if not _TOKEN.fullmatch(text):
        raise UsageError(
            f"{path} does not contain a token of at least 22 letters, digits, - and _; remove it, and becalm makes one."
        )
    return text


def _same(secret: str, wanted: str) -> bool:
    return hmac.compare_digest(secret.encode("utf-8", "replace"), wanted.encode())


def _in_url(name: str) -> str:
    """Return a host in the form of a URL: with brackets around an IPv6 address."""
    return f"[{name}]" if ":" in name else name


def _is_address(written: str) -> bool:
    try:
        return bool(ipaddress.ip_address(written.removeprefix("[").removesuffix("]")))
    except ValueError:
        return False
