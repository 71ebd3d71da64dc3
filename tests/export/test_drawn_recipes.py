"""Recipes drawn at random, exported, compiled, and held against becalm's stream."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, assume, example, given, settings
from hypothesis import strategies as st

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import ColouredNoiseRecipe, GateRecipe, ToneRecipe
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.core.arrays import Codes, Floats
from becalm.errors import ModelError, RecipeError
from becalm.export.bundle import Exported
from becalm.export.channel.kind import WholeChannel
from becalm.export.number_type import Precision
from becalm.export.vectors import STARTING
from driven import driven_one
from exported import bundle, channel, recipe_of

ROWS = 4000  # after those that tell the state
UNHURRIED = (HealthCheck.function_scoped_fixture, HealthCheck.too_slow)
SAME = {"float64": 1e-12, "float32": 1e-8}  # of the largest signal; a table of gains in float32 ends earlier
OTHER_UNITS = (1 + 1e-9, 1 + 3e-9, 1 + 7e-9)
NO_SHRINKING = (Phase.explicit, Phase.reuse, Phase.generate)  # each try compiles
SLOW_HUM = ToneRecipe(
    frequency_hz=0.02094257096101799,
    bandwidth_hz=0.001074799899655528,
    process_noise_density=1.1094946590724816e-17,
    disturbance=True,
)
HARDLY_TOLD = ChannelRecipe(
    name="ax",
    model="motion",
    order=2,
    process_noise_density=6.873787762994395e-17,
    noise_std=4.107693769787251e-9,
    tone=(SLOW_HUM,),
)
"""Four readings tell one of its states to 2600 noises only: the last digits of its first factors show at 1e-12."""

LONG_HOLE = ChannelRecipe(
    name="ax",
    model="motion",
    order=4,
    process_noise_density=1.0568046181477093e-10,
    noise_std=0.004051323581546961,
    damped_below_hz=0.0003191627646960998,
    coloured_noise=ColouredNoiseRecipe(rate_hz=0.40619619946087265, coefficients=(0.6,), std=0.008102687676329738),
    tone=(
        ToneRecipe(
            frequency_hz=0.18278828975739267,
            bandwidth_hz=0.0004061961994608727,
            process_noise_density=7.970664622337066e-07,
            disturbance=True,
        ),
    ),
    gate=GateRecipe(),
)
"""Forty predictions make 2200 of the last digits of its gain."""

WIDE_START = ChannelRecipe(
    name="ax",
    model="motion",
    order=5,
    process_noise_density=1.345028563057893e-08,
    noise_std=1.0,
    damped_below_hz=0.0002598323865731019,
    tone=(
        ToneRecipe(
            frequency_hz=0.08573327856068487,
            bandwidth_hz=0.003988396023595775,
            process_noise_density=7.565247043504467e-05,
            disturbance=True,
        ),
        ToneRecipe(
            frequency_hz=0.16265471527643555,
            bandwidth_hz=0.012942083160391221,
            process_noise_density=0.030808758485293696,
            disturbance=True,
        ),
    ),
)
"""Its first signal has a sigma of 17 noises: information that is inverted at each row keeps nine digits of it."""


@st.composite
def recipes(draw: st.DrawFn) -> tuple[ChannelRecipe, float]:
    """Draw a channel, its q/r over 12 decades, and its rate."""
    rate_hz = 10.0 ** draw(st.floats(-1, 5))
    order = draw(st.integers(1, 5))
    ratio = 10.0 ** draw(st.floats(-10, 2))  # q/r a step
    noise = 10.0 ** draw(st.floats(-9, 6))
    tones = tuple(
        ToneRecipe(
            frequency_hz=rate_hz * draw(st.floats(0.02, 0.45)),
            bandwidth_hz=rate_hz * 10.0 ** draw(st.floats(-4, -1.5)),
            process_noise_density=rate_hz * noise**2 * 10.0 ** draw(st.floats(-5, 0)),
            disturbance=draw(st.booleans()),
        )
        for _ in range(draw(st.integers(0, 2)))
    )
    apart = [one.frequency_hz for one in tones]
    assume(len(apart) < 2 or abs(apart[0] - apart[1]) > 0.02 * rate_hz)
    coloured = draw(st.sampled_from([None, (0.6,), (0.5, -0.3)]))
    damped = draw(st.sampled_from([None, 0.01, 0.3]))  # of the cut-off
    more = {
        "damped_below_hz": damped and damped * ratio ** (1 / (2 * order)) * rate_hz / (2 * np.pi),
        "tone": tones,
        "gate": draw(st.sampled_from([None, GateRecipe()])),
        "coloured_noise": coloured
        and ColouredNoiseRecipe(rate_hz=rate_hz, coefficients=coloured, std=noise * draw(st.floats(0.1, 3.0))),
    }
    made = channel("ax", order, ratio ** (1 / (2 * order)), rate_hz, noise_std=noise, **more)
    return made, rate_hz


def readings_for(one: Exported, told: ChannelRecipe, seed: int) -> Floats:
    """Return readings (N,) that move slowly; where holes are bridged they come long after the state was told."""
    assert told.noise_std is not None
    first = len(one.design.opening.weights)
    rng, rows = np.random.default_rng(seed), first + ROWS
    z = 20 * np.sin(np.arange(rows) / 300) + np.cumsum(rng.normal(0, 0.05, rows)) + rng.normal(size=rows)
    if one.kind.has_covariance:
        z[first + 1500 :][rng.random(rows - first - 1500) < 0.02] = np.nan
        z[first + 2500 : first + 2540] = np.nan
    return z * told.noise_std


def wanted(one: Exported, told: ChannelRecipe, given_it: Floats) -> tuple[Floats, Codes]:
    """Return what C is specified to tell of readings (N,)."""
    return one.kind.reference(told, one.design, one.written).run(given_it)


def told_by_becalm(told: ChannelRecipe, rate_hz: float, readings: Floats) -> tuple[Floats, Codes]:
    """Return what its stream makes of readings (N,): signal and verdicts."""
    stream = StreamCleaner(recipe_of(told, rate_hz=rate_hz), 1 / rate_hz)
    found = stream.push(readings[:, np.newaxis], np.ones(len(readings)))
    return found.signal[:, 0], found.verdicts[:, 0]


def in_unit(told: ChannelRecipe, unit: float) -> ChannelRecipe:
    """Return the same channel in a unit that is so many times smaller."""
    assert told.process_noise_density is not None
    assert told.noise_std is not None
    noise, density = told.coloured_noise, unit**2
    tones = [one.model_copy(update={"process_noise_density": one.process_noise_density * density}) for one in told.tone]
    more = {
        "process_noise_density": told.process_noise_density * density,
        "noise_std": told.noise_std * unit,
        "tone": tuple(tones),
        "coloured_noise": noise and noise.model_copy(update={"std": noise.std * unit}),
    }
    return told.model_copy(update=more)


def check_is_becalm(one: Exported, told: ChannelRecipe, given_it: Floats, want: Floats, became: Codes) -> None:
    """Check that a specification has not wandered off: its decisions are becalm's, and its signal but for rounding.

    Where the first readings hardly tell the state, becalm rounds away up to the eighth digit. How much shows in units
    that differ by a billionth: all last digits are then others, and nothing else.
    """
    rate_hz, known = 1 / one.design.step_s, became != STARTING
    signal, verdicts = told_by_becalm(told, rate_hz, given_it)
    np.testing.assert_array_equal(became[known], verdicts[known])
    if isinstance(one.kind, WholeChannel):
        np.testing.assert_array_equal(want[known], signal[known])
        return
    others = [told_by_becalm(in_unit(told, unit), rate_hz, given_it * unit)[0] / unit for unit in OTHER_UNITS]
    rounded = max(np.abs(other - signal)[known].max() for other in others)
    off = np.abs(want - signal)[known]
    assert (off <= SAME[one.kind.number.precision] * np.abs(want[known]).max() + 4 * rounded).all()


@pytest.mark.slow
@settings(
    max_examples=25,
    phases=NO_SHRINKING,
    suppress_health_check=UNHURRIED,
)
@example((HARDLY_TOLD, 1.0471285480508996), 4, "float64")
@example((LONG_HOLE, 0.40619619946087265), 67, "float64")
@example((WIDE_START, 1.0), 95, "float64")
@given(recipes(), st.integers(0, 99), st.sampled_from(["float64", "float32"]))
def test_any_recipe_exports_and_agrees(
    tmp_path: Path, drawn: tuple[ChannelRecipe, float], seed: int, precision: Precision
) -> None:
    """C is its specification, to the last digits it has, and that is becalm, to the last digits that becalm has."""
    told, rate_hz = drawn
    try:
        StreamCleaner(recipe_of(told, rate_hz=rate_hz), 1 / rate_hz)
        made = bundle(told, rate_hz=rate_hz, precision=precision)
    except (RecipeError, ModelError):  # float would cost too much; thousands of readings do not tell a state
        assume(False)
    (one,) = made.channels
    readings = readings_for(one, told, seed)
    held = driven_one(made, tmp_path, "-O0")
    signal, codes = held.run(readings)
    given_it = held.rounded(readings)
    want, became = wanted(one, told, given_it)
    np.testing.assert_array_equal(codes, became)
    if one.written.exact:
        check_is_becalm(one, told, given_it, want, became)
    else:  # a thinned start is its own
        assert precision == "float32"
    assert np.isfinite(signal).all()
    known = codes != STARTING
    assert known.sum() > ROWS // 2
    if isinstance(one.kind, WholeChannel):
        np.testing.assert_array_equal(signal, want.astype(one.kind.number.dtype))
    elif precision == "float64":
        assert np.abs(signal - want)[known].max() <= 1e-12 * np.abs(want[known]).max()
    else:
        level = one.written.word.noise if one.written.word and one.design.component.returns else 0.0
        off = np.sqrt(np.mean((signal - want)[known] ** 2))
        assert off <= max(1e-6 * np.sqrt(np.mean(want[known] ** 2)), level)
