"""The step response of a steady-state filter, and its lag.

The response is computed from the transient of the states: at every reading at first, then at evenly spaced readings
only, so that slow filters take no longer than fast ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.steady.steady_filter import SteadyFilter

_WITHIN = 0.02  # of the height of a step: settled
_LAST = 1e-5  # of the height of a step: the transient ends here
_LOOKS = 4096  # readings in each of the two parts
_TONE = 1e-9  # imaginary part of an eigenvalue of F: above it, the model has a tone


class StepResponse(NamedTuple):
    """Step response of a causal filter; delays are from input to output, with straight lines between samples."""

    delay_50_s: float  # at half of the height
    delay_90_s: float  # at nine tenths of the height
    overshoot_percent: float
    settling_s: float  # from the first reading of the step until the output stays within 2 % of its height


def lag_steps(found: SteadyFilter) -> float:
    """Return the lag of the output in steps: the longer of the delays at low frequency and of a step at half height.

    Notes
    -----
    With tones, or with noise that rings like a tone, the lag is the delay of the step until the output stays above
    half of the height, because a tone rises at once and falls back. The delay at 0 Hz then describes only the small
    part that the tones leave to the motion, and is as long as the motion is slow; see `Response.dc_delay_s`.
    """
    transient = _transient(found)
    return transient.delay_for_good(0.5) if _has_tones(found) else max(found.dc_delay, transient.delay(0.5))


def _has_tones(steady_filter: SteadyFilter) -> bool:
    """Return whether the model oscillates; the eigenvalues of a motion are 1."""
    return bool(np.abs(np.linalg.eigvals(steady_filter.model.F).imag).max() > _TONE)


class _Transient(NamedTuple):
    """The transient of a step response: its remaining part at every reading first, then at evenly spaced readings."""

    k: Floats  # (m,) reading number, from -1, the reading before the step
    remaining: Floats  # (m,) share of the height, from 1

    def delay(self, level: float) -> float:
        """Return the delay in steps until the output first crosses a level."""
        return self._crossing(int(np.argmax(self.remaining <= 1 - level)), level)

    def delay_for_good(self, level: float) -> float:
        """Return the delay in steps until the output crosses a level for the last time."""
        return self._crossing(int(np.flatnonzero(self.remaining > 1 - level)[-1]) + 1, level)

    def _crossing(self, i: int, level: float) -> float:
        """Return the delay of the crossing between reading i - 1 and reading i."""
        before, now = self.remaining[i - 1], self.remaining[i]
        share = (before - (1 - level)) / (before - now)
        return float(self.k[i - 1] + share * (self.k[i] - self.k[i - 1]) + 1 - level)


def _transient(steady_filter: SteadyFilter) -> _Transient:
    A, K = steady_filter.loop.A, steady_filter.loop.K
    x = np.linalg.solve(np.eye(len(A)) - A, K).astype(np.float64)  # states after the transient
    slowest = max(float(np.abs(steady_filter.poles[0])), 0.1)
    total = len(A) + int(np.log(_LAST) / np.log(slowest))
    stride = max(1, -(-(total - _LOOKS) // _LOOKS))
    power = np.linalg.matrix_power
    later = (power(A, _LOOKS) @ x).astype(np.float64)
    orbit = np.hstack([_orbit(A, x, _LOOKS), _orbit(power(A, stride), later, _LOOKS)])
    k = np.append(np.arange(_LOOKS), _LOOKS + stride * np.arange(_LOOKS)).astype(np.float64) - 1
    remaining: Floats = (steady_filter.row @ orbit)[0] / (steady_filter.row @ x)[0]
    return _Transient(k, remaining)


def _orbit(A: Floats, x: Floats, count: int) -> Floats:
    """Return x, A x, A^2 x and so on as columns, (n, count)."""
    while x.shape[1] < count:
        x, A = np.hstack([x, A @ x]), A @ A
    return x[:, :count]


def describe_step(found: SteadyFilter, step_s: float) -> StepResponse:
    """Return the step response of a filter that passes 0 Hz, for readings every `step_s` seconds."""
    transient = _transient(found)
    outside = int(np.flatnonzero(np.abs(transient.remaining) > _WITHIN)[-1])
    return StepResponse(
        delay_50_s=transient.delay(0.5) * step_s,
        delay_90_s=transient.delay(0.9) * step_s,
        overshoot_percent=100 * max(0.0, -float(transient.remaining.min())),
        settling_s=float(transient.k[min(outside + 1, len(transient.k) - 1)]) * step_s,
    )
