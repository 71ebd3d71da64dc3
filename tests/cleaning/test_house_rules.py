"""House rules of `clean`, with no private exceptions: shape, truth to the input, shift, scale, holes, order, bits."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.classic.causal import butterworth, moving_average
from becalm.cleaning.channels.channels import CausalChannelCleaner, MotionChannel
from becalm.cleaning.pipeline import Cleaned, clean
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.tuning import tune
from becalm.core.arrays import Floats
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import motion, returning_motion
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording
from becalm.core.rows import EstimatedRows
from becalm.errors import RecipeError, RecordingError

ROWS = 800
NAMES = ("ax", "strain", "constant", "gyro")
UNITS = ("m/s^2", "um/m", "V", "deg/s")


def samples() -> Floats:
    rng = np.random.default_rng(7)
    t = np.arange(ROWS) / 100
    slow = np.cumsum(rng.normal(size=ROWS)) * 0.05 + 0.3 * rng.normal(size=ROWS)
    wave = np.sin(3 * t) + 0.1 * rng.normal(size=ROWS)
    ramp = 5 * t + rng.normal(size=ROWS)
    return np.column_stack([slow, wave, np.full(ROWS, 2.5), ramp])


Z = samples()
MODES = [pytest.param(True, id="causal"), pytest.param(False, id="smoothed")]
RECIPES = {causal: tune(Recording(Z, names=NAMES, units=UNITS, rate_hz=100), causal=causal) for causal in (True, False)}


def without_limits(recipe: Recipe) -> Recipe:
    """Return a recipe without what a channel keeps to, which is told in its unit and from its zero."""
    channels = tuple(channel.model_copy(update={"limits": None}) for channel in recipe.channel)
    return recipe.model_copy(update={"channel": channels})


def record(z: Floats, names: tuple[str, ...] = NAMES, units: tuple[str, ...] = UNITS) -> Recording:
    return Recording(z, names=names, units=units, rate_hz=100)


def same_bytes(one: Cleaned, other: Cleaned) -> bool:
    pairs = ((one.signal.samples, other.signal.samples), (one.sigma.samples, other.sigma.samples))
    return all(a.tobytes() == b.tobytes() for a, b in pairs)


@cache
def cleaned(causal: bool) -> Cleaned:
    """Clean as it is, tuned anew."""
    return clean(record(Z), causal=causal)


@pytest.mark.parametrize("causal", MODES)
def test_what_comes_out_has_the_shape_names_units_and_times_of_what_went_in(causal: bool) -> None:
    given_record = record(Z)
    out = clean(given_record, causal=causal)
    for part in (out.signal, out.sigma):
        assert part.samples.shape == Z.shape
        assert (part.names, part.units) == (NAMES, UNITS)
        assert part.timebase is given_record.timebase
    started = 2 if causal else 0  # a filter has no past to judge its first readings by
    assert np.isfinite(out.signal.samples[started:]).all()
    assert [report.name for report in out.reports] == list(NAMES)
    assert out.recipe.mode == ("causal" if causal else "smoothed")


@pytest.mark.parametrize("causal", MODES)
def test_the_input_stays_as_it_is(causal: bool) -> None:
    z = Z.copy()
    z[5, 0], z[9, 1] = np.nan, np.inf
    before, given_record = z.copy(), record(z)
    clean(given_record, causal=causal)
    assert np.array_equal(z, before, equal_nan=True)
    assert np.array_equal(given_record.samples, before, equal_nan=True)
    assert z.flags.writeable


@pytest.mark.parametrize("causal", MODES)
def test_cleaning_twice_gives_identical_bytes(causal: bool) -> None:
    recipe = RECIPES[causal]
    assert same_bytes(clean(record(Z), recipe), clean(record(Z), recipe))
    assert same_bytes(cleaned(causal), clean(record(Z), recipe))
    assert tune(record(Z), causal=causal).to_toml() == recipe.to_toml()


@pytest.mark.parametrize("causal", MODES)
def test_a_recipe_from_its_text_gives_identical_bytes(causal: bool) -> None:
    recipe = RECIPES[causal]
    assert same_bytes(clean(record(Z), Recipe.from_toml(recipe.to_toml())), clean(record(Z), recipe))


@given(shift=st.floats(-1000, 1000), causal=st.booleans())
@settings(max_examples=12)
def test_an_offset_in_is_an_offset_out(shift: float, causal: bool) -> None:
    recipe = without_limits(RECIPES[causal])
    out, shifted = clean(record(Z), recipe), clean(record(Z + shift), recipe)
    np.testing.assert_allclose(shifted.signal.samples, out.signal.samples + shift, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(shifted.sigma.samples, out.sigma.samples)


@given(power=st.integers(-30, 30), sign=st.sampled_from([-1.0, 1.0]), causal=st.booleans())
@settings(max_examples=12)
def test_another_unit_in_is_another_unit_out(power: int, sign: float, causal: bool) -> None:
    factor = sign * 2.0**power
    recipe = without_limits(RECIPES[causal])
    channels = tuple(
        channel.model_copy(
            update={
                "noise_std": channel.noise_std * abs(factor),
                "process_noise_density": channel.process_noise_density * factor**2,
                "spread_std": None,
            }
        )
        if channel.noise_std is not None and channel.process_noise_density is not None
        else channel
        for channel in recipe.channel
    )
    out, scaled = clean(record(Z), recipe), clean(record(factor * Z), recipe.model_copy(update={"channel": channels}))
    size = np.nanmax(np.abs(out.signal.samples))
    np.testing.assert_allclose(scaled.signal.samples / factor, out.signal.samples, rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(scaled.sigma.samples / abs(factor), out.sigma.samples, rtol=1e-12)


@pytest.mark.parametrize("causal", MODES)
def test_tuning_too_follows_the_unit_and_not_the_offset(causal: bool) -> None:
    out, other = cleaned(causal), clean(record(1000 * Z + 50), causal=causal)
    for one, two in zip(out.recipe.channel, other.recipe.channel, strict=True):
        assert (one.model, one.order) == (two.model, two.order)
        if one.noise_std is not None:
            assert two.noise_std == pytest.approx(1000 * one.noise_std, rel=1e-3)


@given(row=st.integers(0, ROWS - 1), causal=st.booleans(), value=st.sampled_from([np.nan, np.inf, -np.inf, 1e101]))
@settings(max_examples=20)
def test_one_hole_stays_one_hole(row: int, causal: bool, value: float) -> None:
    """Beside the first readings of a causal run, which have no past, every sample is told."""
    z = Z.copy()
    z[row, 1] = value
    out = clean(record(z), RECIPES[causal])
    signal, sigma = out.signal.samples, out.sigma.samples
    started = row + 1 if causal and row < 3 else 0
    moving = [0, 1, 3]
    assert np.isfinite(signal[started:, moving]).all()
    assert (sigma[started:, moving] > 0).all()
    whole = clean(record(Z), RECIPES[causal])
    assert np.array_equal(signal[:, [0, 2, 3]], whole.signal.samples[:, [0, 2, 3]], equal_nan=True)
    assert sigma[row, 1] > whole.sigma.samples[row, 1]
    if causal:
        np.testing.assert_allclose(signal[:row, 1], whole.signal.samples[:row, 1], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("order", [(3, 2, 1, 0), (1, 2, 0, 3)])
@pytest.mark.parametrize("causal", MODES)
def test_the_order_of_channels_does_not_matter(causal: bool, order: tuple[int, ...]) -> None:
    names, units = tuple(NAMES[i] for i in order), tuple(UNITS[i] for i in order)
    out, turned = cleaned(causal), clean(record(Z[:, order], names, units), causal=causal)
    assert turned.signal.names == names
    assert turned.signal.samples.tobytes() == np.ascontiguousarray(out.signal.samples[:, order]).tobytes()
    assert turned.sigma.samples.tobytes() == np.ascontiguousarray(out.sigma.samples[:, order]).tobytes()
    assert turned.recipe.channel == tuple(out.recipe.channel[i] for i in order)


@pytest.mark.parametrize("causal", MODES)
def test_one_channel_alone_comes_out_as_among_others(causal: bool) -> None:
    out = cleaned(causal)
    for name in NAMES:
        alone = clean(record(Z), causal=causal, channels=[name])
        assert np.array_equal(alone.signal.samples[:, 0], out.signal.channel(name), equal_nan=True)
    assert clean(record(Z), causal=causal, channels="gyro").signal.names == ("gyro",)


def test_a_causal_estimate_does_not_know_the_future() -> None:
    changed = Z.copy()
    changed[400:] += 100.0
    out, other = (clean(record(z), RECIPES[True]) for z in (Z, changed))
    np.testing.assert_allclose(out.signal.samples[:400], other.signal.samples[:400], rtol=1e-12)  # a step ends a block
    ungated = tuple(channel.model_copy(update={"gate": None}) for channel in RECIPES[True].channel)
    believing = without_limits(RECIPES[True].model_copy(update={"channel": ungated}))
    out, other = (clean(record(z), believing) for z in (Z, changed))
    assert np.array_equal(out.signal.samples[:400], other.signal.samples[:400], equal_nan=True)
    smoothed = [clean(record(z), RECIPES[False]).signal.samples[399, 0] for z in (Z, changed)]
    assert smoothed[0] != smoothed[1]


@pytest.mark.parametrize("causal", MODES)
def test_a_constant_passes_with_no_uncertainty_told(causal: bool) -> None:
    out = cleaned(causal)
    assert np.array_equal(out.signal.channel("constant"), Z[:, 2])
    assert np.isnan(out.sigma.channel("constant")).all()
    assert out.reports[2].model == "constant"


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("rate", [0.5, 10_000.0])
def test_a_recipe_says_the_density_in_seconds(order: int, rate: float) -> None:
    """q is per second, not per sample: what made the record is found again, and the kernel given it agrees."""
    density, variance = 2.0 * (0.3 * rate) ** (2 * order) / rate, 2.0  # cut-off 0.3 radians a sample
    model = motion(order, density).to_model(1 / rate, variance)
    w = np.linalg.cholesky(model.Q) @ np.random.default_rng(order).normal(size=(order, 4000))
    x, z = np.zeros(order), np.empty(4000)
    for k in range(4000):
        z[k], x = x[0], model.F @ x + w[:, k]
    z += np.sqrt(variance) * np.random.default_rng(order + 10).normal(size=4000)
    out = clean(Recording(z, rate_hz=rate))
    z[out.verdicts["channel_0"] == Verdict.SPIKE] = np.nan  # one false alarm an hour is asked for
    found = out.recipe.channel[0]
    assert found.order == order
    assert found.process_noise_density == pytest.approx(density, rel=0.5)
    assert found.noise_std == pytest.approx(np.sqrt(variance), rel=0.05)
    assert found.process_noise_density is not None
    assert found.noise_std is not None
    component, size = motion(order, found.process_noise_density), np.nanmax(np.abs(z))
    atol, rtol = 1e-9 * size, 1e-8
    if found.damped_below_hz is not None:
        component = returning_motion(order, found.process_noise_density, 2 * np.pi * found.damped_below_hz)
        atol, rtol = max(atol, 0.01 * np.sqrt(variance)), 1e-4  # digits that a start from next to nothing costs
    expected = kalman_smoother(component.to_model(1 / rate, found.noise_std**2), z)
    np.testing.assert_allclose(out.signal.samples, expected.signal, rtol=0, atol=atol)
    np.testing.assert_allclose(out.sigma.samples, (1 + found.tuning_spread) * expected.sigma, rtol=rtol)


def test_progress_names_every_channel() -> None:
    told: list[str] = []
    tune(record(Z), progress=told.append)
    assert sorted(told) == sorted(NAMES)


@pytest.mark.parametrize("causal", MODES)
def test_every_channel_is_finished_before_it_reports(causal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    kind: Any = CausalChannelCleaner if causal else MotionChannel
    finished: list[Any] = []
    finish, report = kind.finish, kind.report

    def finish_and_tell(channel: Any) -> list[EstimatedRows]:
        finished.append(channel)
        told: list[EstimatedRows] = finish(channel)
        return told

    def report_once_finished(channel: Any) -> Any:
        assert channel in finished
        return report(channel)

    monkeypatch.setattr(kind, "finish", finish_and_tell)
    monkeypatch.setattr(kind, "report", report_once_finished)
    assert len(clean(record(Z), RECIPES[causal]).reports) == 4
    assert len(finished) == 3


def test_verdicts_count_every_reading() -> None:
    z = Z.copy()
    z[3, 0], z[4:6, 0], z[7, 0] = np.nan, np.inf, -1e200
    report = clean(record(z)).reports[0]
    counted = {word: count for word, count in report.verdicts.items() if count}
    assert counted == {"used": ROWS - 4, "missing": 1, "nonfinite": 2, "overrange": 1}


@pytest.mark.parametrize(
    ("names", "units", "says"),
    [
        (("ax", "strain", "constant", "other"), UNITS, "The recipe cleans 'gyro', but the recording has"),
        (NAMES, ("m/s^2", "um/m", "V", "rad/s"), "has 'gyro' in 'deg/s', the recording in 'rad/s'"),
        (NAMES, ("m/s^2", "um/m", "V", ""), "in 'no unit'"),
    ],
)
def test_a_recipe_for_another_recording_is_refused(names: tuple[str, ...], units: tuple[str, ...], says: str) -> None:
    with pytest.raises(RecipeError, match=says):
        clean(record(Z, names, units), RECIPES[False])


def test_channels_that_do_not_exist_are_refused() -> None:
    with pytest.raises(RecipeError, match="The recipe has no channel 'az'"):
        clean(record(Z), RECIPES[False], channels=["ax", "az"])
    with pytest.raises(RecordingError, match="There is no channel 'az'"):
        clean(record(Z), channels=["az"])
    with pytest.raises(RecordingError, match="No channel is left"):
        clean(record(Z), channels=[])
    with pytest.raises(RecordingError, match="has no samples"):
        clean(record(Z[:0]))


FILTERS: dict[str, Callable[[Floats], Floats]] = {
    "butterworth": lambda z: butterworth(z, 0.05, 4),
    "moving average": lambda z: moving_average(z, 20),
}


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("channel", range(4))
def test_the_competitors_keep_the_house_rules_too(name: str, channel: int) -> None:
    run, z = FILTERS[name], Z[:, channel].copy()
    out = run(z)
    assert out.shape == z.shape
    assert np.isfinite(out).all()
    assert np.array_equal(z, Z[:, channel])
    np.testing.assert_allclose(run(z + 10), out + 10, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run(4 * z), 4 * out, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(run(z[:500]), out[:500])
