"""Recipes drawn at random, exported, compiled, and held against becalm's stream."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st

from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import ColouredNoiseRecipe, GateRecipe, ToneRecipe
from becalm.cleaning.stream import StreamCleaner
from becalm.core.arrays import Floats
from becalm.errors import RecipeError
from becalm.export.number_type import Precision
from becalm.export.vectors import STARTING
from exported import built, bundle, channel, live, recipe_of, snr_db, through

ROWS = 4000
UNHURRIED = (HealthCheck.function_scoped_fixture, HealthCheck.too_slow)
NO_SHRINKING = (Phase.explicit, Phase.reuse, Phase.generate)  # each try compiles


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
    more = {
        "tone": tones,
        "gate": draw(st.sampled_from([None, GateRecipe()])),
        "coloured_noise": coloured
        and ColouredNoiseRecipe(rate_hz=rate_hz, coefficients=coloured, std=noise * draw(st.floats(0.1, 3.0))),
    }
    made = channel("ax", order, ratio ** (1 / (2 * order)), rate_hz, noise_std=noise, **more)
    return made, rate_hz


def readings_for(told: ChannelRecipe, seed: int, holes: bool) -> Floats:
    """Return readings (N,) that move slowly, with holes after their start where asked."""
    assert told.noise_std is not None
    rng, k = np.random.default_rng(seed), np.arange(ROWS)
    z = 20 * np.sin(k / 300) + np.cumsum(rng.normal(0, 0.05, ROWS)) + rng.normal(size=ROWS)
    if holes:
        z[1500:][rng.random(ROWS - 1500) < 0.02] = np.nan
        z[2500:2540] = np.nan
    return z * told.noise_std


@pytest.mark.slow
@settings(
    max_examples=40,
    phases=NO_SHRINKING,
    suppress_health_check=UNHURRIED,
)
@given(recipes(), st.integers(0, 99), st.sampled_from(["float64", "float32"]))
def test_any_recipe_exports_and_agrees(
    tmp_path: Path, drawn: tuple[ChannelRecipe, float], seed: int, precision: Precision
) -> None:
    told, rate_hz = drawn
    try:
        StreamCleaner(recipe_of(told, rate_hz=rate_hz), 1 / rate_hz)
        made = bundle(told, rate_hz=rate_hz, precision=precision)
    except RecipeError:
        assume(False)
    (one,) = made.channels
    readings = readings_for(told, seed, holes=one.kind.bridges)
    signal, codes = through(built(made, tmp_path), one, readings)
    want = live(one, told, readings)
    if not one.written.exact:  # a thinned start is held against its own specification
        assert precision == "float32"
        given_it = one.kind.in_unit(one.kind.raw(readings, one.written), one.written)
        want = one.kind.reference(told, one.design, one.written).run(given_it)[0]
    assert np.isfinite(signal).all()
    known = (codes != STARTING) & np.isfinite(want)
    assert known.sum() > ROWS // 2
    if precision == "float64":
        assert np.abs(signal - want)[known].max() <= 1e-12 * np.abs(want[known]).max()
    else:
        assert snr_db(signal[known], want[known]) >= 120
