"""What can be asked of `clean` and `tune`: tones off, noise told at rest, the parts of each channel."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def humming(tmp_path: Path) -> Path:
    """Write 6000 rows at 1000 Hz: three seconds of rest, then motion, with hum in noise throughout."""
    rng, t = np.random.default_rng(5), np.arange(6000) / 1000
    motion = np.where(t < 3, 0.0, np.sin(np.pi * (t - 3)) ** 2)
    z = motion + 0.5 * np.sin(2 * np.pi * 50 * t) + rng.normal(0, 0.1, t.size)
    path = tmp_path / "hum.csv"
    table = np.column_stack([t, z, motion + rng.normal(0, 0.1, t.size)])
    np.savetxt(path, table, delimiter=",", header="time_s,strain (um/m),force", comments="", fmt="%.6f")
    return path


def test_hum_is_taken_off_and_said(humming: Path, run: Run, tmp_path: Path) -> None:
    ran = run("clean", humming, "-o", "out.parquet", "--remove", "50Hz", "--split", "--json")
    assert ran.returncode == 0, ran.stderr
    strain, force = json.loads(ran.stdout)["channels"]
    assert strain["removed_hz"] == [pytest.approx(50, abs=0.1)]
    assert (strain["tones_hz"], force["removed_hz"]) == ([], [])
    assert "without 50" in ran.stderr
    assert "No tone stands out near 50 Hz in force: nothing was removed there." in ran.stderr
    table = pyarrow.parquet.read_table(tmp_path / "out.parquet")
    tone = f"strain (um/m)_tone_{strain['removed_hz'][0]:.6g}Hz"
    assert table.column_names[:5] == ["time_s", *(f"strain (um/m){end}" for end in ("", "_sigma", "_motion")), tone]
    assert np.std(table[tone]) == pytest.approx(0.5 / np.sqrt(2), rel=0.05)
    assert np.std(table["strain (um/m)"].to_numpy()[500:2500]) < 0.05
    again = run("clean", humming, "-o", "again.csv", "--recipe", "out.parquet.recipe.toml", "--split")
    assert again.returncode == 0
    first = np.genfromtxt(tmp_path / "again.csv", delimiter=",", skip_header=1)[:, 1]
    np.testing.assert_array_equal(first, table["strain (um/m)"].to_numpy())


def test_the_noise_is_told_at_rest(humming: Path, run: Run) -> None:
    ran = run("tune", humming, "-o", "r.toml", "--still", "0:3", "--channels", "force", "--json")
    assert ran.returncode == 0, ran.stderr
    (force,) = json.loads(ran.stdout)["channel"]
    assert force["noise_std"] == pytest.approx(0.1, rel=0.05)


MISTAKES = {
    "no unit": (["--remove", "50"], "--remove 50 is not a frequency; write a positive number and then Hz or kHz"),
    "too quick": (["--remove", "700Hz"], "Tones to remove must be between 0 and 500 Hz"),
    "beside a dial": (["--remove", "50Hz", "--bandwidth", "5Hz"], "ask for one at a time"),
    "no rest there": (["--still", "40:50"], "there are 0 samples; 32 are needed"),
    "a recipe": (["--recipe", "r.toml", "--remove", "50Hz"], "A recipe already has its filters"),
}


@pytest.mark.parametrize(("words", "says"), MISTAKES.values(), ids=MISTAKES)
def test_what_cannot_be_is_refused(words: list[str], says: str, humming: Path, run: Run, tmp_path: Path) -> None:
    ran = run("clean", humming, "-o", "out.csv", *words)
    assert ran.returncode == 2
    assert says in ran.stderr
    assert "Traceback" not in ran.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["hum.csv"]


def test_parts_are_not_written_over_columns(humming: Path, run: Run, tmp_path: Path) -> None:
    text = humming.read_text(encoding="utf-8").replace("force", "strain (um/m)_motion")
    humming.write_text(text, encoding="utf-8")
    ran = run("clean", humming, "-o", "out.csv", "--split")
    assert ran.returncode == 2
    assert "has a column 'strain (um/m)_motion', which --split would write" in ran.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["hum.csv"]


def test_a_lag_is_kept_and_said(drive: Path, run: Run, tmp_path: Path) -> None:
    ran = run("clean", drive, "-o", "out.csv", "--lag", "50ms", "--channels", "walk", "--json")
    assert ran.returncode in (0, 4), ran.stderr
    told = json.loads(ran.stdout)
    assert (told["mode"], told["channels"][0]["delay_s"]) == ("lagged", pytest.approx(0.05))
    assert "delayed 0.05 s" in ran.stderr
    assert 'mode = "lagged"\nlag_s = 0.05' in (tmp_path / "out.csv.recipe.toml").read_text(encoding="utf-8")


def test_tuning_says_what_a_delay_buys(drive: Path, run: Run) -> None:
    ran = run("tune", drive, "-o", "r.toml", "--channels", "walk", "--json")
    assert ran.returncode == 0, ran.stderr
    curve = json.loads(ran.stdout)["delays"]["walk"]
    assert curve[0]["wait_s"] == 0.0
    line = ", ".join(f"{one['wait_s'] * 1e3:.4g} ms {one['left_db']:.1f} dB" for one in curve)
    assert f"walk: {line} (the limit)" in ran.stderr


@pytest.mark.parametrize("lag", ["50", "-5ms", "soon"])
def test_a_lag_without_its_unit_is_refused(lag: str, drive: Path, run: Run) -> None:
    ran = run("clean", drive, "-o", "out.csv", "--lag", lag)
    assert ran.returncode == 2
    assert "write a positive number and then s, ms or us: 10ms" in ran.stderr
