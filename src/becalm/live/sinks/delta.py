"""The sink delta: write rows and checkpoint in one commit of a Delta table."""

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
from becalm.live.sinks.delta_files import CHECKPOINT_FOLDER, DeltaFiles, library
from becalm.live.tables import ROW, output_table, table_schema

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_APPLICATION = "becalm"
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO)  # error numbers that a full disk can cause
_LOG_KEPT = {"delta.logRetentionDuration": "interval 7 days"}
_CONFLICTS = ("oncurrent", "changed since last commit")  # in deltalake's messages about a concurrent commit
_OTHER = "is also written by another process; stop that process, or give another folder."
_SEARCHED_COMMITS = (16, 1024, None)  # commits in which becalm's last one is searched, attempt by attempt; None: all


class DeltaSink:
    """A checkpoint sink that writes a stream to a Delta table: each commit adds rows and names a checkpoint file.

    The columns are those of the journal's Parquet files. The checkpoint is a JSON file in the table's
    folder `_becalm/`, written before the commit that names it. The number of rows is also Delta's transaction
    identifier, so that the commit of a second writer fails. Losses are in the metadata of the commits (`becalm` in
    the table's history, for the seven days for which the log is kept).

    Each call of `commit` makes a file and a Delta commit (10 to 20 ms), so it should be called about once a second.
    `OPTIMIZE` and `VACUUM` may be run at any time while the stream runs.

    Parameters
    ----------
    address : Address
        `delta:DIR` or `delta:URI`, for example `delta:s3://bucket/path`; credentials and region of the store come from
        the environment. Files in a folder are synced to the disk, which deltalake itself does not do.

    Raises
    ------
    UsageError
        If the address has no folder or URI, or has options.
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
        """Return the last committed checkpoint; None for a new stream.

        Raises
        ------
        AwayError
            If a remote store cannot be reached now.
        BecalmError
            If the table cannot be read, or is not the table of a stream.
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
            return self._read_checkpoint()

    def open(self, head: Head) -> None:
        """Create the table of a new stream, or check that the table belongs to this stream.

        Raises
        ------
        AwayError
            If a remote store cannot be reached now.
        BecalmError
            If the table cannot be created, or belongs to another stream.
        """
        last = self.last()
        self._head, self._schema = head, _plain_schema(table_schema(head))
        if last is not None:
            self._refuse_other(head)
            self._remove_old_checkpoints()
        elif self._table is None or self._table_schema() != self._schema:  # a new stream, or a table without rows
            self._create()

    def _create(self) -> None:
        with self._undoing(()):
            text = "A stream that becalm live made clean; time_s in seconds."
            self._table = library().DeltaTable.create(
                self._place, self._schema, "overwrite", name=_APPLICATION, description=text, configuration=_LOG_KEPT
            )
            self._files.sync_commit(self._table.version())
            self._files.lock(f"{self._shown} {_OTHER}")

    def commit(self, outputs: list[Output], checkpoint: Checkpoint) -> None:
        """Write rows and checkpoint in one commit; when this returns, they are on the disk or in the remote store.

        Raises
        ------
        StorageFullError
            If the disk is full; nothing is committed, and the same call may be made again.
        AwayError
            If a remote store cannot be reached, or the table cannot be read after a commit; `last` then shows whether
            the rows were committed.
        OutputError
            If another process wrote to the table, or it cannot be written.
        """
        if self._head is None or self._table is None:
            raise AwayError(f"{self._shown} is not open.")
        table = output_table(self._head, outputs).cast(self._schema)
        stem = f"{checkpoint.rows:015}-{secrets.token_hex(4)}"
        new_files = (f"rows-{stem}.parquet", f"{CHECKPOINT_FOLDER}/{stem}.json")
        with self._undoing(new_files):
            actions = [self._add_action(new_files[0], table)] if table.num_rows else []
            self._files.put(f"{stem}.json", _packed(checkpoint))
        losses = [asdict(loss) | {"row": one.first_row} for one in outputs for loss in one.losses]
        self._commit_actions(
            actions, {"rows": checkpoint.rows, "checkpoint": f"{stem}.json", "losses": losses}, new_files
        )
        if self._checkpoint_file:
            self._files.remove(f"{CHECKPOINT_FOLDER}/{self._checkpoint_file}")
        self._checkpoint_file = f"{stem}.json"

    def close(self) -> None:
        """Release the table; may be called twice."""
        self._files.unlock()
        self._table = None

    def _remove_old_checkpoints(self) -> None:
        """Remove older checkpoint files; newer ones may belong to a process that is about to commit."""
        current = self._checkpoint_file
        for name in self._files.checkpoint_names():
            if name != current and name.partition("-")[0] <= current.partition("-")[0]:
                self._files.remove(f"{CHECKPOINT_FOLDER}/{name}")

    def _add_action(self, name: str, table: pa.Table) -> Any:
        """Write a Parquet file; return the action that adds it to the table."""
        size = self._files.put_table(name, table)
        statistics = {
            "numRecords": table.num_rows,
            "minValues": {ROW: table[ROW][0].as_py()},
            "maxValues": {ROW: table[ROW][-1].as_py()},
            "nullCount": {ROW: 0},
        }
        action = library("transaction").AddAction
        return action(name, size, {}, int(time.time() * 1000), data_change=True, stats=json.dumps(statistics))

    def _commit_actions(self, actions: list[Any], metadata: dict[str, Any], new_files: tuple[str, ...]) -> None:
        """Commit and sync; after an error of deltalake, read in the table's log whether the commit was made."""
        module = library()
        properties = module.CommitProperties(
            custom_metadata={_APPLICATION: json.dumps(metadata)},
            app_transactions=[module.Transaction(_APPLICATION, metadata["rows"])],
        )
        before, failure = self._table.version(), None
        try:
            self._table.create_write_transaction(actions, "append", self._schema, commit_properties=properties)
        except Exception as cause:  # deltalake raises many kinds of errors
            failure = cause
        try:
            self._table.update_incremental()
            newest = self._commit_metadata(_SEARCHED_COMMITS[0])
            is_committed = any(one.get("checkpoint") == metadata["checkpoint"] for one in newest)
            for version in range(before + 1, self._table.version() + 1):
                self._files.sync_commit(version)
        except Exception as cause:
            raise AwayError(f"{self._shown} could not be read after a commit ({_first_line(cause)}).") from cause
        if failure is not None and not is_committed:
            with self._undoing(new_files):
                raise failure
        if self._rows() != metadata["rows"]:
            raise OutputError(f"{self._shown} {_OTHER}")

    def _rows(self) -> int | None:
        rows: int | None = self._table.transaction_version(_APPLICATION)
        return rows

    def _read_checkpoint(self) -> Checkpoint:
        metadata = self._last_metadata()
        if not metadata:
            raise InputError(
                f"The log of {self._shown} no longer has the commit with the stream's checkpoint; its rows can be"
                " read, but the stream cannot continue there. Give another folder."
            )
        self._checkpoint_file = metadata["checkpoint"]
        return _unpacked(self._files.get(self._checkpoint_file))

    def _last_metadata(self) -> dict[str, Any]:
        """Return the metadata of the stream's last commit; {} if the log no longer has it."""
        rows = self._rows()
        for limit in _SEARCHED_COMMITS:
            for metadata in self._commit_metadata(limit):
                if rows is not None and metadata.get("rows") == rows:
                    return metadata
        return {}

    def _commit_metadata(self, limit: int | None) -> Iterator[dict[str, Any]]:
        """Return becalm's metadata of the last commits, the newest first; {} for commits of other programs."""
        return (json.loads(commit.get(_APPLICATION, "{}")) for commit in self._table.history(limit))

    def _table_schema(self) -> pa.Schema:
        """Return the schema of the stored table."""
        return pa.schema(self._table.schema().to_arrow())

    def _refuse_other(self, head: Head) -> None:
        """Raise a UsageError for other channels or units; a missing unit is accepted, and the table keeps its units."""
        stored = self._table_schema()
        pairs = zip(map(_unit, stored), map(_unit, self._schema), strict=False)
        if stored.names != self._schema.names or any(old and new and old != new for old, new in pairs):
            raise UsageError(f"The table {self._shown} has other channels or units; give another folder.")
        self._schema = stored

    @contextmanager
    def _reading(self) -> Iterator[None]:
        try:
            yield
        except BecalmError:
            raise
        except Exception as cause:  # deltalake raises many kinds of errors
            if self._remote:
                raise AwayError(f"{self._shown} cannot be read now ({_first_line(cause)}).") from cause
            raise InputError(f"{self._shown} cannot be read as a Delta table ({_first_line(cause)}).") from cause

    @contextmanager
    def _undoing(self, new_files: Sequence[str]) -> Iterator[None]:
        """After an error, remove the files of the failed commit, and raise an error with a message for the user."""
        try:
            yield
        except BecalmError:
            raise
        except Exception as cause:
            for name in new_files:
                self._files.remove(name)
            raise self._error_of(cause) from cause

    def _error_of(self, cause: Exception) -> BecalmError:
        if any(words in str(cause) for words in _CONFLICTS):
            return OutputError(f"{self._shown} {_OTHER}")
        if getattr(cause, "errno", None) in _FULL or "os error 28" in str(cause):
            return StorageFullError(f"The disk has no room for {self._shown} ({_first_line(cause)}); free some.")
        if self._remote:
            return AwayError(f"{self._shown} cannot be written now ({_first_line(cause)}).")
        return OutputError(f"{self._shown} cannot be written ({_first_line(cause)}); none of these rows was committed.")


def _plain_schema(schema: pa.Schema) -> pa.Schema:
    """Return a schema with plain text instead of dictionaries, which Delta does not have."""
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
        raise ValueError("the checkpoint file is damaged")
    inner = json.loads(outer["checkpoint"])
    return Checkpoint(**{**inner, "snapshot": base64.b64decode(inner["snapshot"])})


def _first_line(cause: Exception) -> str:
    """Return the first line of an error's text."""
    return (str(cause).strip().splitlines() or [type(cause).__name__])[0][:300].rstrip(".")
