"""How a PostgreSQL server is reached: the address taken apart, the connection, and what its errors mean."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

from becalm.errors import BecalmError, InputError, OutputError, UsageError
from becalm.live.address import Address
from becalm.live.optional_libraries import wanted
from becalm.live.protocols import AwayError, StorageFullError

if TYPE_CHECKING:
    import psycopg

LONGEST_NAME = 63
"""Bytes of a name; PostgreSQL cuts off the rest in silence."""

_TLS = ("sslmode", "sslrootcert", "sslcert", "sslkey")
_TLS_MODES = ("disable", "allow", "prefer", "require", "verify-ca", "verify-full")
_FORM = "postgres://USER@HOST:PORT/DATABASE?table=NAME"
_ALIVE = {"connect_timeout": 10, "keepalives_idle": 15, "keepalives_interval": 5, "keepalives_count": 3}
_SILENT_MS = 30_000  # what was sent and not acknowledged by then makes the connection dead
_NOTICED = "-c tcp_keepalives_idle=15 -c tcp_keepalives_interval=5 -c tcp_keepalives_count=3"  # the server's own side

_REFUSALS = (
    "password authentication failed",
    "authentication failed",
    "no password supplied",
    "no pg_hba.conf entry",
    "does not exist",
    "is not permitted to log in",
    "permission denied",
    "does not support SSL",
    "certificate",
    "invalid",
)
"""What no waiting mends, as libpq and the server say it; no code comes with a refused connection."""

_FULL = ("53100", "58030")  # disk full, and failing to write as it may when it is
_AWAY = ("08", "53", "57P")  # classes: connection, resources, shutdown


@dataclass(frozen=True)
class TablePlace:
    """Where the tables are.

    Attributes
    ----------
    table : str
        The table of rows; the others are named after it.
    shown : str
        Server and database for a person, without user and password.
    asked : dict
        What libpq is told; no password.
    password_file : Path or None
        Holds the password, or the user and, below, the password.
    """

    table: str
    shown: str
    asked: dict[str, Any]
    password_file: Path | None


def place_of(address: Address) -> TablePlace:
    """Take an address apart.

    Raises
    ------
    UsageError
        If it names no database or table, or holds a password.
    """
    address.refuse_unknown(("table", "password_file", *_TLS))
    try:
        parts = urlsplit(f"postgres:{address.rest}")
        port = parts.port or 5432
    except ValueError as cause:
        raise UsageError(f"{address} has no host and port that can be read; write {_FORM}.") from cause
    if parts.password is not None:
        raise UsageError(
            f"{address} holds a password, which logs and lists of processes would show; put it into PGPASSWORD,"
            " ~/.pgpass or a file (&password_file=FILE)."
        )
    database, table = unquote(parts.path.lstrip("/")), address.options.get("table", "")
    if not address.rest.startswith("//") or not database or not table:
        raise UsageError(f"{address} does not name {'a table' if database else 'a database'}; write {_FORM}.")
    refuse_long(table, "_checkpoint")
    address.chosen("sslmode", _TLS_MODES, "prefer")
    host = parts.hostname or "127.0.0.1"
    asked: dict[str, Any] = {"host": host, "port": port, "dbname": database}
    asked |= {name: address.options[name] for name in _TLS if name in address.options}
    if parts.username:
        asked["user"] = unquote(parts.username)
    file = address.options.get("password_file")
    return TablePlace(table, f"{host}:{port}/{database}", asked, Path(file) if file else None)


def refuse_long(name: str, end: str = "") -> None:
    """Refuse a name that PostgreSQL would cut or cannot hold.

    Raises
    ------
    UsageError
        If it is one.
    """
    if "\0" in name or len((name + end).encode("utf-8", "surrogatepass")) > LONGEST_NAME:
        raise UsageError(
            f"PostgreSQL's names have at most {LONGEST_NAME} bytes, and {name + end!r} has more; shorten it."
        )


def connected(place: TablePlace) -> psycopg.Connection:
    """Return a new connection that commits for good.

    Raises
    ------
    AwayError
        If the server cannot be reached now.
    InputError
        If it never can: a wrong password, no such database, no such certificate.
    """
    library = driver()
    asked = {**place.asked, **_ALIVE, "tcp_user_timeout": _SILENT_MS, "options": _NOTICED}
    if place.password_file is not None:
        asked |= _login_in(place.password_file)
    try:
        connection: psycopg.Connection = library.connect(**asked, autocommit=True, application_name="becalm")
        connection.execute(
            "SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'"
        )
    except library.Error as cause:
        raise _unreached(place, cause) from cause
    return connection


def driver() -> Any:
    """Return the module psycopg.

    Raises
    ------
    UsageError
        If it is not installed.
    """
    return wanted("postgres:", "psycopg", extra="postgres")


def meant(place: TablePlace, cause: psycopg.Error, *, broken: bool) -> BecalmError:
    """Return what an error of an open connection means for who writes.

    Parameters
    ----------
    place : TablePlace
        Where to.
    cause : psycopg.Error
        What was raised.
    broken : bool
        Whether the connection is gone.
    """
    code, said = cause.sqlstate or "", _said(cause)
    if code in _FULL:
        return StorageFullError(f"The disk of PostgreSQL at {place.shown} has no room ({said}); make room there.")
    if broken or code.startswith(_AWAY):
        return AwayError(f"PostgreSQL at {place.shown} went away ({said}).")
    if code == "42501":
        return OutputError(f"PostgreSQL at {place.shown} does not let this user write ({said}); GRANT it there.")
    if code == "23505":
        return OutputError(f"Rows of this stream are in {place.table!r} already ({said}); give another table.")
    return OutputError(f"PostgreSQL at {place.shown} did not take what was written ({said}); nothing of it was kept.")


def _unreached(place: TablePlace, cause: psycopg.Error) -> BecalmError:
    said = _said(cause)
    needs_password = cause.pgconn is not None and cause.pgconn.needs_password
    if needs_password or any(words in said for words in _REFUSALS):
        return InputError(
            f"PostgreSQL at {place.shown} cannot be entered ({said}); the user stands before the host (USER@HOST), the"
            " password in PGPASSWORD, ~/.pgpass or password_file=FILE."
        )
    return AwayError(f"PostgreSQL at {place.shown} cannot be reached now ({said}).")


def _said(cause: psycopg.Error) -> str:
    """Return what the server or libpq said in one line."""
    return " ".join((cause.diag.message_primary or str(cause)).split())[:300].rstrip(".")


def _login_in(path: Path) -> dict[str, str]:
    """Return the password, and the user before it where there are two lines."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as cause:
        raise InputError(f"The password file {path} cannot be read; give one that holds the password.") from cause
    if len(lines) not in (1, 2):
        raise InputError(f"The password file {path} has {len(lines)} lines; write the password, or the user above it.")
    return dict(zip(("user", "password")[-len(lines) :], lines, strict=True))
