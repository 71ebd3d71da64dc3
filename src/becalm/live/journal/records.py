"""Rows of the journal's tables, and the checksum (seal) that detects a damaged row."""

from __future__ import annotations

import json
from collections.abc import Iterable
from hashlib import sha256
from typing import NamedTuple

from becalm.live.block import Checkpoint, Head, Loss, LossKind


class HeadRow(NamedTuple):
    """Names, units, rate and recipe of some blocks; a retuned stream has several such rows."""

    number: int
    names: str  # JSON
    units: str  # JSON
    rate_hz: float
    recipe: str

    @classmethod
    def of(cls, number: int, head: Head) -> HeadRow:
        """Return the row of a head."""
        return cls(number, json.dumps(head.names), json.dumps(head.units), float(head.rate_hz), head.recipe)

    def head(self) -> Head:
        """Return the head."""
        return Head(tuple(json.loads(self.names)), tuple(json.loads(self.units)), self.rate_hz, self.recipe)


class BlockRow(NamedTuple):
    """Rows of the stream, and its checkpoint after them: one commit by `Journal.commit`.

    A commit with rows in several hours becomes several blocks; the last one has the snapshot.
    """

    number: int  # from 1, without gaps
    head: int  # number of the head
    first_row: int
    end_row: int  # the row after the last
    first_s: float | None  # stamps; None if there are no rows
    last_s: float | None
    kept_s: float  # time of the commit, in seconds since 1970
    period_s: int  # start of the hour whose file will hold the block, in seconds since 1970
    dated: int  # 1 if that hour comes from the stamps, 0 if it comes from the arrival time
    position: str
    source: str
    snapshot: bytes | None  # None except in the last block of a commit
    data: bytes | None  # packed rows; None if there are none

    def checkpoint(self, recipe: str) -> Checkpoint:
        """Return the checkpoint after these rows."""
        return Checkpoint(self.end_row, self.position, self.snapshot or b"", recipe, self.source)


class RollRow(NamedTuple):
    """A Parquet file with the rows of a completed hour."""

    number: int
    path: str  # relative to the journal's folder, with /
    head: int  # number of the head
    last_block: int  # the rows of this block and all earlier ones are in files
    first_row: int
    end_row: int
    rows: int  # fewer than end_row - first_row if rows were lost
    first_s: float | None
    last_s: float | None
    dated: int  # as in BlockRow
    rolled_s: float  # time when the file was written, in seconds since 1970
    size: int  # bytes
    sha256: str
    pruned_s: float | None  # time when the file was removed because of its age; None if it was not


class LossRow(NamedTuple):
    """A loss of the stream, before or in the rows from `row` on."""

    number: int | None  # None takes the next number
    row: int
    kind: str
    rows: int | None
    says: str
    noticed_s: float

    @classmethod
    def of(cls, row: int, loss: Loss) -> LossRow:
        """Return the row of a loss."""
        return cls(None, row, str(loss.kind), loss.rows, loss.says, float(loss.noticed_s))

    def loss(self) -> Loss:
        """Return the loss."""
        return Loss(LossKind(self.kind), self.rows, self.says, self.noticed_s)


class HoleRow(NamedTuple):
    """A span of rows that were committed and could not be read again."""

    number: int | None
    first_row: int
    end_row: int


TABLES: dict[type, str] = {
    HeadRow: "heads",
    BlockRow: "blocks",
    RollRow: "rolls",
    LossRow: "losses",
    HoleRow: "holes",
}


def seal(values: Iterable[object]) -> bytes:
    """Return the SHA-256 of a row's values, 32 bytes; it is stored with the row to detect damage."""
    digest = sha256()
    for value in values:
        if isinstance(value, bytes):
            digest.update(b"%d bytes\n" % len(value))
            digest.update(value)
        else:
            digest.update(f"{value!r}\n".encode())
    return digest.digest()
