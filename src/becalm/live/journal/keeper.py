"""The journal as a keeper: a block of rows, the filters and the position in one transaction."""

from __future__ import annotations

import sqlite3
import time
from dataclasses import dataclass, replace
from pathlib import Path

from becalm.errors import UsageError
from becalm.files.atomic_file import sentences
from becalm.live.address import Address
from becalm.live.block import Checkpoint, Head, Loss, Output
from becalm.live.journal.database import NAME, connect, get, put, reading, transaction, writing
from becalm.live.journal.mark import Mark, MarkFile, locked
from becalm.live.journal.recording import give_up, record, remove_leftovers, remove_rolled
from becalm.live.journal.records import BlockRow, HeadRow, LossRow, RollRow
from becalm.live.journal.roller import Roller
from becalm.live.journal.rolling import MOST_BYTES, Rolled
from becalm.live.journal.row_bytes import by_period, joined, packed
from becalm.live.journal.salvage import mend
from becalm.live.tables import column_names

OPTIONS = ("roll", "keep")

_HOUR_S = 3600.0
_UNROLLED = """SELECT sum(length(data)) FROM blocks
    WHERE number > coalesce((SELECT last_block FROM rolls ORDER BY number DESC LIMIT 1), 0)"""
_LEAST_ROLL_S, _MOST_ROLL_S = 1.0, 30 * 86400.0
_REMOVED = 4  # rolled blocks that a commit removes: more than it adds, and few
_PATIENCE_S = 5.0  # for hours that are closed when the stream ends


@dataclass(frozen=True)
class _Place:
    """Where the journal stands: what the next block follows."""

    block: int = 0
    row: int = 0
    head: HeadRow | None = None
    hour: tuple[int, int] = (0, 0)
    empty: bool = False  # whether the last block has no rows
    size: int = 0  # bytes since the last hour closed


