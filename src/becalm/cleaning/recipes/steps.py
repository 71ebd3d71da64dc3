"""Convert the parameters of a channel between seconds (recipes) and steps (filters)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import pairwise
from numbers import Real

import numpy as np

from becalm.cleaning.recipes.recipe import ChannelRecipe, TunedMotion
from becalm.cleaning.recipes.recipe_parts import ColouredNoiseRecipe, GateRecipe, ToneRecipe
from becalm.core.filter.fixed_lag_flow import LONGEST_LAG
from becalm.core.filter.gate import Gate, threshold_for
from becalm.core.model.autoregressive import ColouredNoise
from becalm.errors import ModelError, RecipeError, UsageError
from becalm.identification.likelihood import Tuning
from becalm.identification.spectrum import ToneOscillator

_SLOWEST, _QUICKEST, _WIDEST = 1e-8, 0.5, 1.0  # cycles per step: range of a tone's frequency, and its largest bandwidth
_LEAST_DAMPING = 1e-12  # cycles per step: `damped_below_hz` must be greater
_APART = 1e-6  # relative difference of frequencies up to which two tones cannot be distinguished
_LEAST_RATIO, _GREATEST_RATIO = 1e-60, 1e12  # range of q/r: outside it, readings are ignored or fully trusted
_SAME_RATE = 1e-3  # largest relative difference of rates that count as equal
SOON = 3
"""Largest lag, in readings, at which a filter with a lag is tuned like a causal filter instead of a smoother.

