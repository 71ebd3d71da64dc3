"""A channel's numbers in seconds, as recipes tell them, and in steps, as filters use them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from numbers import Real

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe, TunedMotion
from becalm.cleaning.recipe_parts import ColouredNoiseRecipe, GateRecipe, ToneRecipe
from becalm.core.filter.gate import Gate, threshold_for
from becalm.core.filter.lag import LONGEST_LAG
from becalm.core.model.autoregressive import ColouredNoise
from becalm.errors import ModelError, RecipeError, UsageError
from becalm.identification.likelihood import Tuning
from becalm.identification.spectrum import ToneOscillator

_SLOWEST, _QUICKEST, _WIDEST = 1e-8, 0.5, 1.0  # cycles a step
_LEAST_DAMPING = 1e-12  # cycles a step: less is none
_APART = 1e-6  # of a frequency: nearer tones are one
_LEAST_RATIO, _GREATEST_RATIO = 1e-60, 1e12  # of q/r: beyond, every reading is ignored or believed
_SAME_RATE = 1e-3
SOON = 3
"""Readings: with a lag up to this a filter's tuning errs less, beyond it a smoother's (`benchmarks/fixed_lag.py`)."""

_WHOLE = 1e-6  # of a step: by so much a lag may fall short of a reading that it counts


def in_seconds(name: str, unit: str, tuning: Tuning, step_s: float, spread: float = 0.0) -> ChannelRecipe:
    """Return the recipe of a channel that was tuned in steps, and whose sigma is wider by a share."""
    noise = tuning.coloured
    return ChannelRecipe(
        name=name,
        unit=unit,
        model="motion",
        order=tuning.order,
        process_noise_density=tuning.ratio * tuning.noise_variance / step_s ** (2 * tuning.order - 1),
        noise_std=float(np.sqrt(tuning.noise_variance)),
        damped_below_hz=tuning.damping / (2 * np.pi * step_s) if tuning.damping else None,
        tuning_spread=spread,
        tone=tuple(_tone_in_seconds(line, step_s) for line in tuning.lines),
        coloured_noise=None
        if noise is None
        else ColouredNoiseRecipe(
            rate_hz=1 / step_s, coefficients=noise.coefficients, std=float(np.sqrt(noise.variance))
        ),
    )


@lru_cache(maxsize=256)  # a channel is opened again and again while it is tuned
def in_steps(tuned: TunedMotion, step_s: float) -> Tuning:
    """Return the numbers of a recipe in steps.

    Raises
    ------
    RecipeError
        If they make no filter at this step: a number is out of float64's reach, a tone is too quick or
        too wide to be read, or coloured noise was told at another rate or grows for ever.
    """
    with np.errstate(all="ignore"):
        variance = float(np.float64(tuned.noise_std) ** 2)
        density = float(np.float64(tuned.process_noise_density) * np.float64(step_s) ** (2 * tuned.order - 1))
    possible = 1e-250 < variance < 1e250 and (density == 0 or _LEAST_RATIO < density / variance < _GREATEST_RATIO)
    if not possible or (density == 0 and tuned.process_noise_density > 0):
        raise RecipeError(
            f"process_noise_density = {tuned.process_noise_density:.3g} and noise_std = {tuned.noise_std:.3g} make"
            f" no filter at {1 / step_s:.6g} Hz; mend them in the recipe, or tune one on this recording."
        )
    _refuse_twins(tuned.tones)
    lines = tuple(_tone_in_steps(tone, variance, step_s) for tone in tuned.tones)
    coloured = _coloured_in_steps(tuned.coloured_noise, step_s)
    damping = _damping_in_steps(tuned.damped_below_hz, step_s)
    found = Tuning(tuned.order, density / variance, variance, 0, lines=lines, coloured=coloured, damping=damping)
    try:
        found.component  # noqa: B018  (refuses noise that grows for ever)
    except ModelError as cause:
        raise RecipeError(f"The recipe's coloured noise makes no filter: {cause}") from cause
    return found


def gate_of(told: GateRecipe, step_s: float) -> Gate:
    """Return the gate of a recipe at this step."""
    return Gate(threshold_for(told.false_alarms_per_hour, 1 / step_s), told.agree, told.at_most)


def lag_in_rows(lag_s: float, step_s: float) -> int:
    """Return how many later readings come within a lag.

    Parameters
    ----------
    lag_s : float
        In seconds; one that falls short of a reading by a millionth of a step still counts it.
    step_s : float
        One step, in seconds.

    Raises
    ------
    UsageError
        If none does, or the lag is no number.
    """
    if not isinstance(lag_s, Real):
        raise UsageError(f"lag_s = {lag_s!r} is no number; give seconds, as in lag_s=0.01.")
    rows = np.floor(float(lag_s) / step_s + _WHOLE)
    if not 1 <= rows <= LONGEST_LAG:
        raise UsageError(
            f"lag_s = {lag_s:.6g} is {rows:.6g} readings at {1 / step_s:.6g} Hz; give {step_s:.6g} to"
            f" {LONGEST_LAG * step_s:.6g} s, or let the filter be causal, or smooth."
        )
    return int(rows)


def _refuse_twins(tones: Sequence[ToneRecipe]) -> None:
    for low, high in pairwise(sorted(tone.frequency_hz for tone in tones)):
        if high - low <= _APART * high:
            raise RecipeError(
                f"The recipe has two tones at {low:.9g} and {high:.9g} Hz, which cannot be told apart; leave one out."
            )


def _tone_in_seconds(line: ToneOscillator, step_s: float) -> ToneRecipe:
    return ToneRecipe(
        frequency_hz=line.angle / (2 * np.pi * step_s),
        bandwidth_hz=line.damping / (np.pi * step_s),
        process_noise_density=line.density / step_s,
        disturbance=line.disturbance,
    )


def _damping_in_steps(damped_below_hz: float | None, step_s: float) -> float:
    if damped_below_hz is None:
        return 0.0
    if not _LEAST_DAMPING < damped_below_hz * step_s < _QUICKEST:
        raise RecipeError(
            f"damped_below_hz = {damped_below_hz:.3g} makes no filter at {1 / step_s:.6g} Hz, which has to be more than"
            " twice as much; mend it in the recipe, or tune one on this recording."
        )
    return 2 * np.pi * damped_below_hz * step_s


def _tone_in_steps(tone: ToneRecipe, variance: float, step_s: float) -> ToneOscillator:
    ratio = tone.process_noise_density * step_s / variance
    if not (_SLOWEST < tone.frequency_hz * step_s < _QUICKEST and tone.bandwidth_hz * step_s < _WIDEST):
        raise RecipeError(
            f"The recipe has a tone at {tone.frequency_hz:.6g} Hz, {tone.bandwidth_hz:.6g} Hz wide, which"
            f" {1 / step_s:.6g} readings a second cannot tell; leave it out, or tune a recipe on this recording."
        )
    if not _LEAST_RATIO < ratio < _GREATEST_RATIO:
        raise RecipeError(
            f"The tone at {tone.frequency_hz:.6g} Hz with process_noise_density = {tone.process_noise_density:.3g}"
            f" and noise_std = {np.sqrt(variance):.3g} makes no filter at {1 / step_s:.6g} Hz; mend the recipe."
        )
    return ToneOscillator(
        angle=2 * np.pi * tone.frequency_hz * step_s,
        damping=np.pi * tone.bandwidth_hz * step_s,
        density=tone.process_noise_density * step_s,
        disturbance=tone.disturbance,
    )


def _coloured_in_steps(noise: ColouredNoiseRecipe | None, step_s: float) -> ColouredNoise | None:
    if noise is None:
        return None
    if abs(noise.rate_hz * step_s - 1) > _SAME_RATE:
        raise RecipeError(
            f"The recipe's coloured noise was told at {noise.rate_hz:.6g} Hz, and means nothing at {1 / step_s:.6g} Hz;"
            " tune a recipe on this recording."
        )
    return ColouredNoise(noise.coefficients, noise.std**2)
