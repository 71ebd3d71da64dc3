"""The journal as a sink: commit a block of rows, the filters and the position in one transaction."""

from __future__ import annotations

import sqlite3
import time
from dataclasses import dataclass, replace
from pathlib import Path

from becalm.errors import UsageError
from becalm.files.atomic_file import explain_write_errors
from becalm.live.address import Address
from becalm.live.block import Checkpoint, Head, Loss, Output
from becalm.live.journal.database import NAME, connect, get, put, reading, transaction, writing
from becalm.live.journal.mark import Mark, MarkFile, lock_journal
from becalm.live.journal.parquet_files import record, record_pruned, remove_leftovers, remove_rolled
from becalm.live.journal.records import BlockRow, HeadRow, LossRow, RollRow
from becalm.live.journal.rolling import MOST_BYTES, Rolled
from becalm.live.journal.rolling_thread import Roller
from becalm.live.journal.row_bytes import join_outputs, pack_rows, split_by_period
from becalm.live.journal.salvage import repair
from becalm.live.tables import column_names

OPTIONS = ("roll", "keep")

_HOUR_S = 3600.0
_UNROLLED = """SELECT sum(length(data)) FROM blocks
    WHERE number > coalesce((SELECT last_block FROM rolls ORDER BY number DESC LIMIT 1), 0)"""
_LEAST_ROLL_S, _MOST_ROLL_S = 1.0, 30 * 86400.0  # limits of the option `roll`
_REMOVED = 4  # rolled blocks that a commit removes, or twice as many as it adds, so that the database shrinks
_PATIENCE_S = 5.0  # time to finish rolling when the stream ends


@dataclass(frozen=True)
class _Place:
    """End of the journal, after which the next block is written."""

    block: int = 0  # number of the last block
    row: int = 0  # number of the next row
    head: HeadRow | None = None
    hour: tuple[int, int] = (0, 0)  # `period_s` and `dated` of the last block
    empty: bool = False  # True if the last block has no rows
    size: int = 0  # bytes of the blocks since the rolling thread was last woken


