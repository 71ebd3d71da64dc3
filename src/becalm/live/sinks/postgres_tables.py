"""The three tables of a stream in PostgreSQL: rows, the checkpoint, and losses."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

from becalm.core.reading_verdicts import Verdict
from becalm.errors import UsageError
from becalm.files.outputs.tables import VERDICT
from becalm.files.roles import SIGMA
from becalm.live.block import Checkpoint, Head, Output
from becalm.live.sinks.postgres_reaching import refuse_long
from becalm.live.tables import EPOCH_S, RAW, ROW, TIME, column_names

if TYPE_CHECKING:
    import psycopg
    from psycopg import sql

INSTANT = "time"
"""Column of timestamps, which the server computes from `time_s` if that counts from 1970."""

_LATEST_S = 1e11  # the year 5138; a later stamp is not a date
_MOST_CHANNELS = 300  # a row must fit into a page of 8 kB
_VERDICTS = ", ".join(f"{verdict.value} {verdict.name.lower()}" for verdict in Verdict)


class Tables:
    """The SQL queries on the tables of one stream.

    Parameters
    ----------
    table : str
        Name of the table of rows, any text; with the suffix `_checkpoint` it has at most 63 bytes.
    """

    def __init__(self, table: str) -> None:
        from psycopg import sql

        self._sql, self.name = sql, table
        names = {"rows": table, "checkpoint": f"{table}_checkpoint", "losses": f"{table}_losses"}
        self._names = {which: sql.Identifier(name) for which, name in names.items()}
        self._escaped_names = {which: sql.Identifier(name.replace("%", "%%")) for which, name in names.items()}
        digest = hashlib.blake2b(table.encode(), digest_size=8).digest()
        self._key = int.from_bytes(digest, "big", signed=True)

    def try_lock(self, connection: psycopg.Connection) -> bool:
        """Lock the tables until the connection ends; return False if another connection holds the lock."""
        row = connection.execute("SELECT pg_try_advisory_lock(%s)", (self._key,)).fetchone()
        return bool(row and row[0])

    def exist(self, connection: psycopg.Connection) -> tuple[bool, bool]:
        """Return whether the table of rows exists, and whether the table of the checkpoint exists."""
        query = "SELECT to_regclass({}) IS NOT NULL, to_regclass({}) IS NOT NULL"
        quoted = [self._names[which].as_string(connection) for which in ("rows", "checkpoint")]
        row = connection.execute(self._sql.SQL(query).format(*map(self._sql.Literal, quoted))).fetchone()
        assert row is not None
        return bool(row[0]), bool(row[1])

    def last(self, connection: psycopg.Connection) -> Checkpoint | None:
        """Return the checkpoint; None if nothing is committed yet."""
        query = "SELECT rows, position, snapshot, recipe, source FROM {checkpoint} WHERE snapshot IS NOT NULL"
        row = connection.execute(self._of(query)).fetchone()
        return None if row is None else Checkpoint(row[0], row[1], bytes(row[2]), row[3], row[4])

    def head(self, connection: psycopg.Connection) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the stored names and units of the channels."""
        row = connection.execute(self._of("SELECT channels, units FROM {checkpoint}")).fetchone()
        return (tuple(row[0]), tuple(row[1])) if row is not None else ((), ())

    def make(self, connection: psycopg.Connection, head: Head) -> None:
        """Create the tables of a new stream; tables without committed rows are replaced.

        Raises
        ------
        UsageError
            If PostgreSQL cannot hold the channels' names, or so many channels.
        """
        columns = _columns(head)
        definitions = self._sql.SQL(", ").join(
            self._sql.SQL("{} {}").format(self._sql.Identifier(name), self._sql.SQL(kind)) for name, kind, _ in columns
        )
        if self.exist(connection)[1]:
            connection.execute(self._of("DROP TABLE {rows}, {checkpoint}, {losses}"))
        connection.execute(self._of("CREATE TABLE {rows} ({columns})", columns=definitions))
        connection.execute(
            self._of(
                "CREATE TABLE {checkpoint} (one boolean PRIMARY KEY DEFAULT true CHECK (one), rows bigint NOT NULL,"
                " position text NOT NULL, snapshot bytea, recipe text NOT NULL, source text NOT NULL,"
                " channels text[] NOT NULL, units text[] NOT NULL, rate_hz double precision NOT NULL,"
                " kept timestamptz NOT NULL DEFAULT now())"
            )
        )
        connection.execute(
            self._of(
                "CREATE TABLE {losses} (row bigint NOT NULL, kind text NOT NULL, rows bigint, says text NOT NULL,"
                " noticed timestamptz NOT NULL)"
            )
        )
        connection.execute(
            self._with_values(
                "INSERT INTO {checkpoint} (rows, position, recipe, source, channels, units, rate_hz)"
                " VALUES (0, '', %s, '', %s, %s, %s)"
            ),
            (_plain(head.recipe), list(head.names), [], head.rate_hz),
        )
        self.write_units(connection, head)

    def write_units(self, connection: psycopg.Connection, head: Head) -> None:
        """Store the units, and write them as comments of the columns."""
        connection.execute(
            self._with_values("UPDATE {checkpoint} SET units = %s"), ([_plain(unit) for unit in head.units],)
        )
        for name, _, comment in _columns(head):
            parts = {"column": self._sql.Identifier(name), "comment": self._sql.Literal(comment)}
            connection.execute(self._of("COMMENT ON COLUMN {rows}.{column} IS {comment}", **parts))

    def copy_statement(self, head: Head) -> sql.Composed:
        """Return the COPY statement for the bytes of `BinaryRows`."""
        written = [self._sql.Identifier(name) for name, kind, _ in _columns(head) if "GENERATED" not in kind]
        return self._of("COPY {rows} ({columns}) FROM STDIN (FORMAT BINARY)", columns=self._sql.SQL(", ").join(written))

    def write_losses(self, connection: psycopg.Connection, outputs: list[Output]) -> None:
        """Write the losses, each with the number of the first row of its output."""
        rows = [
            (one.first_row, loss.kind.value, loss.rows, _plain(loss.says), loss.noticed_s)
            for one in outputs
            for loss in one.losses
        ]
        if rows:
            with connection.cursor() as cursor:
                query = "INSERT INTO {losses} VALUES (%s, %s, %s, %s, to_timestamp(%s))"
                cursor.executemany(self._with_values(query), rows)

    def write_checkpoint(self, connection: psycopg.Connection, checkpoint: Checkpoint) -> None:
        """Write the checkpoint."""
        connection.execute(
            self._with_values(
                "UPDATE {checkpoint} SET rows = %s, position = %s, snapshot = %s, recipe = %s, source = %s,"
                " kept = clock_timestamp()"
            ),
            (
                checkpoint.rows,
                _plain(checkpoint.position),
                checkpoint.snapshot,
                _plain(checkpoint.recipe),
                _plain(checkpoint.source),
            ),
        )

    def _of(self, query: Any, **parts: sql.Composable) -> sql.Composed:
        return self._sql.SQL(query).format(**self._names, **parts)

    def _with_values(self, query: Any) -> sql.Composed:
        """Return a query that is executed with values; psycopg reads % in it as a placeholder, so names have %%."""
        return self._sql.SQL(query).format(**self._escaped_names)


