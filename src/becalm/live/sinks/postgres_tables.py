"""The three tables of a stream in PostgreSQL: rows, the one checkpoint, and what was lost on the way."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

from becalm.core.verdict import Verdict
from becalm.errors import UsageError
from becalm.files.roles import SIGMA
from becalm.files.tables import VERDICT
from becalm.live.block import Checkpoint, Head, Output
from becalm.live.sinks.postgres_reaching import refuse_long
from becalm.live.tables import EPOCH_S, RAW, ROW, TIME, column_names

if TYPE_CHECKING:
    import psycopg
    from psycopg import sql

INSTANT = "time"
"""The column of instants, which the server itself makes of `time_s` where that counts from 1970."""

_LATEST_S = 1e11  # the year 5138: what is later counts something else
_MOST_CHANNELS = 300  # a row must fit into a page of 8 kB
_VERDICTS = ", ".join(f"{verdict.value} {verdict.name.lower()}" for verdict in Verdict)


class Tables:
    """What is asked of the tables of one stream, by name.

    Parameters
    ----------
    table : str
        The table of rows; any text of up to 63 bytes with its ends.
    """

    def __init__(self, table: str) -> None:
        from psycopg import sql

        self._sql, self.name = sql, table
        names = {"rows": table, "checkpoint": f"{table}_checkpoint", "losses": f"{table}_losses"}
        self._names = {which: sql.Identifier(name) for which, name in names.items()}
        self._beside_values = {which: sql.Identifier(name.replace("%", "%%")) for which, name in names.items()}
        digest = hashlib.blake2b(table.encode(), digest_size=8).digest()
        self._key = int.from_bytes(digest, "big", signed=True)

    def locked(self, connection: psycopg.Connection) -> bool:
        """Lock the tables until the connection ends; False where another connection has them."""
        found = connection.execute("SELECT pg_try_advisory_lock(%s)", (self._key,)).fetchone()
        return bool(found and found[0])

    def exist(self, connection: psycopg.Connection) -> tuple[bool, bool]:
        """Return whether there are rows, and whether there is a checkpoint."""
        asked = "SELECT to_regclass({}) IS NOT NULL, to_regclass({}) IS NOT NULL"
        quoted = [self._names[which].as_string(connection) for which in ("rows", "checkpoint")]
        found = connection.execute(self._sql.SQL(asked).format(*map(self._sql.Literal, quoted))).fetchone()
        assert found is not None
        return bool(found[0]), bool(found[1])

    def last(self, connection: psycopg.Connection) -> Checkpoint | None:
        """Return the checkpoint; None where nothing was kept yet."""
        asked = "SELECT rows, position, snapshot, recipe, source FROM {checkpoint} WHERE snapshot IS NOT NULL"
        found = connection.execute(self._of(asked)).fetchone()
        return None if found is None else Checkpoint(found[0], found[1], bytes(found[2]), found[3], found[4])

    def head(self, connection: psycopg.Connection) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the channels and units that the tables were made for."""
        found = connection.execute(self._of("SELECT channels, units FROM {checkpoint}")).fetchone()
        return (tuple(found[0]), tuple(found[1])) if found is not None else ((), ())

    def make(self, connection: psycopg.Connection, head: Head) -> None:
        """Make the tables for a new stream, in the place of those of one of which no row came.

        Raises
        ------
        UsageError
            If the channels' names or number are not for PostgreSQL.
        """
        columns = _columns(head)
        made = self._sql.SQL(", ").join(
            self._sql.SQL("{} {}").format(self._sql.Identifier(name), self._sql.SQL(kind)) for name, kind, _ in columns
        )
        if self.exist(connection)[1]:
            connection.execute(self._of("DROP TABLE {rows}, {checkpoint}, {losses}"))
        connection.execute(self._of("CREATE TABLE {rows} ({columns})", columns=made))
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
        self.tell_units(connection, head)

    def tell_units(self, connection: psycopg.Connection, head: Head) -> None:
        """Write units, as comments of the columns too."""
        connection.execute(
            self._with_values("UPDATE {checkpoint} SET units = %s"), ([_plain(unit) for unit in head.units],)
        )
        for name, _, said in _columns(head):
            about = {"column": self._sql.Identifier(name), "said": self._sql.Literal(said)}
            connection.execute(self._of("COMMENT ON COLUMN {rows}.{column} IS {said}", **about))

    def copying(self, head: Head) -> sql.Composed:
        """Return the COPY that takes what `BinaryRows` makes."""
        written = [self._sql.Identifier(name) for name, kind, _ in _columns(head) if "GENERATED" not in kind]
        return self._of("COPY {rows} ({columns}) FROM STDIN (FORMAT BINARY)", columns=self._sql.SQL(", ").join(written))

    def tell_losses(self, connection: psycopg.Connection, outputs: list[Output]) -> None:
        """Write what was lost, each beside the row after it."""
        told = [
            (one.first_row, loss.kind.value, loss.rows, _plain(loss.says), loss.noticed_s)
            for one in outputs
            for loss in one.losses
        ]
        if told:
            with connection.cursor() as cursor:
                query = "INSERT INTO {losses} VALUES (%s, %s, %s, %s, to_timestamp(%s))"
                cursor.executemany(self._with_values(query), told)

    def stand(self, connection: psycopg.Connection, checkpoint: Checkpoint) -> None:
        """Write where the stream stands."""
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
        """Return a query that values come with: in these psycopg takes each % of a name for a place of one."""
        return self._sql.SQL(query).format(**self._beside_values)


def _columns(head: Head) -> list[tuple[str, str, str]]:
    """Return names, types and comments: verdicts come last, so that eight bytes stay aligned."""
    names = [INSTANT, *column_names(head)]
    if INSTANT in head.names:
        raise UsageError(
            f"A channel is called {INSTANT!r}, as the column of instants; give it another name at its source."
        )
    if len(head.names) > _MOST_CHANNELS:
        raise UsageError(
            f"{len(head.names)} channels came, and a row of PostgreSQL holds {_MOST_CHANNELS} of them; write to"
            " journal:DIR or parquet:DIR, or name fewer channels."
        )
    for name in names:
        refuse_long(name)
    number = "double precision"
    made = f"timestamptz GENERATED ALWAYS AS (CASE WHEN {TIME} >= {EPOCH_S} AND {TIME} < {_LATEST_S}"
    columns = [(ROW, "bigint PRIMARY KEY", "counted from 0 over the whole life of the stream"), (TIME, number, "s")]
    for name, unit in zip(head.names, head.units, strict=True):
        columns += [(name + end, number, _plain(unit)) for end in ("", RAW, SIGMA)]
    columns += [(name + VERDICT, "smallint", _VERDICTS) for name in head.names]
    columns.append((INSTANT, f"{made} THEN to_timestamp({TIME}) END) STORED", "of time_s, where it counts from 1970"))
    return columns


def _plain(text: str) -> str:
    """Return text without what PostgreSQL's text cannot hold: NUL, and halves of characters."""
    return text.encode("utf-8", "replace").decode("utf-8").replace("\0", "\N{REPLACEMENT CHARACTER}")