class Journal:
    """Writes a stream to DIR/journal.sqlite, and completed hours to Parquet files in the same folder.

    A restart continues from the last commit. If the database is damaged, the rows that can be read are copied to a
    new one, and the damaged file is renamed and kept.

    Parameters
    ----------
    address : Address
        `journal:DIR?roll=1h&keep=30d`: `roll` is the time that one Parquet file covers, `keep` the age at which files
        are removed; without `keep` no file is removed.

    Attributes
    ----------
    folder : Path
        DIR.
    repair_losses : tuple of Loss
        Losses that `last` or `open` found in a damaged journal, and recorded in the journal.

    Raises
    ------
    UsageError
        If the address has no folder, or an unknown option.
    """

    def __init__(self, address: Address) -> None:
        address.refuse_unknown(OPTIONS)
        if not address.rest:
            raise UsageError("journal: needs a folder; write journal:DIR.")
        self.folder = Path(address.rest)
        self._period_s = address.seconds("roll", _HOUR_S)
        if not _LEAST_ROLL_S <= self._period_s <= _MOST_ROLL_S:
            raise UsageError("journal: roll must be from 1s to 30d, as roll=1h.")
        self._age_s = address.seconds("keep", 0.0)
        self._mark = MarkFile(self.folder)
        self._place = _Place()
        self._checkpoint: Checkpoint | None = None
        self.repair_losses: tuple[Loss, ...] = ()
        self._lock: sqlite3.Connection | None = None
        self._connection: sqlite3.Connection | None = None
        self._roller: Roller | None = None
        self._doubtful = False  # True if a commit failed but may have reached the file

    def last(self) -> Checkpoint | None:
        """Return the last committed checkpoint; None for a new stream.

        Raises
        ------
        UsageError
            If another process writes the journal.
        JournalError
            If the journal is damaged and no checkpoint can be read.
        StorageFullError
            If the folder cannot be written.
        """
        return self._open_database()

    def open(self, head: Head) -> None:
        """Prepare for a stream; also raises the errors of `last`.

        Raises
        ------
        UsageError
            If the journal holds another stream, with other channels or another recipe.
        """
        column_names(head)
        last, stored = self._open_database(), self._place.head
        row = HeadRow.of(1, head)
        if stored is not None and last is not None:
            self._refuse_other(stored.head(), head)
            units = tuple(new or old for new, old in zip(head.units, stored.head().units, strict=True))
            row = HeadRow.of(stored.number, replace(head, rate_hz=stored.rate_hz, units=units))
            if row != stored:
                row = row._replace(number=stored.number + 1)
        if row != stored:  # the first head, a head that has no rows yet, or units that the source sent later
            with transaction(self._database, self.folder):
                put(self._database, row)
            self._place = replace(self._place, head=row)
        if self._roller is None:
            self._roller = Roller(self.folder)

    def _refuse_other(self, stored: Head, head: Head) -> None:
        """Raise a UsageError if the journal holds another stream; a unit that is missing on one side is accepted."""
        units = zip(stored.units, head.units, strict=False)
        if stored.names != head.names or any(old and new and old != new for old, new in units):
            raise UsageError(
                f"The journal in {self.folder} holds {_channels(stored)}; the stream has {_channels(head)}. Give the"
                " stream another folder: --sink journal:OTHER."
            )
        if stored.recipe != head.recipe:
            raise UsageError(
                f"The journal in {self.folder} was written with another recipe. Leave out --recipe to continue with"
                " that recipe, or give this stream another folder: --sink journal:OTHER."
            )

    def commit(self, outputs: list[Output], checkpoint: Checkpoint) -> None:
        """Commit rows and checkpoint, both or neither.

        Raises
        ------
        StorageFullError
            If the disk is full or cannot be written; nothing is committed, and the same call may be made again.
        JournalError
            If the file is damaged.
        ValueError
            If the first row is not the row after the last committed one.
        """
        if self._doubtful and self._is_committed(checkpoint):
            return
        place = self._place
        output = join_outputs(outputs, place.row)
        if checkpoint.rows != place.row + sum(map(len, outputs)):
            raise ValueError(f"the checkpoint is after {checkpoint.rows} rows, but the outputs end at another row")
        head, roller = place.head, self._roller
        assert head is not None, "open comes before commit"
        assert roller is not None, "open comes before commit"
        if checkpoint.recipe != head.recipe:  # the stream was retuned meanwhile
            head = head._replace(number=head.number + 1, recipe=checkpoint.recipe)
        blocks = self._blocks(output, checkpoint, head)
        losses = [LossRow.of(one.first_row, loss) for one in outputs for loss in one.losses]
        self._doubtful = True
        self._write_transaction(roller, head, blocks, losses)
        self._doubtful = False
        self._checkpoint = checkpoint
        self._mark.write(Mark(head.head(), checkpoint))
        last = blocks[-1]
        hour, empty = (last.period_s, last.dated), output is None
        size = place.size + sum(len(block.data or b"") for block in blocks)
        if hour != place.hour or size > MOST_BYTES:  # there may be blocks to roll
            size = 0
            roller.wake()
        self._place = _Place(last.number, last.end_row, head, hour, empty, size)

    def wait_until_rolled(self, timeout_s: float) -> bool:
        """Wait until all completed hours are in files and recorded; return False after a failure or the timeout.

        The stream may continue meanwhile.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait, in seconds.
        """
        settled = self._roller is not None and self._roller.wait_until_rolled(timeout_s)
        self._record()
        return settled

    def close(self) -> None:
        """Close the journal, after waiting up to 5 s for a Parquet file that is being written. May be called twice."""
        try:
            if self._roller is not None:
                self._roller.wait_until_rolled(_PATIENCE_S)
                self._roller.close()
                self._record()
        finally:
            for connection in (self._connection, self._lock):
                if connection is not None:
                    connection.close()
            self._connection = self._lock = self._roller = None

    @property
    def _database(self) -> sqlite3.Connection:
        assert self._connection is not None, "last or open comes first"
        return self._connection

    def _open_database(self) -> Checkpoint | None:
        """Lock the folder, repair and open the database; return the last checkpoint."""
        if self._connection is None:
            with explain_write_errors(self.folder):
                self.folder.mkdir(parents=True, exist_ok=True)
            lock = lock_journal(self.folder)
            try:
                self.repair_losses = repair(self.folder, self._mark.read())
                with writing(self.folder):
                    self._connection = connect(self.folder / NAME)
                    remove_leftovers(self._connection, self.folder)
            except BaseException:
                lock.close()
                raise
            self._lock = lock
            checkpoint = self._find_place()
            if checkpoint is not None and self._place.head is not None:
                self._mark.write(Mark(self._place.head.head(), checkpoint))
        return self._checkpoint

    def _find_place(self) -> Checkpoint | None:
        """Read the end of the journal from the database; return the last checkpoint."""
        with reading(self.folder):
            heads = get(self._database, HeadRow)
            blocks = get(self._database, BlockRow, "ORDER BY number DESC LIMIT 1")
            (size,) = self._database.execute(_UNROLLED).fetchone()
        head = heads[-1] if heads else None
        if not blocks or head is None:
            self._place, self._checkpoint = _Place(head=head), None
        else:
            (last,) = blocks
            hour, empty = (last.period_s, last.dated), last.first_row == last.end_row
            self._place = _Place(last.number, last.end_row, head, hour, empty, size or 0)
            self._checkpoint = last.checkpoint(head.recipe)
        return self._checkpoint

    def _is_committed(self, checkpoint: Checkpoint) -> bool:
        """Return whether a commit that seemed to fail is in the database; otherwise it can be written again."""
        self._doubtful = False
        return self._find_place() == checkpoint

    def _blocks(self, output: Output | None, checkpoint: Checkpoint, head: HeadRow) -> list[BlockRow]:
        """Return the blocks of one commit: one for each hour, the last with the snapshot."""
        place, now = self._place, time.time()
        if output is None:
            number = place.block + (0 if place.empty else 1)  # overwrite a last block without rows
            span = (place.row, place.row, None, None, now, *place.hour)
            return [
                BlockRow(number, head.number, *span, checkpoint.position, checkpoint.source, checkpoint.snapshot, None)
            ]
        blocks = []
        for number, (start, dated, part) in enumerate(split_by_period(output, self._period_s, now), place.block + 1):
            stamps = (float(part.time_s[0]), float(part.time_s[-1]))
            part_span = (part.first_row, part.first_row + len(part), *stamps, now, start, int(dated))
            blocks.append(BlockRow(number, head.number, *part_span, "", "", None, pack_rows(part)))
        position, source = checkpoint.position, checkpoint.source
        blocks[-1] = blocks[-1]._replace(position=position, source=source, snapshot=checkpoint.snapshot)
        return blocks

    def _write_transaction(self, roller: Roller, head: HeadRow, blocks: list[BlockRow], losses: list[LossRow]) -> None:
        """Commit head, blocks and losses; record files that were rolled meanwhile in the same transaction."""
        done = roller.done()
        with transaction(self._database, self.folder):
            if head != self._place.head:
                put(self._database, head)
            for row in (*blocks, *losses):
                put(self._database, row)
            unwanted = self._record_rolled(done, max(_REMOVED, 2 * len(blocks)))
        roller.forget(len(done), unwanted)

    def _record(self) -> None:
        """Record files that were rolled, without a commit of rows."""
        if self._roller is not None and (done := self._roller.done()):
            with transaction(self._database, self.folder):
                unwanted = self._record_rolled(done, _REMOVED)
            self._roller.forget(len(done), unwanted)

    def _record_rolled(self, done: tuple[Rolled, ...], most: int) -> list[RollRow]:
        """Record files and remove up to `most` of their blocks, within a transaction; return files to remove."""
        record(self._database, done)
        remove_rolled(self._database, most)
        return record_pruned(self._database, self._age_s) if done and self._age_s else []


def _channels(head: Head) -> str:
    """Return the channels with their units, comma-separated."""
    channels = zip(head.names, head.units, strict=True)
    return ", ".join(f"{name} ({unit})" if unit else name for name, unit in channels)