def _columns(head: Head) -> list[tuple[str, str, str]]:
    """Return names, types and comments of the columns; verdicts come last, so that numbers of 8 bytes are aligned."""
    names = [INSTANT, *column_names(head)]
    if INSTANT in head.names:
        raise UsageError(f"A channel is called {INSTANT!r}, like the column of timestamps; rename it at its source.")
    if len(head.names) > _MOST_CHANNELS:
        raise UsageError(
            f"The stream has {len(head.names)} channels, but a row of PostgreSQL holds at most {_MOST_CHANNELS}; write"
            " to journal:DIR or parquet:DIR, or select fewer channels."
        )
    for name in names:
        refuse_long(name)
    number = "double precision"
    instant = f"timestamptz GENERATED ALWAYS AS (CASE WHEN {TIME} >= {EPOCH_S} AND {TIME} < {_LATEST_S}"
    columns = [(ROW, "bigint PRIMARY KEY", "counted from 0 over the whole life of the stream"), (TIME, number, "s")]
    for name, unit in zip(head.names, head.units, strict=True):
        columns += [(name + end, number, _plain(unit)) for end in ("", RAW, SIGMA)]
    columns += [(name + VERDICT, "smallint", _VERDICTS) for name in head.names]
    columns.append(
        (INSTANT, f"{instant} THEN to_timestamp({TIME}) END) STORED", "of time_s, where it counts from 1970")
    )
    return columns


def _plain(text: str) -> str:
    """Return a text in which NUL and lone surrogates, which PostgreSQL cannot hold, are replaced."""
    return text.encode("utf-8", "replace").decode("utf-8").replace("\0", "\N{REPLACEMENT CHARACTER}")
