"""The terms of a log-likelihood, summed over parts of a record."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Sums(NamedTuple):
    """The terms of a log-likelihood, summed over readings."""

    squares: float = 0.0  # sum of nu' S^-1 nu
    log_det: float = 0.0  # sum of log det S
    used: int = 0  # number of readings

    @property
    def log_likelihood(self) -> float:
        """The Gaussian log-likelihood of the readings used, equation (8)."""
        return float(-0.5 * (self.squares + self.log_det + self.used * np.log(2 * np.pi)))

    def plus(self, other: Sums) -> Sums:
        """Return the sums over the readings of this and the other."""
        return Sums(self.squares + other.squares, self.log_det + other.log_det, self.used + other.used)
