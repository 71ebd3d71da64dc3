"""The numbered equations once more, in extended precision: for models whose covariance keeps few of float64's digits.

Of a motion of order 5, or a tone that its first readings hardly show, becalm's own stream rounds its signal away beyond
the twelfth digit. What it decides stays; what it tells is told here with the digits that it means.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats, Integers
from becalm.core.gates import WIDE, level_of
from becalm.core.verdict import Verdict
from becalm.export.design import Design
from becalm.export.factors import factors_of

Long = np.longdouble
_LEAST, _GREATEST = 1e-290, 1e200


class _Sparse(NamedTuple):
    """A matrix with something in each row, of which most is 0: F of a motion, of tones, and of coloured noise."""

    told: Any  # (k,) what is not 0, row by row
    columns: Integers  # (k,) where it stands
    rows: Integers  # (n,) where each row begins in them

    def times(self, M: Any) -> Any:
        """Return its product with a vector (n,) or a matrix (n, m)."""
        return np.add.reduceat((self.told * M[self.columns].T).T, self.rows, axis=0)


def _sparse(M: Any) -> _Sparse:
    rows, columns = np.nonzero(M)
    return _Sparse(M[rows, columns], columns, np.flatnonzero(np.diff(rows, prepend=-1)))


def _held(P: Floats, R: Any) -> Any:
    """Return a covariance as C is given it: in factors, whose last digits count where readings hardly tell a state."""
    U, D = (np.asarray(part, Long) for part in factors_of(P / float(R)))
    return U * D @ U.T * R


class Extended:
    """One channel, from where its first readings told its state.

    Parameters
    ----------
    design : Design
        The filter.
    first : (o,) float array
        The first readings, in unit.
    """

    def __init__(self, design: Design, first: Floats) -> None:
        self._design, self._level = design, Long(first[0])
        model = design.model
        self._F, self._Q, self._H = (np.asarray(part, Long) for part in (model.F, model.process_covariance, model.H[0]))
        self._onward = _sparse(self._F)
        self._R, self._C = Long(design.noise_variance), np.asarray(design.output, Long)
        self._x: Any = np.asarray(design.opening.weights, Long).T @ (np.asarray(first, Long) - self._level)
        self._P: Any = _held(design.opening.P, self._R)
        self._since, self._rows = 0, 0

    @property
    def signal(self) -> float:
        """What is told now, in unit."""
        return float(self._level + self._C @ self._x)

    def follow(self, usable: Floats, verdicts: Codes) -> Floats:
        """Take readings (B,), NaN where none is usable, of which becalm has decided; return the signal."""
        signal = np.empty(len(usable))
        for row, (reading, verdict) in enumerate(zip(usable.tolist(), verdicts.tolist(), strict=True)):
            self._take(reading, verdict)
            signal[row] = self.signal
        return signal

    def leap(self, rows: int) -> None:
        """Go on for some rows without a reading, at once."""
        F, Q = self._F, self._Q
        while rows:
            if rows & 1:
                self._x, self._P = F @ self._x, F @ self._P @ F.T + Q
            F, Q, rows = F @ F, F @ Q @ F.T + Q, rows >> 1
        self._rows = 0

    def _take(self, reading: float, verdict: int) -> None:
        steady, H, R = self._design.steady, self._H, self._R
        used = not (math.isnan(reading) or verdict == Verdict.SPIKE)
        self._x = self._onward.times(self._x)  # (1) F x
        if used and verdict != Verdict.STEP and steady is not None and self._rows >= self._design.settled_rows:
            self._x = self._x + steady.gain[:, 0] * (reading - self._level - H @ self._x)
            self._since += 1
            return
        self._P = self._onward.times(self._onward.times(self._P).T) + self._Q  # (2) F P F' + Q
        if not used:
            self._rows = 0
            return
        nu = reading - self._level - H @ self._x  # (3)
        if verdict == Verdict.STEP:
            self._jump(float(nu))
            self._rows = 0
        HP = H @ self._P
        S = HP @ H + R  # (4)
        K = self._P @ H / S  # (5)
        self._x = self._x + K * nu  # (6)
        AP = self._P - np.outer(K, HP)  # where A = I - K H
        self._P = AP - np.outer(AP @ H - R * K, K)  # (7) A P A' + K R K'
        self._since, self._rows = self._since + 1, self._rows + 1

    def _jump(self, nu: float) -> None:
        """Add what makes an innovation likely, as `native/gate.h`."""
        gate, level = self._design.gate, level_of(self._design.model)
        assert gate is not None, "only a gate sees a step"
        if level >= 0 and self._since >= gate.at_most:
            self._P[level, level] += _round_up(nu * nu / float(self._H[level]) ** 2)
            self._since = -1
            return
        told = float(self._H @ self._P @ self._H)
        square = min(nu * nu, WIDE * float(self._R))
        for i in range(len(self._P)):
            self._P[i, i] += _round_up(square * (float(self._P[i, i]) / told)) if told > 0 else 0.0
        self._since = -len(self._P)


def _round_up(variance: float) -> float:
    if not variance > 0.0:
        return 0.0
    return math.ldexp(1.0, 2 * math.ceil(0.5 * math.log2(min(max(variance, _LEAST), _GREATEST))))
