"""How a steady filter follows a step, and how far its output trails.

The response is found from the states that are still to settle, at every reading at first and then at
evenly fewer, so that a slow filter costs no more than a quick one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.steady.steady_filter import SteadyFilter

_WITHIN = 0.02  # of a step's height: settled
_LAST = 1e-5  # of a step's height: what is left may be left out
_LOOKS = 4096
_TURNS = 1e-9  # imaginary part of an eigenvalue of F: above, it is a tone's


class StepResponse(NamedTuple):
    """How a causal filter follows a step; the delays are from the input to the output, both drawn as lines."""

    delay_50_s: float  # at half of its height
    delay_90_s: float  # at nine tenths of it
    overshoot_percent: float
    settling_s: float  # from the first reading of the step until all outputs stay within 2 % of its height


def lag_steps(found: SteadyFilter) -> float:
    """Return how far the output trails, in steps: of a slow signal or of a step at half height, the longer delay.

    Notes
    -----
    Beside tones, or noise that rings as they do, it is that of the step through the whole closed filter, until
    the output stays beyond half of the height: a tone rises at once and falls back. The delay at 0 Hz is then of
    the small rest that tones leave to the motion, as late as the motion is slow; `Response.dc_delay_s` tells it.
    """
    climb = _climb(found)
    return climb.delay_for_good(0.5) if _has_tones(found) else max(found.dc_delay, climb.delay(0.5))


def _has_tones(found: SteadyFilter) -> bool:
    """Return whether the model turns by itself; a motion's eigenvalues are 1."""
    return bool(np.abs(np.linalg.eigvals(found.model.F).imag).max() > _TURNS)


class _Climb(NamedTuple):
    """What is left of a step's height at some of its readings: every one at first, then evenly fewer."""

    k: Floats  # (m,), from -1, the reading before the step
    left: Floats  # (m,), from 1

    def delay(self, level: float) -> float:
        """Return how many steps after the input the output first crosses a level, both drawn as lines."""
        return self._crossing(int(np.argmax(self.left <= 1 - level)), level)

    def delay_for_good(self, level: float) -> float:
        """Return how many steps after the input the output crosses a level for the last time."""
        return self._crossing(int(np.flatnonzero(self.left > 1 - level)[-1]) + 1, level)

    def _crossing(self, i: int, level: float) -> float:
        """Return the delay of the crossing just before a reading."""
        before, now = self.left[i - 1], self.left[i]
        share = (before - (1 - level)) / (before - now)
        return float(self.k[i - 1] + share * (self.k[i] - self.k[i - 1]) + 1 - level)


def _climb(found: SteadyFilter) -> _Climb:
    A, K = found.loop.A, found.loop.K
    x = np.linalg.solve(np.eye(len(A)) - A, K).astype(np.float64)  # of a step that has settled
    slowest = max(float(np.abs(found.poles[0])), 0.1)
    total = len(A) + int(np.log(_LAST) / np.log(slowest))
    stride = max(1, -(-(total - _LOOKS) // _LOOKS))
    power = np.linalg.matrix_power
    later = (power(A, _LOOKS) @ x).astype(np.float64)
    orbit = np.hstack([_orbit(A, x, _LOOKS), _orbit(power(A, stride), later, _LOOKS)])
    k = np.append(np.arange(_LOOKS), _LOOKS + stride * np.arange(_LOOKS)).astype(np.float64) - 1
    left: Floats = (found.row @ orbit)[0] / (found.row @ x)[0]
    return _Climb(k, left)


def _orbit(A: Floats, x: Floats, count: int) -> Floats:
    """Return x, A x, A^2 x and so on side by side, (n, count)."""
    while x.shape[1] < count:
        x, A = np.hstack([x, A @ x]), A @ A
    return x[:, :count]


def tell_step(found: SteadyFilter, step_s: float) -> StepResponse:
    """Tell how a filter that passes 0 Hz follows a step, for a step of `step_s` seconds between readings."""
    climb = _climb(found)
    outside = int(np.flatnonzero(np.abs(climb.left) > _WITHIN)[-1])
    return StepResponse(
        delay_50_s=climb.delay(0.5) * step_s,
        delay_90_s=climb.delay(0.9) * step_s,
        overshoot_percent=100 * max(0.0, -float(climb.left.min())),
        settling_s=float(climb.k[min(outside + 1, len(climb.k) - 1)]) * step_s,
    )
