"""A hole of which the model knows nothing is told as unknown, in every path; with `fill` its guess is bounded."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import becalm
from becalm.cleaning.pipeline import Cleaned
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.cleaning.tuning import Wishes
from becalm.cli.main import app
from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict

ROWS, RATE_HZ = 6000, 200.0
HOLE = slice(3000, 3200)


def band_noise(highest_hz: float) -> Floats:
    rng = np.random.default_rng(int(highest_hz * 10))
    spectrum = np.fft.rfft(rng.normal(size=ROWS))
    spectrum[np.fft.rfftfreq(ROWS, 1 / RATE_HZ) > highest_hz] = 0
    x = np.fft.irfft(spectrum, ROWS)
    return np.asarray(5.0 + x / x.std())


def holed(highest_hz: float) -> becalm.Recording:
    z = band_noise(highest_hz) + 0.05 * np.random.default_rng(1).normal(size=ROWS)
    z[HOLE] = np.nan
    return becalm.Recording(z, names=["a"], rate_hz=RATE_HZ)


@cache
def cleaned(causal: bool) -> Cleaned:
    return becalm.clean(holed(10.0), causal=causal)


@cache
def filling(causal: bool) -> Recipe:
    return becalm.tune(holed(10.0), causal=causal, wishes=Wishes(fill=True))


@pytest.mark.parametrize("causal", [False, True])
def test_of_a_hole_too_long_nothing_is_told_but_at_its_ends(causal: bool) -> None:
    out = cleaned(causal)
    signal, sigma, verdicts = out.signal.samples[:, 0], out.sigma.samples[:, 0], out.verdicts["a"]
    holes = verdicts == Verdict.HOLE
    assert holes[HOLE].mean() > 0.5
    assert not holes[HOLE][0]
    assert not holes[:3000].any()
    np.testing.assert_array_equal(np.isnan(signal[HOLE]), holes[HOLE])
    np.testing.assert_array_equal(np.isnan(sigma[HOLE]), holes[HOLE])
    assert "--fill" in out.reports[0].says
    assert out.reports[0].verdicts["hole"] == holes.sum()


def test_before_the_first_reading_of_all_the_first_row_too_is_unknown() -> None:
    z = band_noise(10.0) + 0.05 * np.random.default_rng(1).normal(size=ROWS)
    z[:400] = np.nan
    out = becalm.clean(becalm.Recording(z, names=["a"], rate_hz=RATE_HZ))
    told = np.isfinite(out.signal.samples[:400, 0])
    assert not told[:300].any()
    assert told[399]
    assert (out.verdicts["a"][:300] == Verdict.HOLE).all()


@pytest.mark.parametrize("causal", [False, True])
def test_its_guess_is_within_what_was_read_and_its_sigma_is_the_spread(causal: bool) -> None:
    recording = holed(10.0)
    out = becalm.clean(recording, filling(causal))
    signal, sigma = out.signal.samples[HOLE, 0], out.sigma.samples[HOLE, 0]
    read = recording.samples[np.isfinite(recording.samples)]
    assert read.min() <= signal.min()
    assert signal.max() <= read.max()
    assert 0.9 < sigma[100] < 2.0
    error = (signal - band_noise(10.0)[HOLE])[20:-20]
    assert np.sqrt(np.mean(error**2)) < 1.3


@pytest.mark.parametrize("causal", [False, True])
def test_what_the_model_knows_is_told_across_a_gap(causal: bool) -> None:
    rng = np.random.default_rng(3)
    level = 3.0 + 0.2 * rng.normal(size=ROWS)
    walk = np.cumsum(rng.normal(size=ROWS)) + rng.normal(size=ROWS)
    for z in (level, walk):
        z[3000:3020] = np.nan
        out = becalm.clean(becalm.Recording(z, rate_hz=RATE_HZ), causal=causal)
        assert np.isfinite(out.signal.samples[3000:3020]).all()


def test_a_stream_tells_what_a_causal_file_does() -> None:
    recording, file = holed(10.0), cleaned(True)
    recipe = file.recipe
    stream = StreamCleaner(recipe, 1 / RATE_HZ)
    told = [
        stream.push(recording.samples[at : at + 700], np.ones(len(recording.samples[at : at + 700])))
        for at in range(0, ROWS, 700)
    ]
    signal = np.concatenate([part.signal for part in told])
    np.testing.assert_allclose(signal, file.signal.samples, rtol=1e-9, equal_nan=True)
    verdicts = np.concatenate([part.verdicts for part in told])[:, 0]
    np.testing.assert_array_equal(verdicts == Verdict.HOLE, file.verdicts["a"] == Verdict.HOLE)
    assert stream.health()[0].counts["hole"] == (verdicts == Verdict.HOLE).sum() > 0


def test_a_recipe_keeps_the_spread_and_the_wish() -> None:
    recipe = filling(False)
    assert recipe.channel[0].fill
    assert recipe.channel[0].spread_std == pytest.approx(1.0, rel=0.2)
    assert Recipe.from_toml(recipe.to_toml()) == recipe


def test_the_option_fills(tmp_path: Path) -> None:
    recording = holed(10.0)
    file, out = tmp_path / "a.csv", tmp_path / "out.csv"
    cells = ("" if np.isnan(z) else f"{z:.4f}" for z in recording.samples[:, 0])
    file.write_text("time (s),a\n" + "".join(f"{k / RATE_HZ:.3f},{cell}\n" for k, cell in enumerate(cells)))
    for more, known in (((), False), (("--fill",), True)):
        ran = CliRunner().invoke(app, ["clean", str(file), "-o", str(out), *more])
        assert ran.exit_code in (0, 4), ran.output
        assert np.isfinite(becalm.read(out).channel("a")).all() == known
        out.unlink()
        (tmp_path / "out.csv.recipe.toml").unlink()