Up to this lag, tuning it like a causal filter gives the smaller error, as `benchmarks/fixed_lag.py` measures.
"""

_WHOLE = 1e-6  # of a step: a lag may be this much shorter than a whole number of readings


def in_seconds(name: str, unit: str, tuning: Tuning, step_s: float, spread: float = 0.0) -> ChannelRecipe:
    """Return the recipe of a channel, in seconds, from its tuning in steps; `spread` becomes its `tuning_spread`."""
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
        tone=tuple(_tone_in_seconds(tone, step_s) for tone in tuning.tones),
        coloured_noise=None
        if noise is None
        else ColouredNoiseRecipe(
            rate_hz=1 / step_s, coefficients=noise.coefficients, std=float(np.sqrt(noise.variance))
        ),
    )


@lru_cache(maxsize=256)  # tuning calls this many times for the same channel
def in_steps(tuned: TunedMotion, step_s: float) -> Tuning:
    """Return the parameters of a recipe in steps.

    Raises
    ------
    RecipeError
        If the parameters do not make a valid filter at this step: a number exceeds the range of float64, a tone is too
        fast or too wide for the rate, two tones cannot be distinguished, the damping is out of range, or coloured noise
        was identified at another rate or is unstable.
    """
    with np.errstate(all="ignore"):
        variance = float(np.float64(tuned.noise_std) ** 2)
        density = float(np.float64(tuned.process_noise_density) * np.float64(step_s) ** (2 * tuned.order - 1))
    representable = 1e-250 < variance < 1e250
    possible = representable and (density == 0 or _LEAST_RATIO < density / variance < _GREATEST_RATIO)
    if not possible or (density == 0 and tuned.process_noise_density > 0):
        advice = "tune one on this recording" if representable else "give the readings in another unit"
        raise RecipeError(
            f"process_noise_density = {tuned.process_noise_density:.3g} and noise_std = {tuned.noise_std:.3g} do"
            f" not make a valid filter at {1 / step_s:.6g} Hz; correct them in the recipe, or {advice}."
        )
    _refuse_equal_tones(tuned.tones)
    tones = tuple(_tone_in_steps(tone, variance, step_s) for tone in tuned.tones)
    coloured = _coloured_in_steps(tuned.coloured_noise, step_s)
    damping = _damping_in_steps(tuned.damped_below_hz, step_s)
    found = Tuning(tuned.order, density / variance, variance, 0, tones=tones, coloured=coloured, damping=damping)
    try:
        found.component  # noqa: B018  (raises an error if the coloured noise is unstable)
    except ModelError as cause:
        raise RecipeError(f"The recipe's coloured noise does not make a valid filter: {cause}") from cause
    return found


def gate_of(entry: GateRecipe, step_s: float) -> Gate:
    """Return the innovation gate of a recipe for a step of `step_s` seconds."""
    return Gate(threshold_for(entry.false_alarms_per_hour, 1 / step_s), entry.agree, entry.at_most)


def lag_in_rows(lag_s: float, step_s: float) -> int:
    """Return a lag as a number of readings, rounded down.

    Parameters
    ----------
    lag_s : float
        Lag in seconds. A lag that is at most a millionth of a step below a whole number of readings is rounded up.
    step_s : float
        One step, in seconds.

    Raises
    ------
    UsageError
        If the lag is shorter than one step, longer than `LONGEST_LAG` readings, or not a number.
    """
    rows = np.floor(checked_lag_s(lag_s) / step_s + _WHOLE)
    if not 1 <= rows <= LONGEST_LAG:
        raise UsageError(
            f"lag_s = {lag_s:.6g} is {rows:.6g} readings at {1 / step_s:.6g} Hz; give {step_s:.6g} to"
            f" {LONGEST_LAG * step_s:.6g} s, or use a causal filter or a smoother."
        )
    return int(rows)


def checked_lag_s(lag_s: object) -> float:
    """Return a lag in seconds as float; raise a UsageError if it is not a number."""
    if isinstance(lag_s, Real) and not isinstance(lag_s, bool):
        with suppress(OverflowError):
            return float(lag_s)
    raise UsageError(f"lag_s = {lag_s!r} is not a number; give seconds, as in lag_s=0.01.")


def _refuse_equal_tones(tones: Sequence[ToneRecipe]) -> None:
    for low, high in pairwise(sorted(tone.frequency_hz for tone in tones)):
        if high - low <= _APART * high:
            raise RecipeError(
                f"The recipe has two tones at {low:.9g} and {high:.9g} Hz, which cannot be distinguished; remove one."
            )


def _tone_in_seconds(tone: ToneOscillator, step_s: float) -> ToneRecipe:
    return ToneRecipe(
        frequency_hz=tone.angle / (2 * np.pi * step_s),
        bandwidth_hz=tone.damping / (np.pi * step_s),
        process_noise_density=tone.density / step_s,
        disturbance=tone.disturbance,
    )


def _damping_in_steps(damped_below_hz: float | None, step_s: float) -> float:
    if damped_below_hz is None:
        return 0.0
    if not _LEAST_DAMPING < damped_below_hz * step_s < _QUICKEST:
        raise RecipeError(
            f"damped_below_hz = {damped_below_hz:.3g} does not make a valid filter at {1 / step_s:.6g} Hz. It must be"
            f" more than {_LEAST_DAMPING / step_s:.3g} Hz and less than {_QUICKEST / step_s:.6g} Hz, half of the rate;"
            " correct it in the recipe, or tune one on this recording."
        )
    return 2 * np.pi * damped_below_hz * step_s


def _tone_in_steps(tone: ToneRecipe, variance: float, step_s: float) -> ToneOscillator:
    ratio = tone.process_noise_density * step_s / variance
    if not (_SLOWEST < tone.frequency_hz * step_s < _QUICKEST and tone.bandwidth_hz * step_s < _WIDEST):
        raise RecipeError(
            f"The recipe has a tone at {tone.frequency_hz:.6g} Hz, {tone.bandwidth_hz:.6g} Hz wide, which"
            f" a rate of {1 / step_s:.6g} Hz cannot resolve; remove it, or tune a recipe on this recording."
        )
    if not _LEAST_RATIO < ratio < _GREATEST_RATIO:
        raise RecipeError(
            f"The tone at {tone.frequency_hz:.6g} Hz with process_noise_density = {tone.process_noise_density:.3g}"
            f" and noise_std = {np.sqrt(variance):.3g} does not make a valid filter at {1 / step_s:.6g} Hz; correct the"
            " recipe."
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
            f"The recipe's coloured noise was identified at {noise.rate_hz:.6g} Hz and is not valid at"
            f" {1 / step_s:.6g} Hz;"
            " tune a recipe on this recording."
        )
    return ColouredNoise(noise.coefficients, noise.std**2)
