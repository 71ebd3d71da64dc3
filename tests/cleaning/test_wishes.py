"""What a person asks or knows: tones to take off, rest that tells the noise, the parts apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.recipes.recipe_parts import ToneRecipe
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.errors import RecipeError, RecordingError, UsageError
from becalm.identification.wishes.dial import Dial

ROWS, RATE_HZ = 12_000, 1000.0
REST_S = 4.0
TIME_S = np.arange(ROWS) / RATE_HZ
MOTION: Floats = np.where(TIME_S < REST_S, 0.0, np.sin(np.pi * (TIME_S - REST_S)) ** 2)


def rms(error: Floats) -> float:
    return float(np.sqrt(np.mean(error**2)))


@pytest.fixture(scope="module")
def humming() -> Recording:
    rng = np.random.default_rng(1)
    hum = 0.5 * np.sin(2 * np.pi * 50.02 * TIME_S + 1) + 0.1 * np.sin(2 * np.pi * 150 * TIME_S)
    quiet = MOTION + rng.normal(0, 0.2, ROWS)
    return Recording(np.column_stack([quiet + hum, quiet]), names=["hum", "quiet"], units=["N", "N"], rate_hz=RATE_HZ)


@pytest.fixture(scope="module")
def coloured() -> Recording:
    rng = np.random.default_rng(2)
    noise = lfilter([0.1], [1.0, -0.9], rng.normal(size=ROWS)) + rng.normal(0, 0.1, ROWS)
    return Recording(MOTION + noise, names=["force"], units=["N"], rate_hz=RATE_HZ)


@pytest.fixture(scope="module")
def rested(coloured: Recording) -> Recipe:
    return tune(coloured, wishes=Wishes(still_s=((0.0, REST_S),)))


@pytest.mark.parametrize("causal", [False, True])
def test_named_tones_are_taken_off(humming: Recording, causal: bool) -> None:
    recipe = tune(humming, causal=causal, wishes=Wishes(removed_hz=(50.0, 150.0)))
    out = clean(humming, Recipe.from_toml(recipe.to_toml()), split=True)
    hum, quiet = out.reports
    np.testing.assert_allclose(hum.removed_hz, [50.02, 150.0], atol=0.05)
    assert (hum.tones_hz, quiet.removed_hz) == ((), ())
    settled = slice(1000, None)
    error = rms((out.signal.channel("hum") - MOTION)[settled])
    assert error < 1.5 * rms((out.signal.channel("quiet") - MOTION)[settled])
    assert error < 0.1  # the hum alone is 0.36
    assert out.parts is not None
    assert out.parts.names[:2] == ("hum_motion", f"hum_tone_{hum.removed_hz[0]:.6g}Hz")
    np.testing.assert_allclose(out.parts.channel("hum_motion"), out.signal.channel("hum"), atol=1e-9)


def test_without_a_wish_tones_are_signal(humming: Recording) -> None:
    (report,) = tune(humming, channels=["hum"]).channel
    assert [tone.disturbance for tone in report.tone] == [False, False]


@pytest.mark.parametrize("causal", [False, True])
def test_noise_told_at_rest_is_taken_off_though_it_is_coloured(coloured: Recording, causal: bool) -> None:
    told = tune(coloured, causal=causal, wishes=Wishes(still_s=((0.0, REST_S),)))
    noise = told.channel[0].coloured_noise
    assert noise is not None
    assert noise.coefficients[0] == pytest.approx(0.9, abs=0.05)
    error = clean(coloured, told).signal.samples[500:, 0] - MOTION[500:]
    blind = clean(coloured, causal=causal).signal.samples[500:, 0] - MOTION[500:]
    assert rms(error) < 0.6 * rms(blind)


def test_rest_may_lie_in_another_recording(coloured: Recording, rested: Recipe) -> None:
    moving = Recording(coloured.samples[4000:], names=["force"], units=["N"], rate_hz=RATE_HZ)
    told = tune(moving, wishes=Wishes(still_s=((0.0, REST_S),), rest=coloured))
    assert told.channel[0].coloured_noise == rested.channel[0].coloured_noise


def test_coloured_noise_of_another_rate_is_refused(coloured: Recording, rested: Recipe) -> None:
    slower = Recording(coloured.samples, names=["force"], units=["N"], rate_hz=500.0)
    with pytest.raises(RecipeError, match=r"coloured noise was identified at 1000 Hz and is not valid at 500 Hz; tune"):
        clean(slower, rested)


def test_coloured_noise_that_grows_is_refused(coloured: Recording, rested: Recipe) -> None:
    text = rested.to_toml()
    (line,) = [line for line in text.splitlines() if line.startswith("coefficients")]
    with pytest.raises(RecipeError, match="coloured noise does not make a valid filter: coefficients"):
        clean(coloured, Recipe.from_toml(text.replace(line, "coefficients = [1.5]")))


WRONG = {
    "a dial beside it": (Wishes(Dial("bandwidth_hz", 5.0), removed_hz=(50.0,)), "ask for one at a time"),
    "beyond half of the rate": (Wishes(removed_hz=(600.0,)), "Tones to remove must be between 0 and 500 Hz"),
    "too many": (Wishes(removed_hz=tuple(range(10, 70, 10))), "6 tones to remove are too many; give up to 5"),
}


@pytest.mark.parametrize(("wishes", "says"), WRONG.values(), ids=WRONG)
def test_wishes_that_cannot_be_are_refused(humming: Recording, wishes: Wishes, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        tune(humming, wishes=wishes)


def test_rest_beyond_the_record_is_refused(coloured: Recording) -> None:
    with pytest.raises(RecordingError, match="give a longer stretch within it"):
        tune(coloured, wishes=Wishes(still_s=((90.0, 95.0),)))


@pytest.mark.parametrize("spike", [3.0, 20.0])
def test_a_spike_at_rest_is_no_noise(spike: float) -> None:
    z = np.random.default_rng(7).normal(0, 0.1, 2000)
    z[500] = spike
    still = Recording(z, rate_hz=100.0)
    (channel,) = tune(still, wishes=Wishes(still_s=((0.0, 10.0),))).channel
    assert channel.noise_std == pytest.approx(0.1, rel=0.08)


def test_a_channel_that_does_not_move_at_rest_is_tuned_as_ever(coloured: Recording) -> None:
    stuck = np.where(TIME_S < REST_S, 0.0, coloured.samples[:, 0])
    recording = Recording(stuck, names=["force"], units=["N"], rate_hz=RATE_HZ)
    assert tune(recording, wishes=Wishes(still_s=((0.0, REST_S),))).channel == tune(recording).channel


def test_hum_in_uneven_time_is_not_looked_for(humming: Recording) -> None:
    times = TIME_S + np.random.default_rng(3).uniform(0, 0.3, ROWS) / RATE_HZ
    with pytest.raises(UsageError, match="256 rows at an even rate without a gap are needed; no stretch is so even"):
        tune(Recording(humming.samples, times_s=times), wishes=Wishes(removed_hz=(50.0,)))


def test_a_short_record_cannot_lose_its_hum(humming: Recording) -> None:
    with pytest.raises(UsageError, match="256 rows at an even rate without a gap are needed; 200 rows came"):
        tune(Recording(humming.samples[:200], rate_hz=RATE_HZ), wishes=Wishes(removed_hz=(50.0,)))


def test_a_nearly_empty_channel_keeps_no_other_from_its_rest(coloured: Recording) -> None:
    few = np.full(ROWS, np.nan)
    few[::3000] = [1.0, 2.0, 3.0, 4.0]
    both = Recording(np.column_stack([coloured.samples[:, 0], few]), names=["force", "few"], rate_hz=RATE_HZ)
    force, empty = tune(both, wishes=Wishes(still_s=((0.0, REST_S),))).channel
    assert force.coloured_noise is not None
    assert empty.model == "untold"


def test_too_short_a_rest_names_the_channel(coloured: Recording) -> None:
    with pytest.raises(RecordingError, match=r"^force: .*Name a longer rest"):
        tune(coloured, wishes=Wishes(still_s=((0.0, 0.05),)))


TONES = {
    "twins": ((20.0, 0.01), (20.00001, 0.01), "two tones at 20 and 20.00001 Hz, which cannot be distinguished"),
    "too slow": ((1e-9, 0.01), (20.0, 0.01), "a tone at 1e-09 Hz"),
    "too wide": ((20.0, 1500.0), (30.0, 0.01), "a tone at 20 Hz, 1500 Hz wide"),
}


@pytest.mark.parametrize(("one", "other", "says"), TONES.values(), ids=TONES)
def test_tones_that_make_no_filter_are_refused(
    one: tuple[float, float], other: tuple[float, float], says: str, coloured: Recording, rested: Recipe
) -> None:
    (plain,) = [channel.model_copy(update={"coloured_noise": None}) for channel in rested.channel]
    tones = tuple(
        ToneRecipe(frequency_hz=frequency, bandwidth_hz=width, process_noise_density=1.0)
        for frequency, width in (one, other)
    )
    edited = rested.model_copy(update={"channel": (plain.model_copy(update={"tone": tones}),)})
    with pytest.raises(RecipeError, match=says):
        clean(coloured, edited)
