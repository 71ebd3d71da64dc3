"""Find the ratio q/r of a motion whose filter or smoother has a given bandwidth, lag or noise gain.

Time is in steps, and variances are in units of r; q/r is defined as in `Tuning.ratio`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

import numpy as np

from becalm.core.closed_forms import cutoff_to_ratio, motion_power
from becalm.core.model.components import motion
from becalm.core.model.parts import checked_step
from becalm.core.steady.response import decibels, describe, lag_steps
from becalm.core.steady.steady_filter import SteadyFilter, steady
from becalm.errors import UsageError

# lowest cut-off in radians per step, by order; below this value rounding errors dominate
_SLOWEST = {1: 1e-6, 2: 1e-6, 3: 3e-6, 4: 1e-4, 5: 1e-4}
_FASTEST = 1e12  # largest q/r; above this value the filter passes every reading unchanged
_PRECISION = 1e-12  # tolerance for the logarithm of the cut-off
_HALF = np.sqrt(0.5) / (1 - np.sqrt(0.5))  # S/R at which the smoother S / (S + R) passes half of the power
_UNITS = {"bandwidth_hz": "Hz", "lag_s": "s", "noise_gain_db": "dB"}


def motion_filter(order: int, ratio: float) -> SteadyFilter:
    """Return the steady-state filter of a motion of order 1 to 5 with step 1, for q/r with q in unit^2/step^(2n-1)."""
    return steady(motion(order, ratio).to_model(1.0, 1.0))


def ratio_for_bandwidth(order: int, bandwidth_hz: float, step_s: float, causal: bool = True) -> float:
    """Return the q/r at which the filter or smoother of a motion has a given -3 dB bandwidth.

    Parameters
    ----------
    order : int
        Order of the motion, 1 to 5.
    bandwidth_hz : float
        Frequency that passes with half of its power, in hertz, below half the rate; a *small* one smooths more.
    step_s : float
        Step, in seconds.
    causal : bool
        True for the bandwidth of the filter, False for that of the smoother.

    Raises
    ------
    ModelError
        If the order is not 1 to 5, or the step is not positive.
    UsageError
        If no filter of this order has the bandwidth; the message gives the possible range.
    """
    motion(order)  # checks the order
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
        lambda steady_filter: float(steady_filter.filter_power([cycles])[0]) - 0.5,
        lambda steady_filter: describe(steady_filter.model, step_s).bandwidth_hz,
    )


def ratio_for_lag(order: int, lag_s: float, step_s: float) -> float:
    """Return the q/r at which the causal filter of a motion has a given lag.

    Parameters
    ----------
    order : int
        Order of the motion, 1 to 5.
    lag_s : float
        Largest delay of the output, in seconds, with straight lines between samples: the delay of a slow ramp, or that
        of a step at half of its height, whichever is longer. (From order 2 on, the delay of a ramp is 0, but that of a
        step is not.) For order 1 the delay of a ramp is the longer one, (1 - K) / K steps. A *small* lag trusts the
        readings and smooths less.
    step_s : float
        Step, in seconds.

    Raises
    ------
    ModelError
        If the order is not 1 to 5, or the step is not positive.
    UsageError
        If no filter of this order has the lag; the message gives the possible range.
    """
    motion(order)  # checks the order
    step_s = checked_step(step_s)
    steps = lag_s / step_s
    if not 0 < steps < np.inf:
        raise UsageError(f"lag_s = {lag_s} is not possible; give a positive number of seconds: 0 filters nothing.")
    return _solve(
        order,
        ("lag_s", lag_s),
        lambda steady_filter: steps - lag_steps(steady_filter),
        lambda steady_filter: lag_steps(steady_filter) * step_s,
    )


def ratio_for_noise_gain(order: int, noise_gain_db: float, causal: bool = True) -> float:
    """Return the q/r at which the filter or smoother of a motion has a given noise gain.

    Parameters
    ----------
    order : int
        Order of the motion, 1 to 5.
    noise_gain_db : float
        Power of white noise after the filter over that before, in dB, below 0; a *small* one, as -40, smooths more.
    causal : bool
        True for the noise gain of the filter, False for that of the smoother.

    Raises
    ------
    ModelError
        If the order is not 1 to 5.
    UsageError
        If no filter of this order has the noise gain; the message gives the possible range.
    """
    motion(order)  # checks the order
    if not noise_gain_db < 0:
        raise UsageError(
            f"noise_gain_db = {noise_gain_db} removes no noise; for noise down by 14 dB give noise_gain_db = -14."
        )
    gain, lag = 10 ** (noise_gain_db / 10), 0 if causal else np.inf
    K = 2 * gain / (1 + gain)
    if causal and order == 1 and _SLOWEST[1] <= K < 1:
        return float(K**2 / (1 - K))
    return _solve(
        order,
        ("noise_gain_db", noise_gain_db),
        lambda steady_filter: steady_filter.noise_gain(lag) - gain,
        lambda steady_filter: decibels(steady_filter.noise_gain(lag)),
    )


def _cycles_per_step(bandwidth_hz: float, step_s: float) -> float:
    """Return a bandwidth in cycles per step; raise an error unless it is between 0 and half the sampling rate."""
    cycles = bandwidth_hz * step_s
    if not 0 < cycles < 0.5:
        raise UsageError(
            f"bandwidth_hz = {bandwidth_hz:.6g} is not possible at {1 / step_s:.6g} Hz;"
            f" ask for more than 0 and less than {0.5 / step_s:.6g} Hz, half the rate."
        )
    return cycles


def _smoother_for_bandwidth(order: int, cycles: float, step_s: float) -> float:
    """Return q/r of the smoother that passes half of the power at a frequency; S / R is q/r times `motion_power`."""
    ratio = _HALF / float(motion_power(order, np.array([2 * np.pi * cycles]))[0])
    if ratio < cutoff_to_ratio(order, _SLOWEST[order]):
        slowest = _SLOWEST[order] * _HALF ** (-1 / (2 * order)) / (2 * np.pi)
        _refuse("bandwidth_hz", cycles / step_s, order, (slowest / step_s, 0.5 / step_s))
    return float(ratio)


def _solve(
    order: int,
    requested: tuple[str, float],
    excess: Callable[[SteadyFilter], float],
    measure: Callable[[SteadyFilter], float],
) -> float:
    """Return the q/r at which an increasing function `excess` is 0.

    `requested` is the name and value that the user gave; `measure` returns this quantity for a filter, in its unit.
    """
    from scipy.optimize import brentq

    low, high = np.log(_SLOWEST[order]), np.log(_FASTEST) / (2 * order)

    def ratio_at(log_cutoff: float) -> float:
        return cutoff_to_ratio(order, float(np.exp(log_cutoff)))

    def at(log_cutoff: float) -> SteadyFilter:
        return motion_filter(order, ratio_at(log_cutoff))

    if excess(at(low)) > 0 or excess(at(high)) < 0:
        _refuse(*requested, order, (measure(at(low)), measure(at(high))))
    return ratio_at(brentq(lambda x: excess(at(x)), low, high, xtol=_PRECISION, rtol=_PRECISION))


def _refuse(name: str, value: float, order: int, possible: tuple[float, float]) -> NoReturn:
    """Raise an error with the possible range of a setting."""
    low, high = sorted(possible)
    raise UsageError(
        f"{name} = {value:.6g} is not possible with order {order}; ask for {low:.3g} to {high:.3g} {_UNITS[name]}."
    )
