"""A recipe from a stream's first seconds, where none was given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from becalm.cleaning.recipe import Recipe
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats, Integers
from becalm.core.recording import Recording
from becalm.core.time.clock import last_digit
from becalm.core.time.timebase import Timebase
from becalm.errors import InputError, TimeError
from becalm.live.address import advising_addresses
from becalm.live.block import Block

FEWEST_ROWS = 64
"""Under so many rows nothing is learned: neither the noise nor the rate."""

FEW_STAMPS = 20
"""Under so many stamps nothing is told of their last digit."""

_DAY_S = 86400.0
_STANDING_S = 10.0


class Learned(NamedTuple):
    """What the first seconds told."""

    recipe: Recipe
    step_s: float
    resolution_s: float


class Early:
    """Blocks that came before there were filters for them, and how long they span; each is looked at once.

    Attributes
    ----------
    blocks : list of Block
        All of them, in order.
    rows : int
        How many they hold.
    steps : float or None
        What they tell of elapsed steps; None where they do not.
    span_s : float
        Seconds between their stamps, without what goes back or leaps over a day.
    came_for_s : float
        Seconds between the arrivals of the first rows and the last.
    """

    def __init__(self) -> None:
        self.blocks: list[Block] = []
        self.rows = 0
        self.steps: float | None = 0.0
        self.span_s = self.came_for_s = 0.0
        self._last_s = np.nan
        self._began_s: float | None = None

    def add(self, block: Block) -> None:
        """Take the next."""
        self.blocks.append(block)
        if not len(block):
            return
        self.rows += len(block)
        if self.steps is not None:
            self.steps = None if block.elapsed is None else self.steps + float(block.elapsed.sum())
        stamps = np.append(self._last_s, block.time_s)
        stamps = stamps[np.isfinite(stamps)]
        with np.errstate(over="ignore"):
            passed = np.diff(stamps)
        self.span_s += float(passed[(passed > 0) & (passed <= _DAY_S)].sum())
        self._last_s = stamps[-1] if len(stamps) else np.nan
        if self._began_s is None:
            self._began_s = block.arrived_s
        self.came_for_s = block.arrived_s - self._began_s


@dataclass(frozen=True)
class Learner:
    """Gathers blocks until they span long enough, and tunes a recipe on them.

    Attributes
    ----------
    learn_s : float
        How long to look, by the stream's own time; with a *short* one the filter starts soon, and knows less of the
        noise and of slow tones.
    lag_s : float or None
        How long each estimate may wait for later readings; None does not.
    channels : tuple of str
        Which to clean; all where none is named.
    """

    learn_s: float
    lag_s: float | None = None
    channels: tuple[str, ...] = ()

    def is_enough(self, early: Early, rate_hz: float | None) -> bool:
        """Whether blocks hold enough rows, and span so long; or have come so long that their stamps stand still."""
        if early.rows < FEWEST_ROWS:
            return False
        if early.steps is not None and rate_hz:
            return early.steps >= self.learn_s * rate_hz
        return early.span_s >= self.learn_s or early.came_for_s >= 2 * self.learn_s + _STANDING_S

    def learn(self, blocks: list[Block], rate_hz: float | None) -> Learned:
        """Tune a recipe on blocks.

        Raises
        ------
        InputError
            If there are too few rows, or their stamps tell no rate.
        """
        full = [block for block in blocks if len(block)]
        rows = sum(len(block) for block in full)
        if rows < FEWEST_ROWS:
            raise InputError(
                f"{rows} rows came, and {FEWEST_ROWS} are needed to learn a filter from; give one with --recipe."
            )
        values = np.concatenate([block.values for block in full])
        with advising_addresses():
            timebase, kept = _time(full, rate_hz)
            recording = Recording(values[kept], names=full[0].names, units=full[0].units, timebase=timebase)
            wishes = Wishes(lag_s=self.lag_s)
            recipe = tune(recording, causal=self.lag_s is None, channels=self.channels or None, wishes=wishes)
        return Learned(recipe, timebase.step_s, timebase.resolution_s)


def resolution_of(stamps_s: Floats) -> float:
    """Return the last digit that some stamps are rounded to, in seconds; 0 where they are too few to tell."""
    finite = stamps_s[np.isfinite(stamps_s)]
    return last_digit(finite) if len(finite) >= FEW_STAMPS else 0.0


def _time(blocks: list[Block], rate_hz: float | None) -> tuple[Timebase, slice | Integers]:
    """Understand the time of blocks, and say which rows have one."""
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
