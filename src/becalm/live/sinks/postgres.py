"""postgres: rows, filters and position in one transaction of a PostgreSQL server."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from becalm.errors import UsageError
from becalm.live.address import Address
from becalm.live.block import Checkpoint, Head, Output
from becalm.live.protocols import AwayError
from becalm.live.sinks.postgres_reaching import connected, driver, meant, place_of
from becalm.live.sinks.postgres_rows import BEGINS, ENDS, BinaryRows
from becalm.live.sinks.postgres_tables import Tables

if TYPE_CHECKING:
    import psycopg

_LINGERS_S, _AGAIN_S = 3.0, 0.05


class PostgresSink:
    """Keeps a stream in three tables: NAME, NAME_checkpoint and NAME_losses.

    NAME has a column `row` (its key), `time_s` as told and `time` as an instant where that counts from 1970, and of
    each channel NAME, NAME_raw, NAME_sigma and NAME_verdict, a number that the column's comment explains; the
    comments of the others are units. While a stream writes, an advisory lock keeps others from its tables.

    Parameters
    ----------
    address : Address
        `postgres://USER@HOST:PORT/DATABASE?table=NAME`; without HOST the server on loopback. The password is in the
        environment (PGPASSWORD), in ~/.pgpass, or in a file (`password_file=FILE`; the user may stand above it),
        never in the address. For TLS `sslmode=verify-full&sslrootcert=FILE`, and `sslcert=`, `sslkey=` where the
        server asks for a certificate.

    Raises
    ------
    UsageError
        If the address cannot be understood, or holds a password.
    """

    def __init__(self, address: Address) -> None:
        self._place = place_of(address)
        self._connection: psycopg.Connection | None = None
        self._had = False  # the lock: what holds it after a broken connection may be what is left of that

    def last(self) -> Checkpoint | None:
        """Return the last checkpoint that was kept; None of a new stream.

        Raises
        ------
        AwayError
            If the server cannot be reached now.
        BecalmError
            If it never can, or another process writes to the tables.
        """
        psycopg = driver()
        connection = self._reached()
        try:
            rows, checkpoint = self._tables.exist(connection)
            if rows and not checkpoint:
                raise UsageError(
                    f"The table {self._place.table!r} at {self._place.shown} was not made by becalm live; give another"
                    " with table=NAME."
                )
            return self._tables.last(connection) if checkpoint else None
        except psycopg.Error as cause:
            raise self._meant(connection, cause) from cause

    def open(self, head: Head) -> None:
        """Make the tables of a new stream, or look whether they are this one's.

        Raises
        ------
        AwayError
            If the server cannot be reached now.
        BecalmError
            If it never can, or the tables are of another stream, or another process writes to them.
        """
        psycopg = driver()
        last = self.last()
        connection = self._reached()
        try:
            with connection.transaction():
                if last is None:
                    self._tables.make(connection, head)
                else:
                    self._go_on(connection, head)
        except psycopg.Error as cause:
            raise self._meant(connection, cause) from cause
        self._binary, self._copying = BinaryRows(len(head.names)), self._tables.copying(head)

    def keep(self, outputs: list[Output], checkpoint: Checkpoint) -> None:
        """Keep rows and checkpoint in one transaction; when this returns the server has them on its disk.

        Raises
        ------
        StorageFullError
            If the server has no room; nothing is kept, and the same call may be made again.
        AwayError
            If it went away; `last` tells after opening again whether this call's rows were kept.
        OutputError
            If it does not take them, as where this user may not write.
        """
        psycopg = driver()
        connection = self._connection
        if connection is None:
            raise AwayError(f"PostgreSQL at {self._place.shown} is not open.")
        try:
            with connection.transaction():
                self._copy(connection, outputs)
                self._tables.tell_losses(connection, outputs)
                self._tables.stand(connection, checkpoint)
        except psycopg.Error as cause:
            raise self._meant(connection, cause) from cause

    def close(self) -> None:
        """Let go of the server; harmless twice."""
        if self._connection is not None:
            with suppress(driver().Error):
                self._connection.close()
            self._connection = None

    def _copy(self, connection: psycopg.Connection, outputs: list[Output]) -> None:
        if not any(map(len, outputs)):
            return
        with connection.cursor() as cursor, cursor.copy(self._copying) as copy:
            copy.write(BEGINS)
            for output in outputs:
                for piece in self._binary.of(output):
                    copy.write(piece)
            copy.write(ENDS)

    def _locked(self, connection: psycopg.Connection) -> bool:
        """Take the lock; what was killed a moment ago may hold it a little longer."""
        until = time.monotonic() + _LINGERS_S
        while not (locked := self._tables.locked(connection)) and time.monotonic() < until:
            time.sleep(_AGAIN_S)
        return locked

    def _reached(self) -> psycopg.Connection:
        """Return the connection, which holds the lock."""
        if self._connection is not None:
            return self._connection
        connection = connected(self._place)
        self._tables = Tables(self._place.table)
        self._connection = connection
        try:
            locked = self._locked(connection)
        except driver().Error as cause:
            raise self._meant(connection, cause) from cause
        if not locked:
            self.close()
            said = f"Another process writes to {self._place.table!r} at {self._place.shown}"
            if self._had:
                raise AwayError(f"{said}, perhaps what is left of the connection before.")
            raise UsageError(f"{said}; stop it, or give another table with table=NAME.")
        self._had = True
        return connection

    def _go_on(self, connection: psycopg.Connection, head: Head) -> None:
        """Refuse other channels; of units one of the two may not be known, and is told as soon as it is."""
        names, known = self._tables.head(connection)
        units = tuple(new or old for new, old in zip(head.units, known, strict=False))
        if head.names != names or any(old and old != unit for old, unit in zip(known, units, strict=True)):
            there = ", ".join(f"{name} [{unit}]" for name, unit in zip(names, known, strict=True))
            raise UsageError(
                f"The table {self._place.table!r} at {self._place.shown} is of other channels ({there}); give another"
                " with table=NAME."
            )
        if units != known:
            self._tables.tell_units(connection, replace(head, units=units))

    def _meant(self, connection: psycopg.Connection, cause: psycopg.Error) -> Exception:
        broken = connection.broken or connection.closed
        if broken:
            self.close()
        return meant(self._place, cause, broken=broken)
