"""A file with a gap of 100 seconds, or of thirty years: both sides are clean, and nothing beside them changes."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.csv
import pytest

from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.arrays import Floats
from becalm.core.recording import Recording

Run = Callable[..., subprocess.CompletedProcess[str]]
ROWS, AT = 3000, 1500


def readings() -> tuple[Floats, Floats]:
    """Return a slow wave at 100 Hz, true and read."""
    true = np.sin(2 * np.pi * 0.3 * np.arange(ROWS) / 100)
    return true, true + 0.05 * np.random.default_rng(2).normal(size=ROWS)


def write(path: Path, gap_s: float) -> None:
    times, (_, z) = np.arange(ROWS) / 100, readings()
    times[AT:] += gap_s
    lines = [f"{t:.2f},{value:.6f}" for t, value in zip(times, z, strict=True)]
    path.write_text("time_s,a\n" + "\n".join(lines) + "\n", encoding="utf-8")


@pytest.mark.parametrize(  # each way across the longest gap, and one across a short one
    ("gap_s", "how"), [(1e9, ()), (1e9, ("--causal",)), (1e9, ("--lag", "100ms")), (100.0, ("--causal",))]
)
def test_both_sides_of_a_long_gap_are_clean(gap_s: float, how: tuple[str, ...], run: Run, tmp_path: Path) -> None:
    write(tmp_path / "gap.csv", gap_s)
    ran = run("clean", "gap.csv", "-o", "out.csv", "--verdicts", "--json", *how)
    assert ran.returncode in (0, 4), ran.stderr  # a wave is no motion, with a gap or without
    table = pyarrow.csv.read_csv(tmp_path / "out.csv")
    signal, sigma = (np.array(table[name]) for name in ("a", "a_sigma"))
    true, z = readings()
    assert (np.abs(signal - true) <= 4.5 * sigma).all()  # 3000 rows
    assert sigma.min() > 0.003
    assert np.std(signal[AT:] - true[AT:]) < 0.6 * np.std(z - true)
    (report,) = json.loads(ran.stdout)["channels"]
    assert report["verdicts"]["gap"] == 1


@pytest.mark.parametrize("causal", [True, False])
def test_after_the_gap_a_file_is_what_its_rest_is(causal: bool) -> None:
    _, z = readings()
    times = np.arange(ROWS) / 100
    recipe = tuned(Recording(z[:, np.newaxis], times_s=times), causal)
    late = times + np.where(np.arange(ROWS) < AT, 0.0, 1e6)
    whole = clean(Recording(z[:, np.newaxis], times_s=late), recipe)
    for part in (slice(AT), slice(AT, None)):
        alone = clean(Recording(z[part, np.newaxis], times_s=times[part]), recipe)
        off = np.abs(whole.signal.samples[part] - alone.signal.samples) / alone.sigma.samples
        assert off.max() < 0.05  # a level that is as uncertain as the gap is long says next to nothing
        np.testing.assert_allclose(whole.sigma.samples[part], alone.sigma.samples, rtol=0.01)


def tuned(recording: Recording, causal: bool) -> Recipe:
    return clean(recording, causal=causal).recipe
