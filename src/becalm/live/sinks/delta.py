"""delta: rows and checkpoint in one commit of a Delta table."""

from __future__ import annotations

import base64
import errno
import hashlib
import json
import secrets
import time
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from becalm.errors import BecalmError, InputError, OutputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Checkpoint, Head, Output
from becalm.live.protocols import AwayError, StorageFullError
from becalm.live.sinks.delta_files import BESIDE, DeltaFiles, library
from becalm.live.tables import ROW, output_table, table_schema

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_APPLICATION = "becalm"
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
_LOG_KEPT = {"delta.logRetentionDuration": "interval 7 days"}
_CONFLICTS = ("oncurrent", "changed since last commit")  # as deltalake says that another one committed
_OTHER = "is written to by another process too; stop it, or give another folder."
_LOOKED_THROUGH = (16, 1024, None)  # commits; others may have made some since the last of ours


class DeltaSink:
    """Keeps a stream in a Delta table: each commit adds rows and tells where the stream stands.

    The columns are those of the journal's Parquet files. Filters and position are in a file beside the table
    (`_becalm/`) that is written before the commit naming it. The number of rows is also Delta's own
    transaction identifier, by which the commit of a second writer fails. Losses are in the commits' metadata
    (`becalm` in the table's history, for as long as the log is kept: seven days).

    Each call of `keep` makes a file and a commit (10 to 20 ms), so it should come about once a second; `OPTIMIZE` and
    `VACUUM` may be run at any time, beside the stream.

    Parameters
    ----------
    address : Address
        `delta:DIR` or `delta:URI`, as `delta:s3://bucket/path`; what the store wants to know (keys, region) is in the
        environment. A folder's files are synced to the disk, which deltalake itself does not do.

    Raises
    ------
    UsageError
        If the address has no place, or options.
    """

    def __init__(self, address: Address) -> None:
        address.refuse_unknown(())
        if not address.rest:
            raise UsageError("delta: needs a folder or a URI; write delta:DIR.")
        self._place, self._shown = address.rest, str(address)
        self._files, self._remote = DeltaFiles(address.rest), "://" in address.rest
        self._table: Any = None
        self._head: Head | None = None
        self._checkpoint_file = ""

    def last(self) -> Checkpoint | None:
        """Return the last checkpoint that was kept; None of a new stream.

        Raises
        ------
        AwayError
            If a store behind a URI cannot be reached now.
        BecalmError
            If the table cannot be read, or is none of a stream.
        """
        self._checkpoint_file = ""
        with self._reading():
            self._files.set_torn_commit_aside()
            if not library().DeltaTable.is_deltatable(self._place):
                self._table = None
                return None
            self._files.lock(f"{self._shown} {_OTHER}")
            self._table = library().DeltaTable(self._place)
            if self._rows() is None:
                if self._table.metadata().name != _APPLICATION:
                    raise UsageError(f"The table {self._shown} was not made by becalm live; give another folder.")
                return None
            return self._stored()

    def open(self, head: Head) -> None:
        """Make the table of a new stream, or look whether it is this one's.

        Raises
        ------
        AwayError
            If a store behind a URI cannot be reached now.
        BecalmError
            If the table cannot be made, or is of another stream.
        """
        last = self.last()
        self._head, self._schema = head, _plain_schema(table_schema(head))
        if last is not None:
            self._refuse_other(head)
            self._forget_others()
        elif self._table is None or self._there() != self._schema:  # new, or one of which no row came
            self._make()

    def _make(self) -> None:
        with self._taking_back(()):
            said = "A stream that becalm live made clean; time_s in seconds."
            self._table = library().DeltaTable.create(
                self._place, self._schema, "overwrite", name=_APPLICATION, description=said, configuration=_LOG_KEPT
            )
            self._files.commit_lasts(self._table.version())
            self._files.lock(f"{self._shown} {_OTHER}")

    def keep(self, outputs: list[Output], checkpoint: Checkpoint) -> None:
        """Keep rows and checkpoint in one commit; when this returns they are on the disk, or with the store.

        Raises
        ------
        BecalmError
            As `Keeper.keep`; only a store behind a URI can be away.
        OutputError
            If another process wrote to the table, or it cannot be written to.
        """
        if self._head is None or self._table is None:
            raise AwayError(f"{self._shown} is not open.")
        table = output_table(self._head, outputs).cast(self._schema)
        mark = f"{checkpoint.rows:015}-{secrets.token_hex(4)}"
        made = (f"rows-{mark}.parquet", f"{BESIDE}/{mark}.json")
        with self._taking_back(made):
            added = [self._added(made[0], table)] if table.num_rows else []
            self._files.put(f"{mark}.json", _packed(checkpoint))
        losses = [asdict(loss) | {"row": one.first_row} for one in outputs for loss in one.losses]
        self._commit(added, {"rows": checkpoint.rows, "checkpoint": f"{mark}.json", "losses": losses}, made)
        if self._checkpoint_file:
            self._files.remove(f"{BESIDE}/{self._checkpoint_file}")
        self._checkpoint_file = f"{mark}.json"

    def close(self) -> None:
        """Let go of the table; harmless twice."""
        self._files.unlock()
        self._table = None

    def _forget_others(self) -> None:
        """Remove checkpoints of commits that never were; later ones may be of another who is about to commit."""
        current = self._checkpoint_file
        for name in self._files.beside():
            if name != current and name.partition("-")[0] <= current.partition("-")[0]:
                self._files.remove(f"{BESIDE}/{name}")

    def _added(self, name: str, table: pa.Table) -> Any:
        size = self._files.put_table(name, table)
        statistics = {
            "numRecords": table.num_rows,
            "minValues": {ROW: table[ROW][0].as_py()},
            "maxValues": {ROW: table[ROW][-1].as_py()},
            "nullCount": {ROW: 0},
        }
        action = library("transaction").AddAction
        return action(name, size, {}, int(time.time() * 1000), data_change=True, stats=json.dumps(statistics))

    def _commit(self, added: list[Any], told: dict[str, Any], made: tuple[str, ...]) -> None:
        """Commit, and have it on the disk; where an error is told the log says whether there was a commit."""
        module = library()
        properties = module.CommitProperties(
            custom_metadata={_APPLICATION: json.dumps(told)},
            app_transactions=[module.Transaction(_APPLICATION, told["rows"])],
        )
        before, failure = self._table.version(), None
        try:
            self._table.create_write_transaction(added, "append", self._schema, commit_properties=properties)
        except Exception as cause:  # what deltalake raises is of many kinds
            failure = cause
        try:
            self._table.update_incremental()
            kept = any(one.get("checkpoint") == told["checkpoint"] for one in self._every_told(_LOOKED_THROUGH[0]))
            for version in range(before + 1, self._table.version() + 1):
                self._files.commit_lasts(version)
        except Exception as cause:
            raise AwayError(f"{self._shown} was given rows, and then could not be read ({_said(cause)}).") from cause
        if failure is not None and not kept:
            with self._taking_back(made):
                raise failure
        if self._rows() != told["rows"]:
            raise OutputError(f"{self._shown} {_OTHER}")

    def _rows(self) -> int | None:
        rows: int | None = self._table.transaction_version(_APPLICATION)
        return rows

    def _stored(self) -> Checkpoint:
        told = self._told()
        if not told:
            raise InputError(
                f"The log of {self._shown} no longer has the commit that says where the stream stands; its rows can be"
                " read, and a stream can go on in another folder."
            )
        self._checkpoint_file = told["checkpoint"]
        return _unpacked(self._files.get(self._checkpoint_file))

    def _told(self) -> dict[str, Any]:
        """Return what the newest commit of a stream tells."""
        rows = self._rows()
        for limit in _LOOKED_THROUGH:
            for told in self._every_told(limit):
                if rows is not None and told.get("rows") == rows:
                    return told
        return {}

    def _every_told(self, limit: int | None) -> Iterator[dict[str, Any]]:
        """Return what commits tell, the newest first; those of others tell nothing."""
        return (json.loads(commit.get(_APPLICATION, "{}")) for commit in self._table.history(limit))

    def _there(self) -> pa.Schema:
        """Return the columns of the table."""
        return pa.schema(self._table.schema().to_arrow())

    def _refuse_other(self, head: Head) -> None:
        """Refuse other channels; of units one of the two may not be known, and those of the table stay."""
        there = self._there()
        pairs = zip(map(_unit, there), map(_unit, self._schema), strict=False)
        if there.names != self._schema.names or any(old and new and old != new for old, new in pairs):
            raise UsageError(f"The table {self._shown} has other channels or units; give another folder.")
        self._schema = there

    @contextmanager
    def _reading(self) -> Iterator[None]:
        try:
            yield
        except BecalmError:
            raise
        except Exception as cause:  # what deltalake raises is of many kinds
            if self._remote:
                raise AwayError(f"{self._shown} cannot be read now ({_said(cause)}).") from cause
            raise InputError(f"{self._shown} cannot be read as a Delta table ({_said(cause)}).") from cause

    @contextmanager
    def _taking_back(self, made: Sequence[str]) -> Iterator[None]:
        """Say what failed, and remove the files that were made for a commit that is none."""
        try:
            yield
        except BecalmError:
            raise
        except Exception as cause:
            for name in made:
                self._files.remove(name)
            raise self._meant(cause) from cause

    def _meant(self, cause: Exception) -> BecalmError:
        if any(words in str(cause) for words in _CONFLICTS):
            return OutputError(f"{self._shown} {_OTHER}")
        if getattr(cause, "errno", None) in _FULL or "os error 28" in str(cause):
            return StorageFullError(f"There is no room for {self._shown} ({_said(cause)}); make room.")
        if self._remote:
            return AwayError(f"{self._shown} cannot be written to now ({_said(cause)}).")
        return OutputError(f"{self._shown} cannot be written to ({_said(cause)}); nothing of these rows was kept.")


