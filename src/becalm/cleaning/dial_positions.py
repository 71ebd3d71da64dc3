"""Compute the filters at the positions of a page's dial, from fast to smooth, and summarise a channel's filter."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels.figures import fixed_response
from becalm.cleaning.recipes.limits_entry import smoothing_rows
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.steps import in_steps
from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio
from becalm.core.steady.response import decibels
from becalm.core.steady.steady_filter import steady
from becalm.errors import ModelError
from becalm.identification.likelihood import Tuning

POSITIONS = 81
"""Number of positions of a dial; the ratio of the cut-offs of neighbouring positions is constant."""

_FASTEST = 4.0  # highest cut-off, in radians per step: with a higher one the filter passes everything
# Lowest cut-off by the order of the motion, in radians per step: below it float64 cannot compute the steady state.
_SLOWEST = {1: 3e-6, 2: 3e-6, 3: 1e-5, 4: 3e-4, 5: 3e-4}
_CYCLES = 0.2  # lowest cut-off, in cycles per record: with a lower one the filter only fits a polynomial


class Positions(NamedTuple):
    """The filters at the k positions, from fast to smooth, with time in steps and a noise variance of 1."""

    ratios: Floats  # (k,) q/r
    bandwidth: Floats  # (k,) cycles per step; NaN where unknown
    lag: Floats  # (k,) steps; NaN where unknown
    noise_left: Floats  # (k,) standard deviation of the noise that passes the filter; NaN where unknown


class FilterSummary(NamedTuple):
    """The bandwidth, lag and noise of a filter; None where a figure is unknown."""

    bandwidth_hz: float | None = None
    lag_s: float | None = None
    noise_std: float | None = None  # of a reading, in unit
    noise_left: float | None = None  # standard deviation of the noise that passes the filter, in unit
    noise_gain_db: float | None = None
    order: int | None = None
    says: str = ""  # the figures in words, or why they are unknown


def density_unit(unit: str, order: int) -> str:
    """Return the unit of a process noise density, unit^2/s^(2 order - 1), for readings in `unit`."""
    squared = f"({unit})^2" if "/" in unit or "^" in unit else f"{unit}^2" if unit else "1"
    return f"{squared}/s^{2 * order - 1}".removesuffix("^1")


def dial(channel: ChannelRecipe, step_s: float, lag: int | None, rows: int) -> dict[str, Floats]:
    """Return the figures of the filter at each position of a channel's dial; empty if the channel passes unchanged.

    Parameters
    ----------
    channel : ChannelRecipe
        Recipe of the channel, of which only the order, the noise and the limits are used.
    step_s : float
        One step, in seconds.
    lag : int or None
        Lag in rows: 0 for a causal filter, None for a smoother.
    rows : int
        Length of the record, in rows.

    Returns
    -------
    dict of str to (POSITIONS,) float array
        "process_noise_density" in unit^2/s^(2 order - 1), "bandwidth_hz", "lag_s", and "noise_left", the standard
        deviation of the noise that passes the filter, in unit. A figure is NaN where it is unknown.
    """
    if channel.motion is None:
        return {}
    order, noise_std = channel.motion.order, channel.motion.noise_std
    slowest = float(np.clip(2 * np.pi * _CYCLES / rows, _SLOWEST[order], _FASTEST / 100))
    positions = _positions(order, smoothing_rows(channel.limits, lag), slowest)
    return {
        "process_noise_density": positions.ratios * noise_std**2 / step_s ** (2 * order - 1),
        "bandwidth_hz": positions.bandwidth / step_s,
        "lag_s": (np.full(POSITIONS, float(lag)) if lag else positions.lag) * step_s,
        "noise_left": positions.noise_left * noise_std,
    }


@lru_cache(maxsize=64)
def _positions(order: int, lag: int | None, slowest: float) -> Positions:
    ratios = [cutoff_to_ratio(order, float(cutoff)) for cutoff in np.geomspace(_FASTEST, slowest, POSITIONS)]
    figures = np.array([_figures_in_steps(Tuning(order, ratio, 1.0, 0), lag) for ratio in ratios])
    return Positions(np.array(ratios), *figures.T.copy())


def _figures_in_steps(tuning: Tuning, lag: int | None) -> tuple[float, float, float]:
    """Return the bandwidth, lag and remaining noise of a filter, as in `Positions`; NaN where they are unknown."""
    if lag:
        gain = _gain_of_lagged(tuning, lag)
        return np.nan, np.nan, np.nan if gain is None else float(np.sqrt(gain))
    response = fixed_response(tuning, 1.0, lag == 0)
    if response is None:
        return np.nan, np.nan, np.nan
    return response.bandwidth_hz, response.lag_s, float(np.sqrt(response.noise_gain))


def summary_of(channel: ChannelRecipe, step_s: float, lag: int | None) -> FilterSummary:
    """Return a summary of a channel's filter.

    Parameters
    ----------
    channel : ChannelRecipe
        Recipe of the channel.
    step_s : float
        One step, in seconds.
    lag : int or None
        Lag in rows: 0 for a causal filter, None for a smoother.

    Raises
    ------
    RecipeError
        If the parameters do not make a valid filter at this step.
    """
    if channel.motion is None:
        return FilterSummary(says="passes unchanged")
    order, noise_std = channel.motion.order, channel.motion.noise_std
    if channel.switching is not None:
        modes = ", ".join(mode.name for mode in channel.switching.mode)
        return FilterSummary(noise_std=noise_std, order=order, says=f"a filter for each of its modes: {modes}")
    tuning = in_steps(channel.motion, step_s)
    if lag:
        gain = _gain_of_lagged(tuning, smoothing_rows(channel.limits, lag) or lag)
        if gain is None:
            return FilterSummary(None, lag * step_s, noise_std, None, None, order, _NO_STEADY_STATE)
        summary = f"delayed {lag * step_s:.4g} s, noise down {-decibels(gain):.1f} dB"
        return FilterSummary(
            None, lag * step_s, noise_std, noise_std * float(np.sqrt(gain)), decibels(gain), order, summary
        )
    response = fixed_response(tuning, step_s, lag == 0)
    if response is None:
        return FilterSummary(noise_std=noise_std, order=order, says=_NO_STEADY_STATE)
    return FilterSummary(
        response.bandwidth_hz,
        response.lag_s,
        noise_std,
        noise_std * float(np.sqrt(response.noise_gain)),
        response.noise_gain_db,
        order,
        str(response),
    )


_NO_STEADY_STATE = "a filter without a steady state"


def _gain_of_lagged(tuning: Tuning, lag: int) -> float | None:
    """Return the noise gain of a filter with a lag in rows; None if it has no steady state."""
    component = tuning.component
    try:
        steady_filter = steady(component.to_model(1.0, tuning.noise_variance), component.signal_output[0])
        return steady_filter.noise_gain(lag)
    except ModelError:
        return None
