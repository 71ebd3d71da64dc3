"""The dials: the ratio q/r of a motion whose filter or smoother has a bandwidth, a lag or a noise gain.

All in steps and with r = 1; q/r counts as in `Tuning.ratio`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

import numpy as np

from becalm.core.closed_forms import cutoff_to_ratio, motion_power
from becalm.core.model.components import motion
from becalm.core.model.parts import checked_step
from becalm.core.steady.response import decibels, describe
from becalm.core.steady.steady_filter import SteadyFilter
from becalm.core.steady.steady_gain import steady
from becalm.core.steady.step_response import lag_steps
from becalm.errors import UsageError

_SLOWEST = {1: 1e-6, 2: 1e-6, 3: 3e-6, 4: 1e-4, 5: 1e-4}  # cut-off in radians a step: below, rounding decides
_FASTEST = 1e12  # q/r: above, every reading is believed
_PRECISION = 1e-12  # of the logarithm of the cut-off
_HALF = np.sqrt(0.5) / (1 - np.sqrt(0.5))  # S/R where the smoother S / (S + R) passes half of the power
_UNITS = {"bandwidth_hz": "Hz", "lag_s": "s", "noise_gain_db": "dB"}


def motion_filter(order: int, ratio: float) -> SteadyFilter:
    """Return the steady filter of a motion of order 1 to 5, for q/r with q in unit^2/step^(2n-1); its step is 1."""
    return steady(motion(order, ratio).to_model(1.0, 1.0))


def ratio_for_bandwidth(order: int, bandwidth_hz: float, step_s: float, causal: bool = True) -> float:
    """Return the q/r of a motion whose filter or smoother has a -3 dB bandwidth.

    Parameters
    ----------
    order : int
        1 to 5.
    bandwidth_hz : float
        Highest frequency that passes with half of its power, below half the rate; a *small* one smooths more.
    step_s : float
        Step in seconds.
    causal : bool
        Whether the filter (True) or the smoother shall have it.

    Raises
    ------
    ModelError
        If there is no such order, or the step is not positive.
    UsageError
        If nothing of this order has it; the sentence says which are possible.
    """
    motion(order)  # refuses what is none
    step_s = checked_step(step_s)
    cycles = _cycles_per_step(bandwidth_hz, step_s)
    if not causal:
        return _smoother_for_bandwidth(order, cycles, step_s)
    ratio = float(4 * np.sin(np.pi * cycles) ** 2)
    if order == 1 and ratio >= _SLOWEST[1] ** 2:
        return ratio
    return _solve(
        order,
        ("bandwidth_hz", bandwidth_hz),
        lambda found: float(found.filter_power([cycles])[0]) - 0.5,
        lambda found: describe(found.model, step_s).bandwidth_hz,
    )


def ratio_for_lag(order: int, lag_s: float, step_s: float) -> float:
    """Return the q/r of a motion whose causal filter trails by a lag.

    Parameters
    ----------
    order : int
        1 to 5.
    lag_s : float
        Of the output behind its input, drawn as lines: of a slow ramp, or of a step at half of its
        height, whichever is longer. So neither ramp nor edge comes later than this. (The first
        alone would be 0 from order 2 on, although an edge comes late.) For order 1 it is the ramp:
        (1 - K) / K steps. A *small* one trusts the readings and smooths less.
    step_s : float
        Step in seconds.

    Raises
    ------
    ModelError
        If there is no such order, or the step is not positive.
    UsageError
        If no filter of this order has it; the sentence says which are possible.
    """
    motion(order)  # refuses what is none
    step_s = checked_step(step_s)
    steps = lag_s / step_s
    if not 0 < steps < np.inf:
        raise UsageError(f"lag_s = {lag_s} is not possible; give a positive number of seconds: 0 would filter nothing.")
    return _solve(
        order,
        ("lag_s", lag_s),
        lambda found: steps - lag_steps(found),
        lambda found: lag_steps(found) * step_s,
    )


def ratio_for_noise_gain(order: int, noise_gain_db: float, causal: bool = True) -> float:
    """Return the q/r of a motion whose filter or smoother leaves so much white noise.

    Parameters
    ----------
    order : int
        1 to 5.
    noise_gain_db : float
        Noise power after it over before, in dB, so below 0; a *small* one (-40) smooths more.
    causal : bool
        Whether the filter (True) or the smoother shall leave it.

    Raises
    ------
    ModelError
        If there is no such order.
    UsageError
        If nothing of this order has it; the sentence says which are possible.
    """
    motion(order)  # refuses what is none
    if not noise_gain_db < 0:
        raise UsageError(
            f"noise_gain_db = {noise_gain_db} removes no noise; for noise down by 14 dB give noise_gain_db = -14."
        )
    wanted, waited = 10 ** (noise_gain_db / 10), 0 if causal else np.inf
    K = 2 * wanted / (1 + wanted)
    if causal and order == 1 and _SLOWEST[1] <= K < 1:
        return float(K**2 / (1 - K))
    return _solve(
        order,
        ("noise_gain_db", noise_gain_db),
        lambda found: found.noise_gain(waited) - wanted,
        lambda found: decibels(found.noise_gain(waited)),
    )


def _cycles_per_step(bandwidth_hz: float, step_s: float) -> float:
    """Return a bandwidth in cycles a step; refuse what is not between 0 and half the rate."""
    cycles = bandwidth_hz * step_s
    if not 0 < cycles < 0.5:
        raise UsageError(
            f"bandwidth_hz = {bandwidth_hz:.6g} is not possible at {1 / step_s:.6g} Hz;"
            f" ask for more than 0 and less than {0.5 / step_s:.6g} Hz, half the rate."
        )
    return cycles


def _smoother_for_bandwidth(order: int, cycles: float, step_s: float) -> float:
    """Return q/r of the smoother that passes half of the power at a frequency: S / R = q/r motion_power there."""
    ratio = _HALF / float(motion_power(order, np.array([2 * np.pi * cycles]))[0])
    if ratio < cutoff_to_ratio(order, _SLOWEST[order]):
        slowest = _SLOWEST[order] * _HALF ** (-1 / (2 * order)) / (2 * np.pi)
        _refuse("bandwidth_hz", cycles / step_s, order, (slowest / step_s, 0.5 / step_s))
    return float(ratio)


def _solve(
    order: int,
    asked: tuple[str, float],
    excess: Callable[[SteadyFilter], float],
    told: Callable[[SteadyFilter], float],
) -> float:
    """Find q/r where an excess, which grows with it, is 0; `told` is what was asked for, in its unit."""
    from scipy.optimize import brentq

    low, high = np.log(_SLOWEST[order]), np.log(_FASTEST) / (2 * order)

    def ratio_at(log_cutoff: float) -> float:
        return cutoff_to_ratio(order, float(np.exp(log_cutoff)))

    def at(log_cutoff: float) -> SteadyFilter:
        return motion_filter(order, ratio_at(log_cutoff))

    if excess(at(low)) > 0 or excess(at(high)) < 0:
        _refuse(*asked, order, (told(at(low)), told(at(high))))
    return ratio_at(brentq(lambda x: excess(at(x)), low, high, xtol=_PRECISION, rtol=_PRECISION))


def _refuse(name: str, value: float, order: int, possible: tuple[float, float]) -> NoReturn:
    """Say what is possible in the place of what was asked."""
    low, high = sorted(possible)
    raise UsageError(
        f"{name} = {value:.6g} is not possible with order {order}; ask for {low:.3g} to {high:.3g} {_UNITS[name]}."
    )
