"""Learn a recipe from the first rows of a stream for which none is given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats, Integers
from becalm.core.recording import Recording
from becalm.core.time.clock import last_digit
from becalm.core.time.timebase import Timebase
from becalm.errors import InputError, TimeError, UsageError
from becalm.live.address import advising_addresses
from becalm.live.block import Block

FEWEST_ROWS = 64
"""Least number of rows from which noise and rate are learned."""

FEW_STAMPS = 20
"""Least number of stamps from which their resolution is estimated."""

_DAY_S = 86400.0
_CONSTANT_STAMPS_S = 10.0  # extra time to wait, in seconds, if the stamps do not advance


class Learned(NamedTuple):
    """A learned recipe, with the time step and the stamps' resolution in seconds."""

    recipe: Recipe
    step_s: float
    resolution_s: float


class LearningBuffer:
    """Blocks that arrived before the filters existed, and the time they span, updated block by block.

    Attributes
    ----------
    blocks : list of Block
        All blocks, in order.
    rows : int
        Number of rows in the blocks.
    steps : float or None
        Sum of `Block.elapsed` over all rows; None if a block does not have it.
    span_s : float
        Sum of the intervals between stamps, in seconds, except negative intervals and intervals of more than a day.
    arrival_span_s : float
        Time between the arrivals of the first and the last rows, in seconds.
    """

    def __init__(self) -> None:
        self.blocks: list[Block] = []
        self.rows = 0
        self.steps: float | None = 0.0
        self.span_s = self.arrival_span_s = 0.0
        self._last_s = np.nan
        self._first_arrival_s: float | None = None

    def add(self, block: Block) -> None:
        """Add the next block."""
        self.blocks.append(block)
        if not len(block):
            return
        self.rows += len(block)
        if self.steps is not None:
            self.steps = None if block.elapsed is None else self.steps + float(block.elapsed.sum())
        stamps = np.append(self._last_s, block.time_s)
        stamps = stamps[np.isfinite(stamps)]
        with np.errstate(over="ignore"):
            intervals_s = np.diff(stamps)
        self.span_s += float(intervals_s[(intervals_s > 0) & (intervals_s <= _DAY_S)].sum())
        self._last_s = stamps[-1] if len(stamps) else np.nan
        if self._first_arrival_s is None:
            self._first_arrival_s = block.arrived_s
        self.arrival_span_s = block.arrived_s - self._first_arrival_s


@dataclass(frozen=True)
class Learner:
    """Decides when the first blocks span enough time, and tunes a recipe on them.

    Attributes
    ----------
    learn_s : float
        Time to learn from, in seconds of the stream's own stamps. With a *short* time the filter starts soon, but
        noise and slow tones are identified less accurately.
    lag_s : float or None
        Lag in seconds: each estimate also uses the measurements up to this much later; None for no lag.
    channels : tuple of str
        Names of the channels to clean; empty for all.
    """

    learn_s: float
    lag_s: float | None = None
    channels: tuple[str, ...] = ()

    def is_enough(self, early: LearningBuffer, rate_hz: float | None) -> bool:
        """Return whether the blocks have enough rows and span `learn_s`.

        If the stamps do not advance, the rows are enough 2 `learn_s` + 10 s after the first arrival.
        """
        if early.rows < FEWEST_ROWS:
            return False
        if early.steps is not None and rate_hz:
            return early.steps >= self.learn_s * rate_hz
        return early.span_s >= self.learn_s or early.arrival_span_s >= 2 * self.learn_s + _CONSTANT_STAMPS_S

    def check_learned(self, recipe: Recipe) -> None:
        """Check that a recipe which was learned before has this learner's lag and channels, where they are given.

        Raises
        ------
        UsageError
            If the recipe has another lag or other channels.
        """
        names = tuple(channel.name for channel in recipe.channel)
        if self.lag_s not in (None, recipe.lag_s) or (self.channels and set(self.channels) != set(names)):
            lag = "no lag" if recipe.lag_s is None else f"a lag of {recipe.lag_s:g} s"
            raise UsageError(
                f"The stream there has {lag} and cleans {', '.join(names)[:200]}; --lag and --channels cannot change"
                " that. Leave them out, or start a new stream in another place."
            )

    def learn(self, blocks: list[Block], rate_hz: float | None) -> Learned:
        """Tune a recipe on blocks.

        Raises
        ------
        InputError
            If there are too few rows, or the stamps do not give a rate.
        """
        full = [block for block in blocks if len(block)]
        rows = sum(len(block) for block in full)
        if rows < FEWEST_ROWS:
            raise InputError(
                f"Only {rows} rows arrived, but learning a filter needs {FEWEST_ROWS}; give a recipe with --recipe."
            )
        values = np.concatenate([block.values for block in full])
        with advising_addresses():
            timebase, kept = _timebase_of(full, rate_hz)
            recording = Recording(values[kept], names=full[0].names, units=full[0].units, timebase=timebase)
            wishes = Wishes(lag_s=self.lag_s)
            recipe = tune(recording, causal=self.lag_s is None, channels=self.channels or None, wishes=wishes)
        return Learned(recipe, timebase.step_s, timebase.resolution_s)


def resolution_of(stamps_s: Floats) -> float:
    """Return the resolution to which stamps are rounded, in seconds; 0 if there are too few stamps."""
    finite = stamps_s[np.isfinite(stamps_s)]
    return last_digit(finite) if len(finite) >= FEW_STAMPS else 0.0


def _timebase_of(blocks: list[Block], rate_hz: float | None) -> tuple[Timebase, slice | Integers]:
    """Return a timebase, and the rows that it describes: all rows, or only those whose stamps exceed all earlier ones.

    Raises
    ------
    TimeError
        If the stamps give no timebase.
    """
    elapsed = [block.elapsed for block in blocks]
    if rate_hz is not None and all(steps is not None for steps in elapsed):
        steps = np.concatenate([steps for steps in elapsed if steps is not None])
        return Timebase(steps, 1 / rate_hz, uniform=bool(np.all(steps == np.round(steps)))), slice(None)
    stamps = np.concatenate([block.time_s for block in blocks])
    try:
        return Timebase.from_stamps(stamps), slice(None)
    except TimeError:
        with np.errstate(invalid="ignore"):
            highest = np.fmax.accumulate(stamps)
            kept = np.isfinite(stamps) & (stamps > np.concatenate([[-np.inf], highest[:-1]]))
        if np.count_nonzero(kept) < FEWEST_ROWS:
            raise
        return Timebase.from_stamps(stamps[kept]), np.flatnonzero(kept)
