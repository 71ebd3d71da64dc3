"""Tones: found where they are, at their frequency; none where there is none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.tuning import tune
from becalm.core.arrays import Floats
from becalm.core.closed_forms import motion_power
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import Component, motion, oscillator
from becalm.core.recording import Recording
from becalm.errors import RecipeError
from becalm.identification import tones
from becalm.identification.choose import choose
from becalm.identification.damping import damped
from becalm.identification.likelihood import FEWEST_FOR_TONES, Evidence
from becalm.identification.spectrum import BinnedPeriodogram, ToneOscillator, tone_power
from becalm.identification.tones import Fit, _moved_tone, fit_spectrum
from becalm.metrics.truth import coverage, rms_error

ROWS = 8192
T = np.arange(ROWS)


def tones_of(z: Floats, causal: bool) -> list[float]:
    choice = choose(z, np.ones(len(z)), causal)
    assert choice.tuning is not None
    return sorted(tone.angle for tone in choice.tuning.tones)


@pytest.mark.parametrize("causal", [True, False])
def test_tones_are_found_at_their_frequencies(causal: bool) -> None:
    rng = np.random.default_rng(1)
    drift = np.cumsum(0.02 * rng.normal(size=ROWS))
    z = 5.0 + drift + np.sin(0.2003 * T) + 0.5 * np.sin(0.7001 * T + 1) + 0.5 * rng.normal(size=ROWS)
    found = tones_of(z, causal)
    np.testing.assert_allclose(found, [0.2003, 0.7001], atol=0.3 * 2 * np.pi / ROWS)


def test_a_tone_that_fades_is_found_with_its_width() -> None:
    rng = np.random.default_rng(2)
    turn = 0.99 * np.exp(0.5j)
    state, z = 0j, np.empty(ROWS)
    for k in range(ROWS):
        state = turn * state + 0.3 * (rng.normal() + 1j * rng.normal())
        z[k] = state.real + 0.3 * rng.normal()
    choice = choose(z, np.ones(ROWS), True)
    assert choice.tuning is not None
    (tone,) = choice.tuning.tones
    assert tone.angle == pytest.approx(0.5, abs=0.005)
    assert tone.damping == pytest.approx(-np.log(0.99), rel=0.3)


NOISES = ["white", "walk", "slope", "steps", "spikes", "integers"]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", NOISES)
def test_no_tone_is_found_where_there_is_none(name: str, seed: int) -> None:
    rng = np.random.default_rng([seed, NOISES.index(name)])
    white = rng.normal(size=ROWS)
    z = {
        "white": white,
        "walk": np.cumsum(0.1 * rng.normal(size=ROWS)) + white,
        "slope": np.cumsum(np.cumsum(1e-3 * rng.normal(size=ROWS))) + white,
        "steps": 3.0 * (T // 1000 % 2) + white,
        "spikes": white + 30.0 * (rng.random(ROWS) < 0.002),
        "integers": np.round(white),
    }[name]
    assert tones_of(z, causal=False) == []
    assert tones_of(z, causal=True) == []


def test_a_spectrum_is_fitted_to_what_it_was_made_of() -> None:
    """Without scatter the fit ends at the truth, from afar."""
    angle = np.pi * (np.arange(4000) + 0.5) / 4000
    tone = ToneOscillator(0.8, 0.004, 3e-4)
    power = 2.0 + 1e-4 * motion_power(2, angle) + tone_power(tone, angle)
    start = Fit(2, 1.0, 1e-5, (ToneOscillator(0.8005, 0.02, 1e-3),), 0.0)
    found = fit_spectrum(start, BinnedPeriodogram(angle, power, np.ones(4000)))
    assert found.noise_variance == pytest.approx(2.0, rel=1e-3)
    assert found.density == pytest.approx(1e-4, rel=1e-2)
    np.testing.assert_allclose(found.tones[0], tone, rtol=2e-2)


@pytest.mark.parametrize("causal", [True, False])
def test_a_tone_in_noise_comes_back_calm_and_by_its_recipe_again(causal: bool) -> None:
    rate_hz = 200.0
    truth = 2.0 + np.sin(2 * np.pi * 7.0 * T / rate_hz)
    z = truth + 0.5 * np.random.default_rng(3).normal(size=ROWS)
    recording = Recording(z, rate_hz=rate_hz)
    recipe = tune(recording, causal=causal)
    out = clean(recording, Recipe.from_toml(recipe.to_toml()))
    assert out.reports[0].tones_hz == pytest.approx((7.0,), abs=0.005)
    assert out.describes
    late = slice(1000, None)
    signal, sigma = out.signal.samples[late, 0], out.sigma.samples[late, 0]
    assert rms_error(signal, truth[late]) < 0.05
    assert coverage(signal, sigma, truth[late]) > 0.6


def test_a_tone_too_quick_for_a_recording_is_refused() -> None:
    z = np.sin(0.9 * T) + 0.2 * np.random.default_rng(4).normal(size=ROWS)
    recipe = tune(Recording(z, rate_hz=1000.0))
    assert recipe.channel[0].tone
    with pytest.raises(RecipeError, match=r"a tone at 143\.\d+ Hz, \S+ Hz wide, which a rate of 100 Hz cannot resolve"):
        clean(Recording(z, rate_hz=100.0), recipe)


def test_short_records_are_not_searched() -> None:
    z = np.sin(0.3 * T[: FEWEST_FOR_TONES - 1]) + 0.1 * np.random.default_rng(5).normal(size=FEWEST_FOR_TONES - 1)
    assert tones_of(z, causal=True) == []


def several_tones(count: int) -> Floats:
    return np.asarray(sum(4 * np.sin(2 * np.pi * f * T / 100) for f in (3, 9, 17, 28, 41, 6.3, 35)[:count]))


@pytest.mark.slow
def test_five_tones_are_found() -> None:
    white = np.random.default_rng(6).normal(size=ROWS)
    five = clean(Recording(several_tones(5) + white, rate_hz=100.0), causal=True)
    assert five.describes
    assert rms_error(five.signal.samples[2000:, 0], several_tones(5)[2000:]) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("causal", [True, False])
def test_tones_beyond_the_most_are_said_to_be_left(causal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tones, "MOST_TONES", 2)
    z = several_tones(4) + np.random.default_rng(6).normal(size=ROWS)
    assert not clean(Recording(z, rate_hz=100.0), causal=causal).describes


@pytest.mark.parametrize("causal", [True, False])
def test_strong_tones_that_a_motion_would_follow_are_found(causal: bool) -> None:
    rng = np.random.default_rng(7)
    walk = np.cumsum(0.01 * rng.normal(size=ROWS))
    z = walk + 3 * np.sin(2 * np.pi * 0.05 * T) + 2 * np.sin(2 * np.pi * 0.1203 * T) + rng.normal(size=ROWS)
    np.testing.assert_allclose(tones_of(z, causal), 2 * np.pi * np.array([0.05, 0.1203]), atol=2e-4)


def test_a_tone_at_half_the_rate_is_left_alone() -> None:
    z = 3 * np.sin(2 * np.pi * 0.4999 * T) + np.random.default_rng(8).normal(size=ROWS)
    assert tones_of(z, causal=True) == []


@pytest.mark.parametrize("causal", [True, False])
def test_a_tone_across_a_gap_of_a_day(causal: bool) -> None:
    z = 3 * np.sin(0.459 * T) + np.random.default_rng(9).normal(size=ROWS)
    times = np.round(T / 100 + 1e5 * (T >= 5000), 2)
    out = clean(Recording(z, times_s=times), causal=causal)
    assert out.reports[0].tones_hz
    assert np.isfinite(out.signal.samples[10:]).all()
    assert np.isfinite(out.sigma.samples[10:]).all()


@pytest.mark.parametrize(("key", "value"), [("process_noise_density", 1e40), ("bandwidth_hz", 1e300)])
def test_a_tone_beyond_measure_is_refused(key: str, value: float) -> None:
    recipe = tune(Recording(np.sin(0.3 * T) + 0.2 * np.random.default_rng(10).normal(size=ROWS), rate_hz=100.0))
    channel = recipe.channel[0]
    odd = channel.tone[0].model_copy(update={key: value})
    wrong = recipe.model_copy(update={"channel": (channel.model_copy(update={"tone": (odd,)}),)})
    with pytest.raises(RecipeError, match="tone at"):
        clean(Recording(np.sin(0.3 * T), rate_hz=100.0), wrong)


@pytest.mark.parametrize("causal", [True, False])
def test_a_tone_is_found_by_a_clock_that_jitters(causal: bool) -> None:
    """As phones stamp: steps 0.1 % too long on average, each a little off; the tone keeps its place in true time."""
    rng, count = np.random.default_rng(9), 20_000
    elapsed = 1.001 + 0.003 * np.diff(rng.normal(size=count + 1))
    times = np.cumsum(elapsed)
    z = np.sin(2 * np.pi * 0.21 * times) + rng.normal(size=count)
    found = choose(z, elapsed, causal).tuning
    assert found is not None
    (tone,) = found.tones
    assert tone.angle / (2 * np.pi) == pytest.approx(0.21, abs=2e-5)


def drawn(component: Component, rng: np.random.Generator, count: int) -> Floats:
    """Draw what a component reads, from a start at zero."""
    F, Q = (matrices[0] for matrices in component.over(np.ones(1)))
    root = np.linalg.cholesky(Q + 1e-18 * np.eye(len(Q)))
    x, out = np.zeros(len(F)), np.empty(count)
    for k in range(count):
        x = F @ x + root @ rng.normal(size=len(F))
        out[k] = component.output[0] @ x
    return out


@pytest.mark.parametrize("causal", [False, True])
@pytest.mark.parametrize(("middle", "width"), [(0.03, 0.006), (0.15, 0.03), (0.05, 0.01)])
def test_noise_of_a_narrow_band_is_found_and_followed(middle: float, width: float, causal: bool) -> None:
    """A vibration a fifth as wide as it is quick, beside a slow motion: nearly as well as with the truth known."""
    rng, count = np.random.default_rng(2), 12_000
    component = motion(2, 1e-7) + oscillator(middle, width, 0.25 * 2 * np.pi * width)
    signal = drawn(component, rng, count)
    z = signal + rng.normal(0, 0.5, count)
    found = choose(z, np.ones(count), causal).tuning
    assert found is not None
    assert min(abs(tone.angle / (2 * np.pi) / middle - 1) for tone in found.tones) < 0.1

    def error(one: Component, noise_variance: float) -> float:
        run = kalman_filter if causal else kalman_smoother
        told = run(one.to_model(1.0, noise_variance), z).signal[50:, 0]
        return float(np.sqrt(np.mean((told - signal[50:]) ** 2)))

    assert error(found.component, found.noise_variance) < 1.03 * error(component, 0.25)


@pytest.mark.parametrize("causal", [False, True])
def test_a_chirp_is_no_band(causal: bool) -> None:
    """Its spectrum has a plateau, but at any moment it is one sine."""
    t = np.arange(10_000) / 100
    z = np.sin(2 * np.pi * (0.05 + 0.02475 * t) * t) + np.random.default_rng(1).normal(0, 0.05, t.size)
    found = choose(z, np.ones(t.size), causal).tuning
    assert found is not None
    assert found.tones == ()


PERIODIC = {
    "saw": (lambda t: (2.7 * t) % 1, 0.1),
    "harmonics": (lambda t: sum(np.sin(2 * np.pi * 3.1 * k * t) / k for k in range(1, 9)), 0.3),
}


@pytest.mark.parametrize(
    ("shape", "noise", "causal"), [(*PERIODIC["saw"], False), (*PERIODIC["harmonics"], True)], ids=PERIODIC
)
def test_tones_of_a_wave_with_many_harmonics_make_nothing_worse(
    shape: Callable[[Floats], Floats], noise: float, causal: bool
) -> None:
    """Five tones do not make a saw: the rest would pass for noise, and sigma for small."""
    t = T / 100
    truth = shape(t)
    z = truth + np.random.default_rng(1).normal(0, noise, ROWS)
    found = choose(z, np.ones(ROWS), causal)
    run = kalman_filter if causal else kalman_smoother
    errors = []
    assert found.tuning is not None
    assert found.motion is not None
    for tuning in (found.tuning, damped(found.motion, Evidence.of(z, np.ones(ROWS)))):
        told = run(tuning.component.to_model(1.0, tuning.noise_variance), z)
        errors.append(rms_error(told.signal[50:, 0], truth[50:]))
        claimed = float(np.sqrt(np.mean(told.sigma[50:] ** 2)))
        assert errors[-1] < 2.5 * claimed  # two, and as far as the noise itself is known
    assert errors[0] <= 1.001 * errors[1]


@pytest.mark.parametrize("far", [-1e9, 1e9])
def test_a_tone_stays_a_tone_however_far_a_fit_would_go(far: float) -> None:
    tone = _moved_tone(ToneOscillator(1e-3, 1e-3, 1.0), np.array([far, 1.0]), 1e-4)
    assert 0 < tone.damping <= tone.angle < np.pi
