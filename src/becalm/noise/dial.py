"""One dial in an engineer's words: it sets q/r, and leaves to the recording what it told of noise and order."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.optimize import brentq

from becalm.core.dials import cycles_per_step, motion_filter, ratio_for_bandwidth, ratio_for_lag, ratio_for_noise_gain
from becalm.core.response import decibels, lag_steps
from becalm.errors import UsageError
from becalm.noise.likelihood import Tuning
from becalm.noise.spectrum import motion_power

_HALF_POWER = 1 / np.sqrt(2)
_SLOWEST, _FASTEST = np.log(1e-4), np.log(10.0)  # cut-offs of smoothers, radians a step
_GRID = np.pi * (np.geomspace(1e-6, 1, 4000))


class Dial(NamedTuple):
    """What is asked of a filter, all else left to the recording."""

    kind: Literal["max_lag_s", "bandwidth_hz", "noise_gain_db"]
    value: float


def turn(tuning: Tuning, dial: Dial, step_s: float, causal: bool) -> Tuning:
    """Tune a motion as a dial asks.

    Parameters
    ----------
    tuning : Tuning
        What was found; its order and noise variance stay, tones beside it are left out.
    dial : Dial
        A *small* lag trusts the readings; a *small* bandwidth or noise gain smooths more.
    step_s : float
        Step in seconds.
    causal : bool
        Whether a filter or a smoother shall have what is asked.

    Raises
    ------
    UsageError
        If nothing of this order has it, or a lag is asked of a smoother.
    """
    kind, value = dial
    if kind == "max_lag_s":
        if not causal:
            raise UsageError("A smoother has no lag; with --max-lag add --causal, or ask for --bandwidth.")
        return _quick_enough(tuning, value, step_s)
    if kind == "bandwidth_hz":
        ratio = (ratio_for_bandwidth if causal else _smoother_for_bandwidth)(tuning.order, value, step_s)
    else:
        ratio = (ratio_for_noise_gain if causal else _smoother_for_noise_gain)(tuning.order, value)
    return _at(tuning, ratio)


def _at(tuning: Tuning, ratio: float) -> Tuning:
    return replace(tuning, ratio=ratio, lines=(), log_likelihood=np.nan, loss=np.nan, at_edge="")


def _quick_enough(tuning: Tuning, lag_s: float, step_s: float) -> Tuning:
    """Leave a motion as it is where it is quick enough."""
    alone = _at(tuning, tuning.ratio)
    if lag_steps(motion_filter(tuning.order, tuning.ratio)) * step_s <= lag_s:
        return alone
    return replace(alone, ratio=ratio_for_lag(tuning.order, lag_s, step_s))


def _smoother_for_bandwidth(order: int, bandwidth_hz: float, step_s: float) -> float:
    """Return q/r of the smoother that passes half of the power at a frequency: G = S / (S + R) there."""
    angle = 2 * np.pi * cycles_per_step(bandwidth_hz, step_s)
    power = float(motion_power(order, np.array([angle]))[0])
    return float(_HALF_POWER / (1 - _HALF_POWER) / power)


def _smoother_for_noise_gain(order: int, noise_gain_db: float) -> float:
    """Return q/r of the smoother that leaves so much white noise."""
    power = motion_power(order, _GRID)

    def left_db(log_cutoff: float) -> float:
        passed = 1 / (1 + np.exp(-2 * order * log_cutoff) / power)
        left = float(_GRID[0] + np.trapezoid(passed**2, _GRID)) / np.pi  # what is slower passes whole
        return decibels(left)

    low, high = left_db(_SLOWEST), left_db(_FASTEST)
    if not low < noise_gain_db < high:
        raise UsageError(
            f"noise_gain_db = {noise_gain_db:.6g} is not possible; ask for {low + 0.01:.2f} to {high - 0.01:.2f} dB."
        )
    found = brentq(lambda log_cutoff: left_db(log_cutoff) - noise_gain_db, _SLOWEST, _FASTEST, xtol=1e-12)
    return float(np.exp(2 * order * found))
