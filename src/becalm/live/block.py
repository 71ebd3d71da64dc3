"""What passes through the room: blocks of readings, what was lost on the way, what is told of them."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from becalm.core.arrays import Codes, Floats


class LossKind(StrEnum):
    """What can happen to rows on their way."""

    MISSING = "missing"  # sequence numbers tell that they were sent and never came
    REPEATED = "repeated"  # came before; left out
    LATE = "late"  # came after rows that were taken later; left out
    GARBLED = "garbled"  # could not be read: lines, messages, wrong column counts
    DROPPED = "dropped"  # the queue was full, and the policy is to drop the oldest
    GAP = "gap"  # the stream stopped, here or there, and cannot be asked for what was sent meanwhile
    CLOCK = "clock"  # a stamp jumped: nothing need be lost, but time is not what it was
    AWAY = "away"  # a broker, server or port could not be reached for a while
    SILENT = "silent"  # nothing came for longer than the watchdog waits
    STORAGE = "storage"  # a disk was full or would not write; the stream stood still


@dataclass(frozen=True)
class Loss:
    """One thing that happened to the stream, counted and timed.

    Attributes
    ----------
    kind : LossKind
        What.
    rows : int or None
        How many rows it touched (of GARBLED: lines or messages); None where nobody can know.
    says : str
        One sentence for a person, without secrets.
    noticed_s : float
        When it was noticed, in seconds since 1970.
    """

    kind: LossKind
    rows: int | None
    says: str
    noticed_s: float = field(default_factory=time.time)


@dataclass(frozen=True)
class Block:
    """Some consecutive rows as a source gives them.

    Attributes
    ----------
    names, units : tuple of str
        The channels, (m,); the same in every block of a stream.
    time_s : (B,) float array
        Stamps in seconds as the sender told them; where it tells none, when the rows came, in seconds since 1970.
    values : (B, m) float array
        Readings, C-contiguous, NaN where missing.
    position : str
        Where the source goes on after this block, as JSON text; "" where it cannot go back.
    elapsed : (B,) float array or None
        Steps before each row where the source itself knows the clock (a file); None lets stamps tell.
    losses : tuple of Loss
        What happened to the stream before or in this block. A block may have no rows and tell only this.
    arrived_s : float
        `time.monotonic()` when the last of it came; of blocks that were joined, of the first.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    time_s: Floats
    values: Floats
    position: str = ""
    elapsed: Floats | None = None
    losses: tuple[Loss, ...] = ()
    arrived_s: float = 0.0

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.time_s)

    def goes_on_in(self, after: Block) -> bool:
        """Whether a later block may be joined to this one: the same channels and clock, and nothing lost between."""
        alike = self.names == after.names and self.units == after.units
        return alike and not after.losses and (self.elapsed is None) == (after.elapsed is None)

    @classmethod
    def joined(cls, blocks: list[Block]) -> Block:
        """Put blocks below each other, each of which goes on in the next."""
        first, last = blocks[0], blocks[-1]
        elapsed = [block.elapsed for block in blocks if block.elapsed is not None]
        return replace(
            first,
            time_s=np.concatenate([block.time_s for block in blocks]),
            values=np.concatenate([block.values for block in blocks]),
            position=last.position or first.position,
            elapsed=np.concatenate(elapsed) if elapsed else None,
        )

    @classmethod
    def of_losses(cls, *losses: Loss) -> Block:
        """Return a block of no rows, which tells what happened to the stream."""
        return cls((), (), np.empty(0), np.empty((0, 0)), losses=losses)


@dataclass(frozen=True)
class Output:
    """Some consecutive rows as sinks get them.

    Attributes
    ----------
    first_row : int
        The number of the first row, counted from 0 over the whole life of the stream.
    time_s : (B,) float array
        Stamps in seconds.
    values : (B, m) float array
        Raw readings.
    signal, sigma : (B, m) float arrays
        Clean, and its standard uncertainty.
    verdicts : (B, m) int8 array
        What became of each reading, values of `becalm.core.verdict.Verdict`.
    losses : tuple of Loss
        What happened to the stream before or in these rows.
    arrived_s : float
        `time.monotonic()` when the last of the readings came.
    modes : (B, K) float array
        How probable each mode is, of all channels that switch one after the other; (0, 0) where none does.
    """

    first_row: int
    time_s: Floats
    values: Floats
    signal: Floats
    sigma: Floats
    verdicts: Codes
    losses: tuple[Loss, ...] = ()
    arrived_s: float = 0.0
    modes: Floats = field(default_factory=lambda: np.empty((0, 0)))

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.time_s)


@dataclass(frozen=True)
class Head:
    """What every row of a stream shares; told to sinks once, before the first row.

    Attributes
    ----------
    names, units : tuple of str
        The clean channels, (m,).
    rate_hz : float
        Nominal readings a second.
    recipe : str
        The recipe as TOML.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    rate_hz: float
    recipe: str


@dataclass(frozen=True)
class Checkpoint:
    """Where a stream stands: all that is needed to go on as if nothing had happened.

    Attributes
    ----------
    rows : int
        Rows told so far, over the whole life of the stream.
    position : str
        Where the source goes on; "" where it cannot go back.
    snapshot : bytes
        The filters.
    recipe : str
        The recipe as TOML: a restart without --recipe goes on with it.
    source : str
        The source's address, without secrets.
    """

    rows: int
    position: str
    snapshot: bytes
    recipe: str
    source: str
