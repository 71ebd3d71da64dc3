"""A switching bank, in floating point."""

from __future__ import annotations

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe
from becalm.export.bank.reference import BankReference
from becalm.export.bank.text import written_bank
from becalm.export.design import Design
from becalm.export.kind import Floating, Opened, Span
from becalm.export.vectors import Reference, Vector, expected
from becalm.export.written import Written

_SEED, _TRIES = 20261124, 4
_BOTH = 2.0  # becalm and C add up in orders of their own: each is off by as much
_TIMES = 16.0  # what a last digit of readings moves: covariances lose some too, and tell as much


class Bank(Floating):
    """A switching bank."""

    def write(self, design: Design, prefix: str, span: Span | None) -> Written:
        """Write a filter."""
        return written_bank(design, prefix, self.number, span)

    def reference(self, recipe: ChannelRecipe, design: Design, written: Written) -> Reference:
        """Return what it is held against, at the start."""
        return BankReference(recipe, design.step_s, written.largest)

    def most_error(self, vector: Vector, design: Design, written: Written, opened: Opened) -> float:
        """Return what a signal may be off by, in unit.

        Where readings lie far from all that a bank expects, its probabilities turn a last digit of them into much
        more. So much may C be off as well: by how far becalm itself moves where the last digits are others. And each
        row that is missed rounds what is extrapolated, which may be far from any reading, once more: it walks off as a
        sum does. The next reading is weighed against all that the signal may have become, to the last digits of that;
        a single mode may know less than all together, and a covariance in double, which is no product of factors, loses
        as many digits more as it is large beside the noise.
        """
        rows = np.sqrt(vector.gap_lengths.max(initial=0))
        signal, sigma = _extrapolated(vector, opened) if rows else (0.0, 0.0)
        sigma *= max(sigma / design.noise_std, 1.0) if self.number.is_double else 1.0
        gathered = 2.0**-self.number.bits * (float(rows) * signal + _TIMES * sigma)
        moved = written.start_error + _TIMES * self._moved(vector, opened)
        return _BOTH * (super().most_error(vector, design, written, opened) + moved + gathered)

    def most_power(self, vector: Vector, design: Design, most_error: float) -> float:
        """Return what the power of the difference may be, in parts of that of the signal: a fourth of its greatest."""
        power = float(np.square(vector.signal).mean())
        allowed = super().most_power(vector, design, most_error)
        return max(allowed, (most_error / 4) ** 2 / power) if power > 0 else allowed

    def _moved(self, vector: Vector, opened: Opened) -> float:
        """Return how far becalm's own signal moves, at the most, where readings differ in their last digit, in unit."""
        gaps = dict(zip(vector.gap_rows.tolist(), vector.gap_lengths.tolist(), strict=True))
        rng, moved = np.random.default_rng(_SEED), 0.0
        finite = np.nan_to_num(vector.readings, nan=0.0, posinf=0.0, neginf=0.0)
        for _ in range(_TRIES):
            digits = rng.uniform(-1.0, 1.0, len(vector.readings)) * 2.0**-self.number.bits
            other = expected(vector.name, vector.readings + finite * digits, gaps, opened())
            moved = max(moved, float(np.abs(other.signal - vector.signal).max()))
        return moved


def _extrapolated(vector: Vector, opened: Opened) -> tuple[float, float]:
    """Return the greatest signal and the greatest sigma, in unit, with what is told while readings are left out."""
    every, reference = np.insert(vector.readings, np.repeat(vector.gap_rows, vector.gap_lengths), np.nan), opened()
    assert isinstance(reference, BankReference), "a bank is held against one"
    told = reference.push(every)
    return float(np.nanmax(np.abs(told.signal))), float(told.sigma[np.isfinite(told.sigma)].max())
