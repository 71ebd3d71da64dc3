"""Connect to a PostgreSQL server: parse the address, open the connection, and translate its errors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

from becalm.errors import BecalmError, InputError, OutputError, UsageError
from becalm.live.address import Address
from becalm.live.optional_libraries import import_optional
from becalm.live.protocols import AwayError, StorageFullError

if TYPE_CHECKING:
    import psycopg

LONGEST_NAME = 63
"""Most bytes of a name; PostgreSQL silently truncates longer names."""

_TLS = ("sslmode", "sslrootcert", "sslcert", "sslkey")
_TLS_MODES = ("disable", "allow", "prefer", "require", "verify-ca", "verify-full")
_FORM = "postgres://USER@HOST:PORT/DATABASE?table=NAME"
# parameters of libpq in seconds; keepalives_count unanswered keepalives close the connection
_ALIVE = {"connect_timeout": 10, "keepalives_idle": 15, "keepalives_interval": 5, "keepalives_count": 3}
_SILENT_MS = 30_000  # milliseconds after which unacknowledged data closes the connection
_SERVER_OPTIONS = "-c tcp_keepalives_idle=15 -c tcp_keepalives_interval=5 -c tcp_keepalives_count=3"

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
"""Parts of messages of libpq and the server about permanent errors; a refused connection has no error code."""

_FULL = ("53100", "58030")  # SQLSTATE: disk full, and an I/O error, which a full disk can cause
_AWAY = ("08", "53", "57P")  # beginnings of SQLSTATE: connection, resources, shutdown


@dataclass(frozen=True)
class TablePlace:
    """The place of a stream's tables.

    Attributes
    ----------
    table : str
        Name of the table of rows; the other tables are named after it.
    shown : str
        Server and database for messages, without user and password.
    connect_options : dict
        Parameters for libpq, without the password.
    password_file : Path or None
        File with the password, or with the user in the first line and the password in the second.
    """

    table: str
    shown: str
    connect_options: dict[str, Any]
    password_file: Path | None


def place_of(address: Address) -> TablePlace:
    """Parse an address.

    Raises
    ------
    UsageError
        If it has no database or table, or contains a password.
    """
    address.refuse_unknown(("table", "password_file", *_TLS))
    try:
        parts = urlsplit(f"postgres:{address.rest}")
        port = parts.port or 5432
    except ValueError as cause:
        raise UsageError(f"{address} has no host and port that can be read; write {_FORM}.") from cause
    if parts.password is not None:
        raise UsageError(
            f"{address} contains a password, which logs and process lists would show; put it into PGPASSWORD,"
            " ~/.pgpass or a file (&password_file=FILE)."
        )
    database, table = unquote(parts.path.lstrip("/")), address.options.get("table", "")
    if not address.rest.startswith("//") or not database or not table:
        raise UsageError(f"{address} does not name {'a table' if database else 'a database'}; write {_FORM}.")
    refuse_long(table, "_checkpoint")
    address.chosen("sslmode", _TLS_MODES, "prefer")
    host = parts.hostname or "127.0.0.1"
    connect_options: dict[str, Any] = {"host": host, "port": port, "dbname": database}
    connect_options |= {name: address.options[name] for name in _TLS if name in address.options}
    if parts.username:
        connect_options["user"] = unquote(parts.username)
    file = address.options.get("password_file")
    return TablePlace(table, f"{host}:{port}/{database}", connect_options, Path(file) if file else None)


def refuse_long(name: str, end: str = "") -> None:
    """Check that PostgreSQL can hold a name with the suffix `end`.

    Raises
    ------
    UsageError
        If PostgreSQL would truncate it, or it contains a NUL character.
    """
    if "\0" in name or len((name + end).encode("utf-8", "surrogatepass")) > LONGEST_NAME:
        raise UsageError(
            f"PostgreSQL's names have at most {LONGEST_NAME} bytes, but {name + end!r} has more; shorten it."
        )


def connect_to(place: TablePlace) -> psycopg.Connection:
    """Return a new connection, whose commits wait for the server's disk.

    Raises
    ------
    AwayError
        If the server cannot be reached now.
    InputError
        If the server can never be reached: a wrong password, no such database, no such certificate or password file.
    """
    library = driver()
    parameters = {**place.connect_options, **_ALIVE, "tcp_user_timeout": _SILENT_MS, "options": _SERVER_OPTIONS}
    if place.password_file is not None:
        parameters |= _read_login(place.password_file)
    try:
        connection: psycopg.Connection = library.connect(**parameters, autocommit=True, application_name="becalm")
        connection.execute(
            "SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'"
        )
    except library.Error as cause:
        raise _connection_error(place, cause) from cause
    return connection


def driver() -> Any:
    """Return the module psycopg.

    Raises
    ------
    UsageError
        If it is not installed.
    """
    return import_optional("postgres:", "psycopg", extra="postgres")


def error_of(place: TablePlace, cause: psycopg.Error, *, broken: bool) -> BecalmError:
    """Return the error to raise for an error of an open connection.

    Parameters
    ----------
    place : TablePlace
        Place of the tables.
    cause : psycopg.Error
        Error of the connection.
    broken : bool
        True if the connection is lost.
    """
    code, reason = cause.sqlstate or "", _message_of(cause)
    if code in _FULL:
        return StorageFullError(f"The disk of PostgreSQL at {place.shown} is full ({reason}); free some space there.")
    if broken or code.startswith(_AWAY):
        return AwayError(f"The connection to PostgreSQL at {place.shown} was lost ({reason}).")
    if code == "42501":
        return OutputError(
            f"PostgreSQL at {place.shown} does not let this user write ({reason}); GRANT the permission there."
        )
    if code == "23505":
        return OutputError(f"Rows of this stream are in {place.table!r} already ({reason}); give another table.")
    return OutputError(f"PostgreSQL at {place.shown} refused the rows ({reason}); none of them was committed.")


def _connection_error(place: TablePlace, cause: psycopg.Error) -> BecalmError:
    reason = _message_of(cause)
    needs_password = cause.pgconn is not None and cause.pgconn.needs_password
    if needs_password or any(words in reason for words in _REFUSALS):
        return InputError(
            f"PostgreSQL at {place.shown} refuses the login ({reason}); write the user before the host (USER@HOST), and"
            " the password into PGPASSWORD, ~/.pgpass or password_file=FILE."
        )
    return AwayError(f"PostgreSQL at {place.shown} cannot be reached now ({reason}).")


def _message_of(cause: psycopg.Error) -> str:
    """Return the message of the server or libpq in one line."""
    return " ".join((cause.diag.message_primary or str(cause)).split())[:300].rstrip(".")


def _read_login(path: Path) -> dict[str, str]:
    """Return the password in a file, and the user if the file has two lines."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as cause:
        raise InputError(f"The password file {path} cannot be read; give a file that contains the password.") from cause
    if len(lines) not in (1, 2):
        raise InputError(
            f"The password file {path} has {len(lines)} lines; write the password, or a line with the user above it."
        )
    return dict(zip(("user", "password")[-len(lines) :], lines, strict=True))
