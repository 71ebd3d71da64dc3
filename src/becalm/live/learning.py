"""A recipe from a stream's first seconds, where none was given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from becalm.cleaning.recipe import Recipe
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats, Integers
from becalm.core.clock import last_digit
from becalm.core.recording import Recording
from becalm.core.timebase import Timebase
from becalm.errors import InputError, TimeError
from becalm.live.block import Block

FEWEST_ROWS = 64
"""Under so many rows nothing is learned: neither the noise nor the rate."""

_FEW_STAMPS = 20


class Learned(NamedTuple):
    """What the first seconds told."""

    recipe: Recipe
    step_s: float
    resolution_s: float


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

    def is_enough(self, blocks: list[Block], rate_hz: float | None) -> bool:
        """Whether the blocks span so long, and hold enough rows."""
        rows = sum(len(block) for block in blocks)
        if rows < FEWEST_ROWS:
            return False
        if blocks[0].elapsed is not None and rate_hz:
            return (
                sum(float(block.elapsed.sum()) for block in blocks if block.elapsed is not None)
                >= self.learn_s * rate_hz
            )
        first, last = next(b for b in blocks if len(b)), next(b for b in reversed(blocks) if len(b))
        return abs(float(last.time_s[-1] - first.time_s[0])) >= self.learn_s

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
        timebase, kept = _time(full, rate_hz)
        recording = Recording(values[kept], names=full[0].names, units=full[0].units, timebase=timebase)
        recipe = tune(
            recording, causal=self.lag_s is None, channels=self.channels or None, wishes=Wishes(lag_s=self.lag_s)
        )
        return Learned(recipe, timebase.step_s, timebase.resolution_s)


def resolution_of(stamps_s: Floats) -> float:
    """Return the last digit that some stamps are rounded to, in seconds; 0 where they are too few to tell."""
    finite = stamps_s[np.isfinite(stamps_s)]
    return last_digit(finite) if len(finite) >= _FEW_STAMPS else 0.0


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
