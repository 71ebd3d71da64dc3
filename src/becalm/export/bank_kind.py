"""A switching bank, in floating point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe
from becalm.export.bank_c import written_bank
from becalm.export.bank_reference import BankReference
from becalm.export.design import Design
from becalm.export.kind import Floating, Span
from becalm.export.vectors import Reference, Vector, expected
from becalm.export.written import Written

_SEED, _TRIES = 20261124, 4
_TIMES = 64.0  # what a last digit of readings moves, at the most: covariances lose some, and count as often as readings


@dataclass(frozen=True)
class Bank(Floating):
    """A switching bank.

    Attributes
    ----------
    opened : dict
        How the reference of what was written is opened, by its source.
    """

    opened: dict[str, Callable[[], Reference]] = field(default_factory=dict, compare=False)

    def write(self, design: Design, prefix: str, span: Span | None) -> Written:
        """Write a filter."""
        return written_bank(design, prefix, self.number, span)

    def reference(self, recipe: ChannelRecipe, design: Design, written: Written) -> Reference:
        """Return what it is held against, at the start."""
        opened = partial(BankReference, recipe, design.step_s, written.largest)
        self.opened[written.source] = opened
        return opened()

    def most_error(self, vector: Vector, written: Written) -> float:
        """Return what a signal may be off by, in unit.

        Where readings lie far from all that a bank expects, its probabilities turn a last digit of them into much
        more. So much may C be off as well: by how far becalm itself moves where the last digits are others.
        """
        moved = written.start_error + _TIMES * self._moved(vector, written)
        return super().most_error(vector, written) + moved

    def _moved(self, vector: Vector, written: Written) -> float:
        """Return how far becalm's own signal moves, at the most, where readings differ in their last digit, in unit."""
        gaps = dict(zip(vector.gap_rows.tolist(), vector.gap_lengths.tolist(), strict=True))
        rng, moved = np.random.default_rng(_SEED), 0.0
        for _ in range(_TRIES):
            digits = rng.uniform(-1.0, 1.0, len(vector.readings)) * 2.0**-self.number.bits
            other = expected(vector.name, vector.readings * (1.0 + digits), gaps, self.opened[written.source]())
            moved = max(moved, float(np.abs(other.signal - vector.signal).max()))
        return moved
