"""The address of a broker: host, port, path, login and TLS."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from becalm.errors import BecalmError, InputError, UsageError
from becalm.live.address import Address
from becalm.live.protocols import AwayError

if TYPE_CHECKING:
    import ssl

OPTIONS = ("password_file", "tls", "ca", "cert", "key")  # names of the options of `Remote`


@dataclass(frozen=True)
class Login:
    """The login at a broker. Its `repr` does not show the secrets.

    Attributes
    ----------
    user, password, token : str or None
        Values from the environment or a file; None if absent.
    """

    user: str | None = field(default=None, repr=False)
    password: str | None = field(default=None, repr=False)
    token: str | None = field(default=None, repr=False)


@dataclass(frozen=True)
class Remote:
    """A broker: `KIND://HOST:PORT/PATH`.

    Options: `tls=1`, `ca=FILE`, `cert=FILE`, `key=FILE` for TLS and a client certificate; `password_file=FILE` (user
    and password, one per line), else the environment variables BECALM_KIND_USER and BECALM_KIND_PASSWORD, such as
    BECALM_MQTT_USER. NATS also has `creds=FILE` and BECALM_NATS_TOKEN.

    Attributes
    ----------
    address : Address
        The parsed command-line address.
    host : str
        Host name; 127.0.0.1 by default.
    port : int
        Port; by default the standard port of the protocol.
    path : str
        Text after the host, without the slash: a topic, a stream.
    """

    address: Address
    host: str
    port: int
    path: str

    @classmethod
    def parsed(cls, address: Address, port: int, tls_port: int) -> Remote:
        """Parse `//host:port/path`.

        Raises
        ------
        UsageError
            If the address has another form, or contains a user or password, because addresses are logged and stored.
        """
        if not address.rest.startswith("//"):
            raise UsageError(f"{address} names no host; write {address.kind}://HOST:{port}/...")
        authority = address.rest[2:].partition("/")[0]
        if "@" in authority:
            name = variable(address, "USER"), variable(address, "PASSWORD")
            raise UsageError(
                f"{address} contains a user or password, but addresses are written to logs; set "
                f"{name[0]} and {name[1]} in the environment, or give a file by password_file=FILE."
            )
        try:
            parts = urlsplit(address.rest, allow_fragments=False)
            explicit_port = parts.port
        except ValueError as cause:
            raise UsageError(
                f"{address} has no port from 0 to 65535; write {address.kind}://HOST:{port}/..."
            ) from cause
        default_port = tls_port if _uses_tls(address) else port
        return cls(address, parts.hostname or "127.0.0.1", explicit_port or default_port, unquote(parts.path[1:]))

    def login(self) -> Login:
        """Return the login from `?password_file=` (user and password, one per line), else from the environment.

        Raises
        ------
        UsageError
            If the file cannot be read, or does not have two lines.
        """
        path = self.address.options.get("password_file")
        if path is None:
            values = (os.environ.get(variable(self.address, what)) for what in ("USER", "PASSWORD", "TOKEN"))
            return Login(*values)
        try:
            lines = Path(path).read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as cause:
            raise UsageError(
                f"password_file={path} cannot be read; give a file with the user and the password, one per line."
            ) from cause
        if len(lines) != 2:
            raise UsageError(
                f"password_file={path} has {len(lines)} lines; write the user and the password, one per line."
            )
        return Login(*lines)

    def tls(self) -> ssl.SSLContext | None:
        """Return the TLS context; None without TLS.

        Raises
        ------
        UsageError
            If a certificate or key cannot be read.
        """
        if not _uses_tls(self.address):
            return None
        import ssl

        options = self.address.options
        if "key" in options and "cert" not in options:
            raise UsageError(f"{self.address.kind}: key= needs its certificate; add cert=FILE.")
        try:
            context = ssl.create_default_context(cafile=options.get("ca"))
            if "cert" in options:
                context.load_cert_chain(options["cert"], options.get("key"))
        except OSError as cause:  # includes ssl.SSLError
            raise UsageError(f"The certificates of {self.address} cannot be read: {cause}.") from cause
        return context

    def away(self, why: object) -> AwayError:
        """Return the error for a broker that cannot be reached now."""
        reason = str(why) or "it does not answer"  # a TimeoutError has no text
        return AwayError(f"{self.address.kind}: {self.host}:{self.port} cannot be reached now: {reason}.")

    def failed(self, cause: BaseException, *, reached: bool) -> BecalmError:
        """Return the error to raise for a failed connection: temporary or permanent.

        Parameters
        ----------
        cause : BaseException
            Error of the operating system or the library.
        reached : bool
            True if the broker was reached before; an unknown host is then a network failure, not a typing error.
        """
        import ssl

        where = f"{self.host}:{self.port}"
        if isinstance(cause, ssl.SSLCertVerificationError):
            return InputError(
                f"The certificate of {where} is not trusted: {cause.verify_message}. "
                "Give the authority that signed it by ca=FILE, and the host name that is in the certificate."
            )
        if isinstance(cause, ssl.SSLError) and not isinstance(cause, ssl.SSLEOFError | ssl.SSLZeroReturnError):
            return InputError(
                f"The TLS connection to {where} failed: {cause.reason}. Check the port, tls, ca and cert."
            )
        if isinstance(cause, socket.gaierror) and cause.errno == socket.EAI_NONAME and not reached:
            return InputError(f"There is no host {self.host!r}; check its name in {self.address}.")
        return self.away(cause)


def variable(address: Address, what: str) -> str:
    """Return the name of an environment variable with a secret, for example BECALM_MQTT_PASSWORD."""
    return f"BECALM_{address.kind.upper()}_{what}"


def _uses_tls(address: Address) -> bool:
    """Return whether an address requires TLS: by tls=1, or by an option for certificates without tls=0."""
    tls = address.chosen("tls", ("0", "1"), "1" if {"ca", "cert", "key"} & set(address.options) else "0")
    return tls == "1"
