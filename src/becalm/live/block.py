"""Data of a stream: blocks of readings, losses, outputs with estimates, and checkpoints."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from becalm.core.arrays import Codes, Floats


class LossKind(StrEnum):
    """Kind of a loss: what can happen to rows between the sensor and the sinks."""

    MISSING = "missing"  # sequence numbers show that rows were sent and did not arrive
    REPEATED = "repeated"  # duplicates of earlier rows; left out
    LATE = "late"  # arrived after rows with later stamps; left out
    GARBLED = "garbled"  # could not be parsed: lines, messages, wrong column counts
    DROPPED = "dropped"  # the queue was full, and the policy is to drop the oldest
    GAP = "gap"  # the sender or becalm stopped for a while, and the rows of that time cannot be read again
    CLOCK = "clock"  # the sender's clock jumped: the stamps are not continuous, but no row need be lost
    AWAY = "away"  # a broker, server or port could not be reached for a while
    SILENT = "silent"  # no rows arrived for longer than the watchdog waits
    STORAGE = "storage"  # a disk was full or could not be written; the stream had to wait


@dataclass(frozen=True)
class Loss:
    """One loss or disturbance of the stream.

    Attributes
    ----------
    kind : LossKind
        Kind of the loss.
    rows : int or None
        Number of affected rows (for GARBLED: lines or messages); None if unknown.
    says : str
        One sentence for the user, without secrets.
    noticed_s : float
        Time when the loss was noticed, in seconds since 1970.
    """

    kind: LossKind
    rows: int | None
    says: str
    noticed_s: float = field(default_factory=time.time)


@dataclass(frozen=True)
class Block:
    """Consecutive rows from a source.

    Attributes
    ----------
    names, units : tuple of str
        Names and units of the channels, (m,); the same in every block of a stream.
    time_s : (B,) float array
        Stamps of the sender in seconds; if it sends none, arrival times in seconds since 1970.
    values : (B, m) float array
        Readings, C-contiguous, NaN where missing.
    position : str
        Position of the source after this block, as JSON text; "" if the source has no position.
    elapsed : (B,) float array or None
        Time from the previous row to each row, in steps of 1 / `Source.rate_hz`, if the source knows it (a file); with
        None it is computed from the stamps.
    losses : tuple of Loss
        Losses before or in this block. A block without rows carries only losses.
    arrived_s : float
        `time.monotonic()` when the last row arrived; for joined blocks, the value of the first block.
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

    def is_joinable_with(self, after: Block) -> bool:
        """Return whether a later block can be joined to this one.

        The channels must be the same, the later block has no losses, and both blocks or neither have `elapsed`.
        """
        alike = self.names == after.names and self.units == after.units
        return alike and not after.losses and (self.elapsed is None) == (after.elapsed is None)

    @classmethod
    def joined(cls, blocks: list[Block]) -> Block:
        """Concatenate blocks; `is_joinable_with` must hold for each block and the next."""
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
        """Return a block without rows that carries losses."""
        return cls((), (), np.empty(0), np.empty((0, 0)), losses=losses)


@dataclass(frozen=True)
class Output:
    """Consecutive rows with their estimates, as sinks get them.

    Attributes
    ----------
    first_row : int
        Number of the first row, counted from 0 since the stream was first started.
    time_s : (B,) float array
        Stamps in seconds.
    values : (B, m) float array
        Raw readings.
    signal, sigma : (B, m) float arrays
        Estimated signal and its standard uncertainty.
    verdicts : (B, m) int8 array
        Verdict on each reading, values of `becalm.core.reading_verdicts.Verdict`.
    losses : tuple of Loss
        Losses before or in these rows.
    arrived_s : float
        `Block.arrived_s` of the block that completed these estimates; 0 for rows returned at the end of the stream.
    modes : (B, K) float array
        Mode probabilities of all channels with an IMM, channel after channel; (0, 0) if no channel has one.
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
    """Names, units, rate and recipe of a stream; sinks get them once, before the first row.

    Attributes
    ----------
    names, units : tuple of str
        Names and units of the cleaned channels, (m,).
    rate_hz : float
        Nominal sample rate in hertz.
    recipe : str
        The recipe as TOML.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    rate_hz: float
    recipe: str


@dataclass(frozen=True)
class Checkpoint:
    """State of a stream, from which it can be resumed as if it had never stopped.

    Attributes
    ----------
    rows : int
        Number of rows returned since the stream was first started.
    position : str
        Position after which the source continues; "" if it has none.
    snapshot : bytes
        State of the filters and the clock.
    recipe : str
        The recipe as TOML; a restart without --recipe continues with it.
    source : str
        The source's address, without secrets.
    """

    rows: int
    position: str
    snapshot: bytes
    recipe: str
    source: str
