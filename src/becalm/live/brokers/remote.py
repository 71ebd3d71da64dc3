"""Brokers as addresses name them: host, port, who may enter, and how the way there is kept private."""

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

OPTIONS = ("password_file", "tls", "ca", "cert", "key")


@dataclass(frozen=True)
class Login:
    """Who enters; None where nobody is asked. Never shown.

    Attributes
    ----------
    user, password, token : str or None
        As the environment or a file tells them.
    """

    user: str | None = field(default=None, repr=False)
    password: str | None = field(default=None, repr=False)
    token: str | None = field(default=None, repr=False)


@dataclass(frozen=True)
class Remote:
    """A broker: `KIND://HOST:PORT/PATH`.

    Options: `tls=1`, `ca=FILE`, `cert=FILE`, `key=FILE`, for privacy and a certificate of one's own;
    `password_file=FILE` (user and password, a line each), else BECALM_KIND_USER and BECALM_KIND_PASSWORD of the
    environment, as BECALM_MQTT_USER. NATS also has `creds=FILE` and BECALM_NATS_TOKEN.

    Attributes
    ----------
    address : Address
        As it was named.
    host : str
        Where; 127.0.0.1 where none is named.
    port : int
        Which port; the usual one where none is named.
    path : str
        What stands behind the host, without its slash: a topic, a stream.
    """

    address: Address
    host: str
    port: int
    path: str

    @classmethod
    def parsed(cls, address: Address, port: int, tls_port: int) -> Remote:
        """Take `//host:port/path` apart.

        Raises
        ------
        UsageError
            If it is none, or holds a user or password: addresses are shown and kept.
        """
        if not address.rest.startswith("//"):
            raise UsageError(f"{address} names no host; write {address.kind}://HOST:{port}/...")
        authority = address.rest[2:].partition("/")[0]
        if "@" in authority:
            name = variable(address, "USER"), variable(address, "PASSWORD")
            raise UsageError(
                f"{address} came with a user or password in it, and addresses are written to logs; set "
                f"{name[0]} and {name[1]} in the environment, or name a file by password_file=FILE."
            )
        try:
            parts = urlsplit(address.rest, allow_fragments=False)
            told = parts.port
        except ValueError as cause:
            raise UsageError(
                f"{address} has no port from 0 to 65535; write {address.kind}://HOST:{port}/..."
            ) from cause
        usual = tls_port if _private(address) else port
        return cls(address, parts.hostname or "127.0.0.1", told or usual, unquote(parts.path[1:]))

    def login(self) -> Login:
        """Return who enters: by `?password_file=` (user and password, a line each), else by the environment.

        Raises
        ------
        UsageError
            If the file cannot be read, or has not two lines.
        """
        named = self.address.options.get("password_file")
        if named is None:
            told = (os.environ.get(variable(self.address, what)) for what in ("USER", "PASSWORD", "TOKEN"))
            return Login(*told)
        try:
            lines = Path(named).read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as cause:
            raise UsageError(
                f"password_file={named} cannot be read; it needs a user and a password, a line each."
            ) from cause
        if len(lines) != 2:
            raise UsageError(
                f"password_file={named} has {len(lines)} lines; write the user and the password, a line each."
            )
        return Login(*lines)

    def tls(self) -> ssl.SSLContext | None:
        """Return how the way is kept private; None where it is not.

        Raises
        ------
        UsageError
            If a certificate or key cannot be read.
        """
        if not _private(self.address):
            return None
        import ssl

        options = self.address.options
        if "key" in options and "cert" not in options:
            raise UsageError(f"{self.address.kind}: key= needs the certificate that it belongs to: cert=FILE.")
        try:
            context = ssl.create_default_context(cafile=options.get("ca"))
            if "cert" in options:
                context.load_cert_chain(options["cert"], options.get("key"))
        except OSError as cause:  # ssl.SSLError is one
            raise UsageError(f"The certificates of {self.address} cannot be read: {cause}.") from cause
        return context

    def away(self, why: object) -> AwayError:
        """Return the error that says that nobody is there now."""
        said = str(why) or "it does not answer"  # of a TimeoutError, which has no words
        return AwayError(f"{self.address.kind}: {self.host}:{self.port} cannot be reached now: {said}.")

    def failed(self, cause: BaseException, *, reached: bool) -> BecalmError:
        """Return what a failure to connect means: away, or never to be reached like this.

        Parameters
        ----------
        cause : BaseException
            What the operating system or the library raised.
        reached : bool
            Whether it was reached before: then an unknown name is a broken network, not a slip of the pen.
        """
        import ssl

        where = f"{self.host}:{self.port}"
        if isinstance(cause, ssl.SSLCertVerificationError):
            return InputError(
                f"The certificate of {where} is not trusted: {cause.verify_message}. "
                "Name the authority that signed it by ca=FILE, and the host as its certificate does."
            )
        if isinstance(cause, ssl.SSLError) and not isinstance(cause, ssl.SSLEOFError | ssl.SSLZeroReturnError):
            return InputError(
                f"{where} does not speak TLS as it must: {cause.reason}. Check the port, tls, ca and cert."
            )
        if isinstance(cause, socket.gaierror) and cause.errno == socket.EAI_NONAME and not reached:
            return InputError(f"There is no host {self.host!r}; check its name in {self.address}.")
        return self.away(cause)


def variable(address: Address, what: str) -> str:
    """Return the environment variable that holds a secret of a kind of address: BECALM_MQTT_PASSWORD."""
    return f"BECALM_{address.kind.upper()}_{what}"


def _private(address: Address) -> bool:
    """Whether TLS is asked for: by tls=1, or by naming certificates."""
    asked = address.chosen("tls", ("0", "1"), "1" if {"ca", "cert", "key"} & set(address.options) else "0")
    return asked == "1"
