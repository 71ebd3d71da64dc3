"""Records and recipes of every kind, for the tuner's tests."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import (
    CalibrationRecipe,
    ColouredNoiseRecipe,
    GateRecipe,
    HoleRecipe,
    LimitsRecipe,
    ModeRecipe,
    SwitchingRecipe,
    TimingRecipe,
    ToneRecipe,
)
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.core.time.timebase import Timebase

ROWS, RATE_HZ = 30_000, 1000.0


class Case(NamedTuple):
    """A record and what to do with it."""

    recording: Recording
    recipe: Recipe


def motion(**more: Any) -> ChannelRecipe:
    return ChannelRecipe.model_validate({"name": "ax", "model": "motion", "order": 1, "noise_std": 0.5} | more)


def recipe_of(channel: ChannelRecipe, mode: str = "smoothed", lag_s: float | None = None) -> Recipe:
    return Recipe.model_validate(
        {"mode": mode, "lag_s": lag_s, "tuned_on": Origin(rate_hz=RATE_HZ), "channel": (channel,)}
    )


def walk(seed: int = 3, rows: int = ROWS) -> Floats:
    """A random walk with a wave on it, in white noise, far from 0."""
    rng = np.random.default_rng(seed)
    slow = np.cumsum(rng.normal(size=rows)) * 0.02 + np.sin(np.arange(rows) / 200.0)
    return np.asarray(100.0 + slow + 0.5 * rng.normal(size=rows))


def with_gaps(z: Floats) -> Floats:
    """Leave readings out: single ones, a few hundred, nine in ten over a while, and at both ends."""
    z, rng = z.copy(), np.random.default_rng(5)
    z[rng.random(len(z)) < 0.01] = np.nan
    z[:7] = z[-9:] = z[12_000:12_400] = np.nan
    z[16_000:20_000][rng.random(4000) < 0.9] = np.nan
    return z


def with_spikes(z: Floats) -> Floats:
    """Put in spikes, alone and two in a row, and a step."""
    z = z.copy()
    z[[500, 9_000, 9_001, 15_000, 15_300, 29_990]] += 40.0
    z[22_000:] += 12.0
    return z


def even(z: Floats) -> Recording:
    return Recording(z, names=["ax"], rate_hz=RATE_HZ)


def stepped(z: Floats, elapsed: Floats) -> Recording:
    """Put readings at times of their own; what is before the first row is no time."""
    elapsed = elapsed.copy()
    elapsed[0] = 0.0
    uniform = bool(np.array_equal(elapsed, np.round(elapsed)))
    return Recording(z, names=["ax"], timebase=Timebase(elapsed, 1 / RATE_HZ, uniform=uniform))


def uneven(z: Floats) -> Recording:
    rng = np.random.default_rng(7)
    elapsed = np.round(rng.uniform(0.3, 1.7, len(z)), 3)
    elapsed[4_000] = elapsed[25_000] = 0.0
    elapsed[14_000] = 900.0
    return stepped(z, elapsed)


def parted(z: Floats) -> Recording:
    """Leave out rows, so many at one place that no motion is carried across."""
    elapsed = np.ones(len(z))
    elapsed[[3_000, 11_000]] = 50.0, 700.0
    elapsed[21_000] = 1e9
    return stepped(z, elapsed)


TONES = (
    ToneRecipe(frequency_hz=50.0, bandwidth_hz=0.5, process_noise_density=0.05),
    ToneRecipe(frequency_hz=120.0, bandwidth_hz=1.0, process_noise_density=0.02, disturbance=True),
)
SWITCHING = SwitchingRecipe(
    kind="resting",
    mode=(
        ModeRecipe(name="still", order=1, process_noise_density=1e-3, noise_std=0.5, lasts_s=0.5),
        ModeRecipe(name="moving", order=2, process_noise_density=500.0, noise_std=0.5, lasts_s=0.5),
    ),
)
COLOURED = ColouredNoiseRecipe(rate_hz=RATE_HZ, coefficients=(0.6, 0.1), std=0.2)
LIMITS = LimitsRecipe(low=95.0, high=103.0, resolution=1e-6, stuck_readings=4, even_time=True)
GATE = GateRecipe()


def cases() -> dict[str, Case]:
    """Every kind of recipe, on even and uneven time, with and without gaps."""
    z, one, two = walk(), motion(process_noise_density=0.3), motion(order=2, process_noise_density=300.0)
    stuck = z.copy()
    stuck[7_000:7_200], stuck[100] = stuck[7_000], np.inf
    calibrated = CalibrationRecipe(relative_std=0.01, offset_std=0.2)
    timing = TimingRecipe(std_s=2e-4, included_std=0.01)
    gated, toned = two.model_copy(update={"gate": GATE}), two.model_copy(update={"tone": TONES})
    spikes, begun = with_spikes(with_gaps(z)), with_gaps(z)
    begun[:60] = z[:60]  # a smoother of many states tells a start with holes to a few digits only
    corrections = tuple(
        HoleRecipe(readings=count, model_fading=fading, sigma_growth=0.3)
        for count, fading in ((8, 0.1), (40, 0.4), (200, 0.9))
    )
    unknown = {"spread_std": 1.5}
    wider = one.model_copy(update={"tuning_spread": 0.1, "calibration": calibrated, "timing": timing})
    return {
        "order 1": Case(even(z), recipe_of(one)),
        "order 2": Case(even(z), recipe_of(two)),
        "order 3, causal": Case(even(z), recipe_of(motion(order=3, process_noise_density=3e5), "causal")),
        "order 3, slow": Case(even(z), recipe_of(motion(order=3, process_noise_density=3.0))),
        "order 5": Case(even(z), recipe_of(motion(order=5, process_noise_density=1e13))),
        "lagged": Case(even(with_gaps(z)), recipe_of(two, "lagged", 0.02)),
        "never forgets": Case(even(z), recipe_of(motion(process_noise_density=0.0))),
        "gaps": Case(even(with_gaps(z)), recipe_of(two)),
        "gaps, causal": Case(even(with_gaps(z)), recipe_of(two, "causal")),
        "gaps, order 4": Case(even(begun), recipe_of(motion(order=4, process_noise_density=3e9))),
        "uneven": Case(uneven(with_gaps(z)), recipe_of(two)),
        "uneven, causal": Case(uneven(z), recipe_of(one, "causal")),
        "parted": Case(parted(z), recipe_of(two)),
        "parted, causal": Case(parted(with_gaps(z)), recipe_of(two, "causal")),
        "gated": Case(even(spikes), recipe_of(gated)),
        "gated, causal": Case(even(spikes), recipe_of(gated, "causal")),
        "gated, lagged": Case(even(spikes), recipe_of(gated, "lagged", 0.05)),
        "tones": Case(even(begun), recipe_of(toned)),
        "tones, causal": Case(even(z), recipe_of(toned, "causal")),
        "coloured": Case(even(z), recipe_of(one.model_copy(update={"coloured_noise": COLOURED}))),
        "limits": Case(even(stuck), recipe_of(gated.model_copy(update={"limits": LIMITS}))),
        "holes": Case(even(with_gaps(z)), recipe_of(two.model_copy(update={"hole": corrections}))),
        "unknown in holes": Case(
            even(with_gaps(z)), recipe_of(two.model_copy(update={"hole": corrections, **unknown}))
        ),
        "unknown in holes, causal": Case(even(with_gaps(z)), recipe_of(two.model_copy(update=unknown), "causal")),
        "wider": Case(uneven(z), recipe_of(wider)),
        "switching": Case(even(with_gaps(z)), recipe_of(one.model_copy(update={"switching": SWITCHING}))),
        "switching, causal": Case(even(z), recipe_of(one.model_copy(update={"switching": SWITCHING}), "causal")),
        "switching, lagged": Case(even(z), recipe_of(one.model_copy(update={"switching": SWITCHING}), "lagged", 0.02)),
    }
