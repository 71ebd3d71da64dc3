"""What tests of streams share: recipes of every kind, rough records, and streams that are cut."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import (
    CalibrationRecipe,
    ColouredNoiseRecipe,
    GateRecipe,
    LimitsRecipe,
    ModeRecipe,
    SwitchingRecipe,
    TimingRecipe,
    ToneRecipe,
)
from becalm.cleaning.streaming.stream import StreamCleaner, Streamed
from becalm.core.arrays import Floats

RATE_HZ = 100.0
TONE = ToneRecipe(frequency_hz=7.0, bandwidth_hz=0.2, process_noise_density=0.5)
HUM = ToneRecipe(frequency_hz=17.0, bandwidth_hz=0.1, process_noise_density=0.2, disturbance=True)
LIMITS = LimitsRecipe(
    low=-60.0, high=60.0, resolution=0.5, rounding_std=0.1, stuck_readings=6, even_time=True, largest=1e6,
    outlier_distance=9.0, causal_outlier_distance=12.0, plausible_low=-30.0, plausible_high=30.0, repeats_are_one=True,
    blank=1.0, far_from_0=0.5, drift_threshold=6.0, dead_variance=0.2,
)  # fmt: skip
QUIET = ModeRecipe(name="still", order=1, process_noise_density=0.01, noise_std=1.0, lasts_s=4.0)
MOVING = ModeRecipe(name="moving", order=2, process_noise_density=3e3, noise_std=1.1, lasts_s=1.0, wild_share=0.02)
MODES = SwitchingRecipe(kind="resting", wild_std=20.0, rejects=True, mode=(QUIET, MOVING))
JUMPING = ModeRecipe(
    name="jumping", order=2, process_noise_density=10.0, noise_std=1.0, lasts_s=0.02, then="still",
    level_noise_density=1e4, with_tones=True,
)  # fmt: skip
CALIBRATION = CalibrationRecipe(relative_std=0.01, offset_std=0.3)
TIMING = TimingRecipe(std_s=0.001, included_std=0.1)
COLOURED = ColouredNoiseRecipe(rate_hz=RATE_HZ, coefficients=(0.6, 0.2), std=0.8)


def motion(order: int = 2, **beside: Any) -> ChannelRecipe:
    """Return a channel of a motion that is about as quick as the records are."""
    density = float((2 * np.pi * 2.0) ** (2 * order) / RATE_HZ)
    name = beside.pop("name", "a")
    return ChannelRecipe(name=name, model="motion", order=order, process_noise_density=density, noise_std=1.0, **beside)


KINDS: dict[str, ChannelRecipe] = {
    **{f"order {order}": motion(order) for order in (1, 2, 3, 4, 5)},
    "tone": motion(2, tone=(TONE,)),
    "disturbance": motion(2, tone=(TONE, HUM), limits=LIMITS),
    "coloured": motion(2, coloured_noise=COLOURED),
    "gate": motion(2, gate=GateRecipe()),
    "gate, order 1": motion(1, gate=GateRecipe(agree=3), tuning_spread=0.1),
    "gate and tone": motion(3, gate=GateRecipe(), tone=(TONE,), limits=LIMITS),
    "gate of no level": motion(1, gate=GateRecipe(false_alarms_per_hour=10.0), coloured_noise=COLOURED),
    "limits": motion(2, limits=LIMITS),
    "everything": motion(
        3, limits=LIMITS, gate=GateRecipe(), calibration=CALIBRATION, timing=TIMING, tuning_spread=0.07, tone=(HUM,)
    ),
    "calibration": motion(1, calibration=CALIBRATION, tuning_spread=0.2),
    "timing": motion(2, timing=TIMING, limits=LIMITS),
    "switching": motion(2, switching=MODES),
    "jumping": motion(2, switching=SwitchingRecipe(kind="jumping", mode=(QUIET, JUMPING)), tone=(TONE,)),
    "switching, everything": motion(
        2, switching=MODES, limits=LIMITS, calibration=CALIBRATION, timing=TIMING, tuning_spread=0.07
    ),
    "constant": ChannelRecipe(name="a", model="constant"),
    "untold": ChannelRecipe(name="a", model="untold", limits=LIMITS),
}

CAUSAL: dict[str, Any] = {"mode": "causal"}
LAGGED: dict[str, Any] = {"mode": "lagged", "lag_s": 0.09}


def recipe_of(*channels: ChannelRecipe, **how: Any) -> Recipe:
    """Return a recipe of channels, named one after the other."""
    named = tuple(channel.model_copy(update={"name": f"c{k}"}) for k, channel in enumerate(channels))
    return Recipe(tuned_on=Origin(rate_hz=RATE_HZ), channel=named, **(how or CAUSAL))


def wander(rows: int, seed: int = 1) -> Floats:
    """Return a wave in noise, far from zero."""
    rng = np.random.default_rng(seed)
    return 20.0 + 15.0 * np.sin(np.arange(rows) / 70) + rng.normal(size=rows)


def rough(rows: int, seed: int = 1) -> Floats:
    """Return a record with all that befalls readings."""
    rng, z = np.random.default_rng(seed + 100), wander(rows, seed)
    z[rng.random(rows) < 0.03] += 40.0  # spikes
    z[rng.random(rows) < 0.02] = np.nan
    z[rows // 5 : rows // 5 + 14] = z[rows // 5]  # held
    z[rows // 3 : rows // 3 + 5] = 60.0  # at a rail
    z[rows // 2 :] += 12.0  # a step
    z[rows // 2 + 40 :] -= 27.0
    z[[rows // 4, rows // 4 + 9, rows // 4 + 20]] = np.inf, 1e300, -1e30
    z[3 * rows // 5 : 3 * rows // 5 + 30] = np.nan
    z[4 * rows // 5 :] = np.round(z[4 * rows // 5 :])
    return z


def uneven(rows: int, seed: int = 1, *, whole: bool = False) -> Floats:
    """Return steps: jitter, repeats, gaps, and one beyond any reach."""
    rng = np.random.default_rng(seed + 200)
    steps = np.where(rng.random(rows) < 0.3, rng.choice([0.25, 0.9, 1.1, 1.3, 2.0, 7.0], rows), 1.0)
    steps[rng.random(rows) < 0.02] = 0.0
    steps[rows // 2] = 400.0
    steps[2 * rows // 3] = 1e9
    steps[2 * rows // 3 + 3] = 3e8
    steps[0] = 0.0
    return np.asarray(np.round(steps) if whole else steps, dtype=np.float64)


def streamed(stream: StreamCleaner, values: Floats, elapsed: Floats, cuts: Sequence[int] = ()) -> Streamed:
    """Push rows in blocks; return all that is told of them."""
    told = [stream.push(values[rows], elapsed[rows]) for rows in np.split(np.arange(len(values)), list(cuts))]
    return joined([*told, stream.finish()])


def joined(parts: Sequence[Streamed]) -> Streamed:
    """Return rows one after the other."""
    return Streamed(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


def assert_same_numbers(got: Streamed, expected: Streamed) -> None:
    np.testing.assert_array_equal(got.verdicts, expected.verdicts)
    for channel in range(expected.signal.shape[1]):
        size = np.nanmax(np.abs(expected.signal[:, channel]), initial=0.0)
        np.testing.assert_allclose(got.signal[:, channel], expected.signal[:, channel], rtol=1e-12, atol=1e-12 * size)
        np.testing.assert_allclose(got.sigma[:, channel], expected.sigma[:, channel], rtol=1e-12)
