"""A gate from tuning to verdicts: spikes are seen through, motion is not cut, a recipe says what was decided."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from becalm.cleaning.pipeline import Cleaned, clean
from becalm.cleaning.recipes.recipe import VERSION, ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import GateRecipe
from becalm.cleaning.tuning import tune
from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording
from becalm.errors import RecipeError

RATE_HZ = 500.0
MOST_WORSE = 1.1
DATA = Path(__file__).parents[2].parent / "shared" / "data"


def truth_of(kind: str, seed: int, rows: int) -> Floats:
    t = np.arange(rows) / RATE_HZ
    walk = np.cumsum(0.03 * np.random.default_rng(seed + 100).normal(size=rows))
    return {"walk": walk, "sine": 5 * np.sin(np.pi * t), "constant": np.full(rows, 3.0)}[kind]


def spiked(seed: int, rows: int, share: float = 0.01, size: float = 8.0) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=rows)
    return noise, np.where(rng.random(rows) < share, size * rng.choice([-1.0, 1.0], rows), 0.0)


def cleaned(z: Floats, *, causal: bool) -> Cleaned:
    return clean(Recording(z, rate_hz=RATE_HZ), causal=causal)


def rms(out: Cleaned, truth: Floats) -> float:
    return float(np.sqrt(np.mean((out.signal.samples[500:, 0] - truth[500:]) ** 2)))


@pytest.mark.parametrize(
    ("kind", "causal", "seed"),
    [("walk", True, 0), ("walk", False, 1), ("sine", True, 2), ("sine", False, 3), ("constant", True, 4),
     ("constant", False, 5)],
)  # fmt: skip
def test_spikes_are_seen_through(kind: str, causal: bool, seed: int) -> None:
    truth, (noise, bad) = truth_of(kind, seed, 8000), spiked(seed, 8000)
    without, spiky = (rms(cleaned(truth + noise + extra, causal=causal), truth) for extra in (0.0, bad))
    assert spiky <= MOST_WORSE * without


@pytest.mark.parametrize("size", [1e4, 1e6, 1e9])
def test_huge_spikes_are_no_noise(size: float) -> None:
    rng = np.random.default_rng(3)
    noise, wild = 0.1 * rng.normal(size=(2, 4000)), rng.random(4000) < 0.01
    truth = np.sin(0.01 * np.arange(4000))
    plain, spiked = (cleaned(truth + noise[0] + size * wild * sign, causal=False) for sign in (0.0, noise[1]))
    assert spiked.recipe.channel[0].noise_std == pytest.approx(0.1, rel=0.05)
    assert rms(spiked, truth) < 1.2 * rms(plain, truth)


@pytest.mark.parametrize("size", [20.0, 200.0])
def test_spikes_widen_no_sigma(size: float) -> None:
    rng = np.random.default_rng(3)
    noise = 0.1 * rng.normal(size=(2, 1000))
    truth, wild = np.sin(0.01 * np.arange(1000)), rng.random(1000) < 0.01
    plain, spiked = (cleaned(truth + noise[0] + size * wild * sign, causal=False) for sign in (0.0, noise[1]))
    assert spiked.recipe.channel[0].gate is not None
    left_out = spiked.reports[0].verdicts
    assert left_out["spike"] + left_out["outlier"] >= 5
    assert np.median(spiked.sigma.samples) < 1.3 * np.median(plain.sigma.samples)


@pytest.mark.parametrize("causal", [True, False])
def test_each_reading_gets_its_verdict(causal: bool) -> None:
    noise, bad = spiked(1, 8000, size=12.0)
    z = truth_of("walk", 1, 8000) + noise + bad
    bad[:20], z[:20] = 0.0, noise[:20]
    z[4000], z[4001], z[4002] = np.nan, np.inf, 1e300
    bad[4000:4003] = 0.0
    out = cleaned(z, causal=causal)
    (report,), verdicts = out.reports, out.verdicts["channel_0"]
    assert verdicts[4000:4003].tolist() == [Verdict.MISSING, Verdict.NONFINITE, Verdict.OVERRANGE]
    assert np.mean((verdicts == Verdict.SPIKE) == (bad != 0)) > 0.999
    for verdict in Verdict:
        assert report.verdicts[verdict.name.lower()] == np.count_nonzero(verdicts == verdict)
    assert any("Spikes were left out" in sentence for sentence in report.advice)
    assert report.noise_std == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("causal", [True, False])
def test_heavy_tails_get_no_gate(causal: bool) -> None:
    """Of a motion whose steps are heavier than Gaussian, and of noise that is: no reading is of another kind."""
    rng = np.random.default_rng(2)
    records = {
        "motion": np.cumsum(rng.standard_t(2.5, size=8000)) + 0.3 * rng.normal(size=8000),
        "noise": 0.1 * np.cumsum(rng.normal(size=8000)) + rng.laplace(size=8000),
    }
    for name, z in records.items():
        recipe = tune(Recording(z, rate_hz=RATE_HZ), causal=causal)
        assert recipe.channel[0].gate is None, name


def test_without_rejects_the_gate_changes_no_bit() -> None:
    z = truth_of("walk", 3, 4000) + spiked(3, 4000)[0]
    recording = Recording(z, rate_hz=RATE_HZ)
    recipe = tune(recording)
    assert recipe.channel[0].gate == GateRecipe()
    without = recipe.model_copy(update={"channel": (recipe.channel[0].model_copy(update={"gate": None}),)})
    gated, free = clean(recording, recipe), clean(recording, without)
    assert np.array_equal(gated.signal.samples, free.signal.samples)
    assert np.array_equal(gated.sigma.samples, free.sigma.samples)


@pytest.mark.parametrize("file", ["comma2k19/accelerometer.csv", "comma2k19/can_speed.csv"])
def test_real_motion_is_not_cut(file: str) -> None:
    """By a causal filter; test_real_recordings.py has the smoother."""
    path = DATA / file
    if not path.exists():
        pytest.skip(f"the recordings are not beside the project ({file})")
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    out = clean(Recording(table[:, 1:], times_s=table[:, 0]), causal=True)
    for verdicts in out.verdicts.values():
        assert np.mean(verdicts == Verdict.SPIKE) < 1e-3


def recipe_with(gate: GateRecipe | None) -> Recipe:
    channel = ChannelRecipe(name="a", model="motion", order=1, process_noise_density=1.0, noise_std=1.0, gate=gate)
    return Recipe(tuned_on=Origin(rate_hz=10.0), channel=(channel,))


@pytest.mark.parametrize("gate", [None, GateRecipe(), GateRecipe(false_alarms_per_hour=0.1, agree=3, at_most=9)])
def test_a_recipe_keeps_its_gate(gate: GateRecipe | None) -> None:
    recipe = recipe_with(gate)
    assert Recipe.from_toml(recipe.to_toml()) == recipe
    assert ("[channel.gate]" in recipe.to_toml()) == (gate is not None)


def test_older_recipes_have_no_gate() -> None:
    text = recipe_with(None).to_toml().replace(f"becalm_recipe = {VERSION}", "becalm_recipe = 3")
    assert Recipe.from_toml(text).channel[0].gate is None


@pytest.mark.parametrize(
    "wrong", ["agree = 1", "at_most = 2", "at_most = 99999999999999999999", "false_alarms_per_hour = 0.0", "width = 3"]
)
def test_what_is_no_gate_is_refused(wrong: str) -> None:
    text = recipe_with(None).to_toml() + f"\n[channel.gate]\n{wrong}\n"
    with pytest.raises(RecipeError, match="gate"):
        Recipe.from_toml(text)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", [3, 5])
def test_jumps_that_follow_each_other_soon_leave_the_covariance_its_digits(order: int, causal: bool) -> None:
    """A slow motion does not forget a jump before the next; each multiplied what the last one had added."""
    rng, z, away = np.random.default_rng(0), np.full(400, 22.0), np.zeros(400, bool)
    for start in range(150, 250, 12):
        away[start : start + 6] = True
    z = np.where(away, 490.0, 22.0) + 0.3 * rng.normal(size=400)
    motion = ChannelRecipe(
        name="a", unit="V", model="motion", order=order, process_noise_density=1.4, noise_std=0.3, damped_below_hz=0.11
    ).model_copy(update={"gate": GateRecipe(false_alarms_per_hour=1.0, agree=4, at_most=4)})
    recipe = Recipe(tuned_on=Origin(rate_hz=100.0), channel=(motion,))
    out = clean(Recording(z, names=["a"], units=["V"], rate_hz=100.0), recipe, causal=causal)
    signal, sigma = out.signal.samples[:, 0], out.sigma.samples[:, 0]
    assert np.abs(signal[260:] - 22.0).max() < 1.5
    assert ((sigma[1:] > 0.01) & (sigma[1:] < 5.0))[~away[1:]].all()