class Journal:
    """Keeps a stream in DIR/journal.sqlite, and closed hours in Parquet files beside it.

    A restart goes on where the last commit was. What is damaged is kept aside, and what reads of it goes on.

    Parameters
    ----------
    address : Address
        `journal:DIR?roll=1h&keep=30d`: how long the stretches are that become files, and after which age files are
        removed; without `keep` none is.

    Attributes
    ----------
    folder : Path
        DIR.
    mended : tuple of Loss
        What `last` or `open` found to be lost; the journal has it recorded.

    Raises
    ------
    UsageError
        If there is no folder, or an option that it does not have.
    """

    def __init__(self, address: Address) -> None:
        address.refuse_unknown(OPTIONS)
        if not address.rest:
            raise UsageError("journal: needs a folder; write journal:DIR.")
        self.folder = Path(address.rest)
        self._period_s = address.seconds("roll", _HOUR_S)
        if not _LEAST_ROLL_S <= self._period_s <= _MOST_ROLL_S:
            raise UsageError("journal: roll is from 1s to 30d, as roll=1h.")
        self._age_s = address.seconds("keep", 0.0)
        self._mark = MarkFile(self.folder)
        self._place = _Place()
        self._checkpoint: Checkpoint | None = None
        self.mended: tuple[Loss, ...] = ()
        self._lock: sqlite3.Connection | None = None
        self._connection: sqlite3.Connection | None = None
        self._roller: Roller | None = None
        self._doubtful = False  # whether a commit failed, and may have been kept after all

    def last(self) -> Checkpoint | None:
        """Return the last checkpoint that was kept; None of a new stream.

        Raises
        ------
        UsageError
            If another process writes the journal.
        JournalError
            If it is damaged, and nothing tells any more where the stream stood.
        StorageFullError
            If the folder cannot be written.
        """
        return self._opened()

    def open(self, head: Head) -> None:
        """Make ready for a stream.

        Raises
        ------
        UsageError
            If the journal holds another stream: other channels, or another recipe; and as `last`.
        """
        column_names(head)
        last, known = self._opened(), self._place.head
        row = HeadRow.of(1, head)
        if known is not None and last is not None:
            self._refuse_other(known.head(), head)
            units = tuple(new or old for new, old in zip(head.units, known.head().units, strict=True))
            row = HeadRow.of(known.number, replace(head, rate_hz=known.rate_hz, units=units))
            if row != known:
                row = row._replace(number=known.number + 1)
        if row != known:  # a first one, one of which no rows came, or units that the source told later
            with transaction(self._database, self.folder):
                put(self._database, row)
            self._place = replace(self._place, head=row)
        if self._roller is None:
            self._roller = Roller(self.folder)

    def _refuse_other(self, known: Head, head: Head) -> None:
        """Refuse a stream that is not the one that is kept; of units one of the two may not be known."""
        units = zip(known.units, head.units, strict=False)
        if known.names != head.names or any(old and new and old != new for old, new in units):
            raise UsageError(
                f"The journal in {self.folder} holds {_channels(known)}; the stream has {_channels(head)}. Give it a"
                " folder of its own: --sink journal:OTHER."
            )
        if known.recipe != head.recipe:
            raise UsageError(
                f"The journal in {self.folder} was written with another recipe. Leave --recipe out to go on with that,"
                " or give this stream a folder of its own: --sink journal:OTHER."
            )

    def keep(self, outputs: list[Output], checkpoint: Checkpoint) -> None:
        """Keep rows and checkpoint for good, both or neither.

        Raises
        ------
        StorageFullError
            If there is no room, or the disk will not write; nothing is kept, and the same call may be made again.
        JournalError
            If the file turns out to be damaged.
        ValueError
            If these rows do not follow those that were kept.
        """
        if self._doubtful and self._kept_after_all(checkpoint):
            return
        place = self._place
        output = joined(outputs, place.row)
        if checkpoint.rows != place.row + sum(map(len, outputs)):
            raise ValueError(f"the checkpoint is after {checkpoint.rows} rows, which are not those that came")
        head, roller = place.head, self._roller
        assert head is not None, "open comes before keep"
        assert roller is not None, "open comes before keep"
        if checkpoint.recipe != head.recipe:  # tuned anew meanwhile
            head = head._replace(number=head.number + 1, recipe=checkpoint.recipe)
        blocks = self._blocks(output, checkpoint, head)
        losses = [LossRow.of(one.first_row, loss) for one in outputs for loss in one.losses]
        self._doubtful = True
        self._commit(roller, head, blocks, losses)
        self._doubtful = False
        self._checkpoint = checkpoint
        self._mark.write(Mark(head.head(), checkpoint))
        last = blocks[-1]
        hour, empty = (last.period_s, last.dated), output is None
        size = place.size + sum(len(block.data or b"") for block in blocks)
        if hour != place.hour or size > MOST_BYTES:  # there may be something to roll
            size = 0
            roller.wake()
        self._place = _Place(last.number, last.end_row, head, hour, empty, size)

    def settle(self, timeout_s: float) -> bool:
        """Wait until all closed hours are in files and recorded, and tell whether that is so; the stream may go on."""
        settled = self._roller is not None and self._roller.settle(timeout_s)
        self._record()
        return settled

    def close(self) -> None:
        """Finish the file that is being rolled, if that does not take long, and let go; harmless twice."""
        try:
            if self._roller is not None:
                self._roller.settle(_PATIENCE_S)
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

    def _opened(self) -> Checkpoint | None:
        """Make sure that the folder is ours and whole, and return where the stream stands."""
        if self._connection is None:
            with sentences(self.folder):
                self.folder.mkdir(parents=True, exist_ok=True)
            lock = locked(self.folder)
            try:
                self.mended = mend(self.folder, self._mark.read())
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
        """Look up where the journal stands."""
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

    def _kept_after_all(self, checkpoint: Checkpoint) -> bool:
        """Whether a commit that seemed to fail is there; what is not there can be written again."""
        self._doubtful = False
        return self._find_place() == checkpoint

    def _blocks(self, output: Output | None, checkpoint: Checkpoint, head: HeadRow) -> list[BlockRow]:
        """Return what one call keeps: a block for each hour, the last with the snapshot."""
        place, now = self._place, time.time()
        stands = (checkpoint.position, checkpoint.source)
        if output is None:
            number = place.block + (0 if place.empty else 1)  # of blocks without rows only the last is of use
            nothing = (place.row, place.row, None, None, now, *place.hour)
            return [BlockRow(number, head.number, *nothing, *stands, checkpoint.snapshot, None)]
        blocks = []
        for number, (start, dated, part) in enumerate(by_period(output, self._period_s, now), place.block + 1):
            stamps = (float(part.time_s[0]), float(part.time_s[-1]))
            span = (part.first_row, part.first_row + len(part), *stamps, now, start, int(dated))
            blocks.append(BlockRow(number, head.number, *span, "", "", None, packed(part)))
        position, source = stands
        blocks[-1] = blocks[-1]._replace(position=position, source=source, snapshot=checkpoint.snapshot)
        return blocks

    def _commit(self, roller: Roller, head: HeadRow, blocks: list[BlockRow], losses: list[LossRow]) -> None:
        """Write all that one call keeps, and beside it what has rolled meanwhile."""
        done = roller.done()
        with transaction(self._database, self.folder):
            if head != self._place.head:
                put(self._database, head)
            for row in (*blocks, *losses):
                put(self._database, row)
            unwanted = self._beside(done, max(_REMOVED, 2 * len(blocks)))
        roller.forget(len(done), unwanted)

    def _record(self) -> None:
        """Record what has rolled, where no more rows come."""
        if self._roller is not None and (done := self._roller.done()):
            with transaction(self._database, self.folder):
                unwanted = self._beside(done, _REMOVED)
            self._roller.forget(len(done), unwanted)

    def _beside(self, done: tuple[Rolled, ...], most: int) -> list[RollRow]:
        """Record files and remove some of their blocks, within a transaction; return files that are too old."""
        record(self._database, done)
        remove_rolled(self._database, most)
        return give_up(self._database, self._age_s) if done and self._age_s else []


def _channels(head: Head) -> str:
    """Name channels with their units."""
    named = zip(head.names, head.units, strict=True)
    return ", ".join(f"{name} ({unit})" if unit else name for name, unit in named)