def _plain_schema(schema: pa.Schema) -> pa.Schema:
    """Return a schema of types that Delta has: words instead of dictionaries of words."""
    plain = [f.with_type(f.type.value_type) if pa.types.is_dictionary(f.type) else f for f in schema]
    return pa.schema(plain)


def _unit(field: pa.Field) -> bytes:
    unit: bytes = (field.metadata or {}).get(b"unit", b"")
    return unit


def _packed(checkpoint: Checkpoint) -> bytes:
    snapshot = base64.b64encode(checkpoint.snapshot).decode("ascii")
    body = json.dumps(asdict(checkpoint) | {"snapshot": snapshot})
    return json.dumps({"blake2b": hashlib.blake2b(body.encode()).hexdigest(), "checkpoint": body}).encode()


def _unpacked(packed: bytes) -> Checkpoint:
    outer = json.loads(packed)
    if hashlib.blake2b(outer["checkpoint"].encode()).hexdigest() != outer["blake2b"]:
        raise ValueError("a checkpoint beside the table is damaged")
    inner = json.loads(outer["checkpoint"])
    return Checkpoint(**{**inner, "snapshot": base64.b64decode(inner["snapshot"])})


def _said(cause: Exception) -> str:
    """Return the first line of what was raised."""
    return (str(cause).strip().splitlines() or [type(cause).__name__])[0][:300].rstrip(".")
