"""The sink postgres: write rows, filters and position in one transaction of a PostgreSQL server."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from becalm.errors import UsageError
from becalm.live.address import Address
from becalm.live.block import Checkpoint, Head, Output
from becalm.live.protocols import AwayError
from becalm.live.sinks.postgres_reaching import connect_to, driver, error_of, place_of
from becalm.live.sinks.postgres_rows import COPY_HEADER, COPY_TRAILER, BinaryRows
from becalm.live.sinks.postgres_tables import Tables

if TYPE_CHECKING:
    import psycopg

_LOCK_WAIT_S, _LOCK_RETRY_S = 3.0, 0.05  # longest wait for the lock, and wait between attempts, in seconds


class PostgresSink:
    """A checkpoint sink that writes a stream to three tables: NAME, NAME_checkpoint and NAME_losses.

    The columns of NAME are `row` (the key), `time_s`, `time` (a timestamp, if `time_s` counts from 1970), and for each
    channel NAME, NAME_raw, NAME_sigma and NAME_verdict. A verdict is a number that the column's comment explains; the
    comment of any other channel column is its unit. While a stream writes, an advisory lock keeps other streams from
    its tables.

    Parameters
    ----------
    address : Address
        `postgres://USER@HOST:PORT/DATABASE?table=NAME`; without HOST, the server on loopback. The password comes from
        the environment (PGPASSWORD), from ~/.pgpass, or from a file (`password_file=FILE`, with the user optionally in
        the line above), never from the address. For TLS, `sslmode=verify-full&sslrootcert=FILE`, and `sslcert=`,
        `sslkey=` if the server requires a client certificate.

    Raises
    ------
    UsageError
        If the address cannot be parsed, or contains a password.
    """

    def __init__(self, address: Address) -> None:
        self._place = place_of(address)
        self._connection: psycopg.Connection | None = None
        self._had_lock = False  # if True, a lost connection of this object may still hold the lock on the server

    def last(self) -> Checkpoint | None:
        """Return the last committed checkpoint; None for a new stream.

        Raises
        ------
        AwayError
            If the server cannot be reached now.
        BecalmError
            If the server can never be reached, or another process writes to the tables.
        """
        psycopg = driver()
        connection = self._connection_with_lock()
        try:
            rows, checkpoint = self._tables.exist(connection)
            if rows and not checkpoint:
                raise UsageError(
                    f"The table {self._place.table!r} at {self._place.shown} was not made by becalm live; give another"
                    " with table=NAME."
                )
            return self._tables.last(connection) if checkpoint else None
        except psycopg.Error as cause:
            raise self._error_of(connection, cause) from cause

    def open(self, head: Head) -> None:
        """Create the tables of a new stream, or check that the tables belong to this stream.

        Raises
        ------
        AwayError
            If the server cannot be reached now.
        BecalmError
            If the server can never be reached, the tables belong to another stream, or another process writes to them.
        """
        psycopg = driver()
        last = self.last()
        connection = self._connection_with_lock()
        try:
            with connection.transaction():
                if last is None:
                    self._tables.make(connection, head)
                else:
                    self._check_channels(connection, head)
        except psycopg.Error as cause:
            raise self._error_of(connection, cause) from cause
        self._binary, self._copy_statement = BinaryRows(len(head.names)), self._tables.copy_statement(head)

    def commit(self, outputs: list[Output], checkpoint: Checkpoint) -> None:
        """Write rows and checkpoint in one transaction; when this returns, they are on the server's disk.

        Raises
        ------
        StorageFullError
            If the server's disk is full; nothing is committed, and the same call may be made again.
        AwayError
            If the connection was lost; `last` then shows whether the rows were committed.
        OutputError
            If the server refuses the rows, for example because this user may not write.
        """
        psycopg = driver()
        connection = self._connection
        if connection is None:
            raise AwayError(f"PostgreSQL at {self._place.shown} is not open.")
        try:
            with connection.transaction():
                self._copy(connection, outputs)
                self._tables.write_losses(connection, outputs)
                self._tables.write_checkpoint(connection, checkpoint)
        except psycopg.Error as cause:
            raise self._error_of(connection, cause) from cause

    def close(self) -> None:
        """Close the connection; may be called twice."""
        if self._connection is not None:
            with suppress(driver().Error):
                self._connection.close()
            self._connection = None

    def _copy(self, connection: psycopg.Connection, outputs: list[Output]) -> None:
        if not any(map(len, outputs)):
            return
        with connection.cursor() as cursor, cursor.copy(self._copy_statement) as copy:
            copy.write(COPY_HEADER)
            for output in outputs:
                for piece in self._binary.encode(output):
                    copy.write(piece)
            copy.write(COPY_TRAILER)

    def _wait_for_lock(self, connection: psycopg.Connection) -> bool:
        """Wait up to 3 s for the lock, which the server releases shortly after a kill; return whether it was taken."""
        until = time.monotonic() + _LOCK_WAIT_S
        while not (locked := self._tables.try_lock(connection)) and time.monotonic() < until:
            time.sleep(_LOCK_RETRY_S)
        return locked

    def _connection_with_lock(self) -> psycopg.Connection:
        """Return the connection that holds the lock; open it if there is none."""
        if self._connection is not None:
            return self._connection
        connection = connect_to(self._place)
        self._tables = Tables(self._place.table)
        self._connection = connection
        try:
            locked = self._wait_for_lock(connection)
        except driver().Error as cause:
            error = self._error_of(connection, cause)
            self.close()  # the connection has no lock
            raise error from cause
        if not locked:
            self.close()
            message = f"Another process writes to {self._place.table!r} at {self._place.shown}"
            if self._had_lock:
                raise AwayError(f"{message}, or the server has not noticed yet that the last connection ended.")
            raise UsageError(f"{message}; stop it, or give another table with table=NAME.")
        self._had_lock = True
        return connection

    def _check_channels(self, connection: psycopg.Connection, head: Head) -> None:
        """Raise a UsageError for other channels or units; store units that the table does not have yet."""
        names, stored = self._tables.head(connection)
        units = tuple(new or old for new, old in zip(head.units, stored, strict=False))
        if head.names != names or any(old and old != unit for old, unit in zip(stored, units, strict=True)):
            channels = ", ".join(f"{name} [{unit}]" for name, unit in zip(names, stored, strict=True))
            raise UsageError(
                f"The table {self._place.table!r} at {self._place.shown} has other channels ({channels}); give another"
                " with table=NAME."
            )
        if units != stored:
            self._tables.write_units(connection, replace(head, units=units))

    def _error_of(self, connection: psycopg.Connection, cause: psycopg.Error) -> Exception:
        broken = connection.broken or connection.closed
        if broken:
            self.close()
        return error_of(self._place, cause, broken=broken)
