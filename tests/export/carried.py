"""Filters that are the library's own channel: recipes that try them, and what becalm makes of their readings."""

from __future__ import annotations

import numpy as np

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import ColouredNoiseRecipe, GateRecipe
from becalm.core.arrays import Codes, Floats
from becalm.core.model.autoregressive import from_partial_autocorrelations
from becalm.export.number_type import DOUBLE, FLOAT
from becalm.export.vectors import Reference
from driven import Driven
from exported import HUM, LIMITS, TONE, channel

STEP_S = 0.01
GATE = GateRecipe()
NARROW_HUM = HUM.model_copy(update={"frequency_hz": 20.0})
PHI = from_partial_autocorrelations((0.8, 0.1, 0.05))
COLOURED = ColouredNoiseRecipe(rate_hz=100.0, coefficients=PHI, std=2.0)
CHANNELS = {
    "level": channel("level", 1, 0.2),
    "slope": channel("slope", 2, 0.05),
    "bend": channel("bend", 3, 0.05),
    "jerk": channel("jerk", 4, 0.1),
    "snap": channel("snap", 5, 0.3),
    "slow": channel("slow", 2, 1e-3),
    "never": channel("never", 2, 0.0),
    "hum": channel("hum", 1, 0.05, tone=(NARROW_HUM,)),
    "returning": channel("returning", 2, 0.05, damped_below_hz=0.1),
    "coloured": channel("coloured", 2, 0.05, coloured_noise=COLOURED),
    "railed": channel("railed", 2, 0.05, limits=LIMITS),
    "small": channel("small", 2, 0.05, noise_std=1e-9),
    "large": channel("large", 2, 0.05, noise_std=1e9),
}
BOTH = {**CHANNELS, **{f"gated {name}": told.model_copy(update={"gate": GATE}) for name, told in CHANNELS.items()}}
HARD = {
    "tone": channel("tone", 2, 0.05, tone=(TONE,)),
    "slow tone": channel("tone", 2, 0.05, tone=(TONE.model_copy(update={"frequency_hz": 0.5}),)),
    "snap": channel("snap", 5, 1e-3),
}
"""Whose covariance keeps few digits."""

NUMBERS = {"float64": DOUBLE, "float32": FLOAT}
USUAL = ("level", "slope", "gated bend", "gated snap", "gated never", "gated hum", "gated coloured", "gated railed")


def reference_of(told: ChannelRecipe, held: Driven) -> Reference:
    """Return what a filter is held against, at the start."""
    return held.one.kind.reference(told, held.one.design, held.one.written)


def expected(told: ChannelRecipe, held: Driven, readings: Floats) -> tuple[Floats, Codes]:
    """Return what becalm makes of readings (N,) that C is given."""
    return reference_of(told, held).run(held.rounded(readings))


def rough(told: ChannelRecipe, rows: int = 3000, seed: int = 1) -> Floats:
    """Return readings (N,) with noise, spikes, steps, and holes of all lengths up to 80."""
    rng, std = np.random.default_rng(seed), told.noise_std or 1.0
    z = 12 * np.sin(np.arange(rows) / 40) + rng.normal(size=rows)
    for row in rng.integers(100, rows - 100, 5).tolist():
        z[row:] += rng.normal() * 20
        z[row + 50 : row + 50 + int(rng.integers(2, 80))] = np.nan
    spikes = rng.random(rows) < 0.01
    z[spikes] += rng.normal(size=spikes.sum()) * 200
    z[rng.random(rows) < 0.02] = np.nan
    return np.asarray(std * z, np.float64)
