"""Sensors on the command line: every command reads what they measured, and says whose sheet is due."""

from __future__ import annotations

import json
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
zero_uncertainty = 6.0
[sensor.sheet]
serial = "4711"
due = 2020-03-01
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Write 400 rows of a load cell in V, of which one is missing, and another channel; and its sensor file."""
    rng, t = np.random.default_rng(8), np.arange(400) / 100
    table = np.column_stack([t, 0.01 + 5e-3 * np.sin(t) + rng.normal(0, 2e-4, 400), rng.normal(0, 1, 400)])
    lines = [f"{at:.2f},{volts:.7f},{other:.6f}" for at, volts, other in table]
    lines[7] = lines[7].replace(f"{table[7, 1]:.7f}", "")
    path = tmp_path / "log.csv"
    path.write_text("time_s,pull (V),other\n" + "\n".join(lines) + "\n", encoding="utf-8")
    (tmp_path / "s.toml").write_text(CELL, encoding="utf-8")
    return path


def columns(path: Path) -> Floats:
    return np.asarray(np.genfromtxt(path, delimiter=",", skip_header=1))


def test_clean_writes_what_was_measured_with_what_the_sheet_leaves_uncertain(
    log: Path, run: Run, tmp_path: Path
) -> None:
    ran = run("clean", log, "-o", "out.csv", "--sensors", "s.toml")
    assert ran.returncode in (0, 4), ran.stderr
    assert "'pull (V)' is converted from mV to N by the sensor's data sheet." in ran.stderr
    assert "The sensor of pull (serial 4711) was due for calibration on 2020-03-01;" in ran.stderr
    assert (tmp_path / "out.csv").read_text().startswith("time_s,pull (N),pull (N)_sigma,other,")
    recipe = tomllib.loads((tmp_path / "out.csv.recipe.toml").read_text())
    pull, other = recipe["channel"]
    assert pull["calibration"] == {"relative_std": pytest.approx(0.005), "offset_std": pytest.approx(3.0)}
    assert "calibration" not in other
    plain = run("clean", log, "-o", "plain.csv")
    assert plain.returncode == ran.returncode
    in_volts, found = columns(tmp_path / "plain.csv"), columns(tmp_path / "out.csv")
    expected = in_volts[:, 1] * 5e4  # N per V
    np.testing.assert_allclose(found[:, 1], expected, rtol=1e-4)
    whole = np.sqrt((5e4 * in_volts[:, 2]) ** 2 + (0.005 * expected) ** 2 + 3.0**2)
    np.testing.assert_allclose(found[:, 2], whole, rtol=1e-3)


def test_the_recipe_gives_the_same_bytes_again_with_the_sensors(log: Path, run: Run, tmp_path: Path) -> None:
    first = run("clean", log, "-o", "out.csv", "--sensors", "s.toml")
    again = run("clean", log, "-o", "again.csv", "--sensors", "s.toml", "--recipe", "out.csv.recipe.toml")
    assert first.returncode == again.returncode, again.stderr
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "out.csv").read_bytes()
    without = run("clean", log, "-o", "without.csv", "--recipe", "out.csv.recipe.toml")
    assert without.returncode == 2
    assert not (tmp_path / "without.csv").exists()


def test_the_zero_is_as_uncertain_in_the_unit_asked_for(log: Path, run: Run, tmp_path: Path) -> None:
    ran = run("tune", log, "-o", "r.toml", "--sensors", "s.toml", "--unit", "pull=kN", "--channels", "pull")
    assert ran.returncode == 0, ran.stderr
    (pull,) = tomllib.loads((tmp_path / "r.toml").read_text())["channel"]
    assert (pull["name"], pull["unit"]) == ("pull (kN)", "kN")
    assert pull["calibration"] == {"relative_std": pytest.approx(0.005), "offset_std": pytest.approx(3e-3)}


def test_the_other_commands_take_sensors(log: Path, run: Run) -> None:
    shown = run("inspect", log, "--sensors", "s.toml", "--json")
    assert json.loads(shown.stdout)["columns"][1]["name"] == "pull (N)"
    noise = run("noise", log, "--sensors", "s.toml", "--channels", "pull", "--json")
    compared = run("compare", log, "--sensors", "s.toml", "--channels", "pull", "--json")
    for ran in (noise, compared):
        assert ran.returncode == 0, ran.stderr
        (channel,) = json.loads(ran.stdout)["channels"]
        assert (channel["name"], channel["unit"]) == ("pull (N)", "N")


MISTAKES = {
    "no file": (None, "The sensor file s.toml cannot be read: No such file"),
    "no channel": (CELL.replace('"pull"', '"push"'), "--sensors names 'push', which is not a column; the columns are"),
    "a unit": (CELL.replace('"mV"', '"mV/V"'), "--sensors expects 'pull (V)' in mV/V"),
    "no TOML": ("[[sensor", "is not TOML"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_sentences(log: Path, run: Run, tmp_path: Path, mistake: str) -> None:
    text, sentence = MISTAKES[mistake]
    (tmp_path / "s.toml").unlink()
    if text is not None:
        (tmp_path / "s.toml").write_text(text)
    ran = run("clean", log, "-o", "out.csv", "--sensors", "s.toml")
    assert ran.returncode == 2
    assert sentence in ran.stderr
    assert "Traceback" not in ran.stderr
    assert {path.name for path in tmp_path.iterdir()} <= {"log.csv", "s.toml"}
