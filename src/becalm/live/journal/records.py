"""What the journal's tables hold, a row each, and the seal by which a damaged row is found."""

from __future__ import annotations

import json
from collections.abc import Iterable
from hashlib import sha256
from typing import NamedTuple

from becalm.live.block import Checkpoint, Head, Loss, LossKind


class HeadRow(NamedTuple):
    """What some blocks share; a stream that is tuned anew has a further one."""

    number: int
    names: str  # JSON
    units: str  # JSON
    rate_hz: float
    recipe: str

    @classmethod
    def of(cls, number: int, head: Head) -> HeadRow:
        """Make a row of a head."""
        return cls(number, json.dumps(head.names), json.dumps(head.units), float(head.rate_hz), head.recipe)

    def head(self) -> Head:
        """Return the head."""
        return Head(tuple(json.loads(self.names)), tuple(json.loads(self.units)), self.rate_hz, self.recipe)


class BlockRow(NamedTuple):
    """Some rows, and where the stream stands after them: what one call of `Journal.keep` keeps.

    A call whose rows lie in several hours becomes several blocks, of which the last has the snapshot.
    """

    number: int  # from 1, without a hole
    head: int
    first_row: int
    end_row: int  # the row after the last
    first_s: float | None  # stamps; None where there are no rows
    last_s: float | None
    kept_s: float  # seconds since 1970
    period_s: int  # where the hour begins that it rolls with, in seconds since 1970
    dated: int  # 1 where that hour is one of the stamps, 0 where it is that of arrival
    position: str
    source: str
    snapshot: bytes | None
    data: bytes | None

    def checkpoint(self, recipe: str) -> Checkpoint:
        """Return where the stream stands after these rows."""
        return Checkpoint(self.end_row, self.position, self.snapshot or b"", recipe, self.source)


class RollRow(NamedTuple):
    """A Parquet file that holds the rows of closed hours."""

    number: int
    path: str  # below the journal's folder, with /
    head: int
    last_block: int  # this and all blocks before it have rolled
    first_row: int
    end_row: int
    rows: int  # fewer than between the two where some were lost
    first_s: float | None
    last_s: float | None
    dated: int
    rolled_s: float
    size: int  # bytes
    sha256: str
    pruned_s: float | None  # when the file was removed as too old


class LossRow(NamedTuple):
    """Something that happened to the stream, before or in the rows from `row` on."""

    number: int | None  # None: the next
    row: int
    kind: str
    rows: int | None
    says: str
    noticed_s: float

    @classmethod
    def of(cls, row: int, loss: Loss) -> LossRow:
        """Make a row of a loss."""
        return cls(None, row, str(loss.kind), loss.rows, loss.says, float(loss.noticed_s))

    def loss(self) -> Loss:
        """Return the loss."""
        return Loss(LossKind(self.kind), self.rows, self.says, self.noticed_s)


class HoleRow(NamedTuple):
    """Rows that were kept, and could not be read again."""

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
    """Return what tells, beside the values of a row, whether they are still what was written: 32 bytes."""
    digest = sha256()
    for value in values:
        if isinstance(value, bytes):
            digest.update(b"%d bytes\n" % len(value))
            digest.update(value)
        else:
            digest.update(f"{value!r}\n".encode())
    return digest.digest()
