"""A tare on the command line: told, kept in the recipe, the same bytes again, and recalibrated without the readings."""

from __future__ import annotations

import subprocess
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from becalm.core.arrays import Floats

Run = Callable[..., subprocess.CompletedProcess[str]]
CELL = """
[[sensor]]
kind = "load cell"
channel = "pull"
raw_unit = "mV"
unit = "N"
rated_output_mv_per_v = 2.0
rated_output_uncertainty_mv_per_v = 0.02
capacity = 1000
excitation_v = 10.0
tare = "0s:2s"
[sensor.sheet]
resonance_hz = 40.0
"""
WRONG = CELL.replace("= 2.0", "= 2.5")


@pytest.fixture
def log(tmp_path: Path, run: Run) -> Path:
    """Clean 800 rows at 100 Hz of a cell that puts out 0.7 mV without load, which comes after 3 s."""
    rng, t = np.random.default_rng(8), np.arange(800) / 100
    volts = 0.7 + np.where(t > 3, 5 * (1 - np.cos(t - 3)), 0) + rng.normal(0, 0.02, 800)
    path = tmp_path / "log.csv"
    path.write_text("time_s,pull (mV)\n" + "".join(f"{at:.2f},{v:.7f}\n" for at, v in zip(t, volts, strict=True)))
    (tmp_path / "s.toml").write_text(CELL, encoding="utf-8")
    (tmp_path / "wrong.toml").write_text(WRONG, encoding="utf-8")
    return path


def columns(path: Path) -> Floats:
    return np.asarray(np.genfromtxt(path, delimiter=",", skip_header=1))


def test_a_zero_is_told_kept_and_gives_the_same_bytes_again(log: Path, run: Run, tmp_path: Path) -> None:
    first = run("clean", log, "-o", "out.csv", "--sensors", "s.toml")
    assert first.returncode in (0, 4), first.stderr
    assert "the zero of 'pull (mV)' was measured from 0 s to 2 s: 0.7" in first.stderr
    assert "resonance" not in first.stderr  # the filter passes less than its flat band
    (pull,) = tomllib.loads((tmp_path / "out.csv.recipe.toml").read_text())["channel"]
    tare = pull["calibration"]["tare"]
    assert (tare["start_s"], tare["stop_s"], tare["raw_unit"], tare["readings"]) == (0.0, 2.0, "mV", 200)
    assert tare["reading"] == pytest.approx(columns(log)[:200, 1].mean(), rel=1e-12)
    assert pull["calibration"]["offset_std"] == pytest.approx(50 * tare["reading_std"])
    again = run("clean", log, "-o", "again.csv", "--sensors", "s.toml", "--recipe", "out.csv.recipe.toml")
    assert again.returncode == first.returncode, again.stderr
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "out.csv").read_bytes()
    assert (tmp_path / "again.csv.recipe.toml").read_bytes() == (tmp_path / "out.csv.recipe.toml").read_bytes()


def test_another_recording_has_a_zero_of_its_own(log: Path, run: Run, tmp_path: Path) -> None:
    run("tune", log, "-o", "r.toml", "--sensors", "s.toml")
    other = np.add(columns(log), [0.0, 1.0])
    rows = "".join(f"{at:.2f},{v:.7f}\n" for at, v in other)
    (tmp_path / "other.csv").write_text("time_s,pull (mV)\n" + rows)
    ran = run("clean", "other.csv", "-o", "out.csv", "--sensors", "s.toml", "--recipe", "r.toml")
    assert ran.returncode in (0, 4), ran.stderr
    (pull,) = tomllib.loads((tmp_path / "out.csv.recipe.toml").read_text())["channel"]
    assert pull["calibration"]["tare"]["reading"] == pytest.approx(1.7, abs=0.01)
    assert abs(columns(tmp_path / "out.csv")[:200, 1].mean()) < 0.5


def test_it_is_recalibrated_with_the_zero_that_was_taken(log: Path, run: Run, tmp_path: Path) -> None:
    run("clean", log, "-o", "clean.csv", "--sensors", "wrong.toml")
    ran = run("recalibrate", "clean.csv", "-o", "mended.csv", "--from", "wrong.toml", "--to", "s.toml")
    assert ran.returncode == 0, ran.stderr
    assert "times 1.25" in ran.stderr
    run("clean", log, "-o", "again.csv", "--sensors", "s.toml")
    found, expected = columns(tmp_path / "mended.csv"), columns(tmp_path / "again.csv")
    np.testing.assert_allclose(found[:, 1], expected[:, 1], atol=1e-2 * np.median(expected[:, 2]))
    np.testing.assert_allclose(found[:, 2], expected[:, 2], rtol=1e-2)


OTHERS = {
    "another stretch": (WRONG, CELL.replace("0s:2s", "1s:2s"), "measures the zero of 'pull' in another interval"),
    "no zero before": (WRONG.replace('tare = "0s:2s"\n', ""), CELL, "measures the zero of 'pull' in another interval"),
    "another file": (WRONG.replace("0s:2s", "1s:2s"), CELL.replace("0s:2s", "1s:2s"), "do not have the same zero"),
    "none told": (
        WRONG.replace('tare = "0s:2s"\n', ""),
        CELL.replace('tare = "0s:2s"\n', ""),
        "not have the same zero",
    ),
}


def test_another_zero_needs_the_readings(log: Path, run: Run, tmp_path: Path) -> None:
    run("clean", log, "-o", "clean.csv", "--sensors", "wrong.toml")
    for kind, (old, new, sentence) in OTHERS.items():
        (tmp_path / "from.toml").write_text(old)
        (tmp_path / "to.toml").write_text(new)
        ran = run("recalibrate", "clean.csv", "-o", "mended.csv", "--from", "from.toml", "--to", "to.toml")
        assert ran.returncode == 2, kind
        assert sentence in ran.stderr, kind
        assert not (tmp_path / "mended.csv").exists()


def test_a_stretch_that_is_not_quiet_is_refused_and_nothing_written(log: Path, run: Run, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(CELL.replace("0s:2s", "2s:6s"))
    ran = run("clean", log, "-o", "out.csv", "--sensors", "s.toml")
    assert ran.returncode == 2
    assert "The zero of 'pull (mV)' cannot be measured in its tare interval, 2 s to 6 s" in ran.stderr
    assert "Give a stretch" in ran.stderr
    assert "Traceback" not in ran.stderr
    assert not list(tmp_path.glob("out*"))


def test_rows_that_hold_more_than_the_sensor_tells_right_are_told(log: Path, run: Run) -> None:
    shown = run("inspect", log, "--sensors", "s.toml")
    assert (
        "pull (N): its rows, at 100 Hz, contain frequencies up to 50 Hz, but its sensor, with a resonance at 40 Hz"
        in shown.stderr
    )
