"""Compute the filters at the positions of a dial, from fast to smooth, and summarise the present filter."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from becalm.cleaning.figures import fixed_response
from becalm.cleaning.limits_entry import rows_that_smooth
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.steps import in_steps
from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio
from becalm.core.steady.response import decibels
from becalm.core.steady.steady_filter import steady
from becalm.errors import ModelError
from becalm.identification.likelihood import Tuning

POSITIONS = 81
"""Number of positions of a dial; the ratio of the cut-offs of neighbouring positions is constant."""

_FASTEST = 4.0  # highest cut-off, in radians per step: a higher one passes everything
_SLOWEST = {1: 3e-6, 2: 3e-6, 3: 1e-5, 4: 3e-4, 5: 3e-4}  # lowest cut-offs, by order, with a steady state in float64
_CYCLES = 0.2  # lowest cut-off, in cycles per record: with a lower one the filter only fits a polynomial


class Positions(NamedTuple):
    """The filters at the k positions, from fast to smooth, in steps and for readings with a noise variance of 1."""

    ratios: Floats  # (k,) q/r
    bandwidth: Floats  # (k,) cycles per step; NaN where it is unknown, as in the following
    lag: Floats  # (k,) steps
    left: Floats  # (k,) standard deviation of the noise that passes


class FilterSummary(NamedTuple):
    """Bandwidth, lag and noise of a filter; None where a figure is unknown."""

    bandwidth_hz: float | None = None
    lag_s: float | None = None
    noise_std: float | None = None  # of a reading, in unit
    noise_left: float | None = None  # standard deviation of the noise that passes, in unit
    noise_gain_db: float | None = None
    order: int | None = None
    says: str = ""  # the figures in words, or why they are unknown


def density_unit(unit: str, order: int) -> str:
    """Return the unit of a process noise density: unit^2/s^(2 order - 1); `unit` is that of the readings."""
    squared = f"({unit})^2" if "/" in unit or "^" in unit else f"{unit}^2" if unit else "1"
    return f"{squared}/s^{2 * order - 1}".removesuffix("^1")


def dial(channel: ChannelRecipe, step_s: float, lag: int | None, rows: int) -> dict[str, Floats]:
    """Return the figures of the filter at each position of a channel's dial; empty if the channel passes unchanged.

    Parameters
    ----------
    channel : ChannelRecipe
        Present recipe, of which order, noise and limits are used.
    step_s : float
        One step, in seconds.
    lag : int or None
        Lag in rows: 0 for a causal filter, None for a smoother.
    rows : int
        Length of the record, in rows.

    Returns
    -------
    dict of str to (POSITIONS,) float array
        process_noise_density in unit^2/s^(2 order - 1), bandwidth_hz, lag_s, and noise_left, the standard deviation of
        the noise that passes, in unit; NaN where a figure is unknown.
    """
    if channel.motion is None:
        return {}
    order, noise_std = channel.motion.order, channel.motion.noise_std
    slowest = float(np.clip(2 * np.pi * _CYCLES / rows, _SLOWEST[order], _FASTEST / 100))
    found = _positions(order, rows_that_smooth(channel.limits, lag), slowest)
    return {
        "process_noise_density": found.ratios * noise_std**2 / step_s ** (2 * order - 1),
        "bandwidth_hz": found.bandwidth / step_s,
        "lag_s": (np.full(POSITIONS, float(lag)) if lag else found.lag) * step_s,
        "noise_left": found.left * noise_std,
    }


@lru_cache(maxsize=64)
def _positions(order: int, lag: int | None, slowest: float) -> Positions:
    ratios = [cutoff_to_ratio(order, float(cutoff)) for cutoff in np.geomspace(_FASTEST, slowest, POSITIONS)]
    figures = np.array([_figures_in_steps(Tuning(order, ratio, 1.0, 0), lag) for ratio in ratios])
    return Positions(np.array(ratios), *figures.T.copy())


def _figures_in_steps(tuning: Tuning, lag: int | None) -> tuple[float, float, float]:
    """Return bandwidth, lag and remaining noise of a motion, as in `Positions`; NaN where they are unknown."""
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
        Present recipe.
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
        gain = _gain_of_lagged(tuning, rows_that_smooth(channel.limits, lag) or lag)
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
        found = steady(component.to_model(1.0, tuning.noise_variance), component.signal_output[0])
        return found.noise_gain(lag)
    except ModelError:
        return None
