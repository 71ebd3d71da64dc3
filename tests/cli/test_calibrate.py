"""An accelerometer calibrated from the command line: the truth is found again, and --sensors takes what is written."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from becalm.cleaning.sensor_files.sensor_file import load_sensors
from becalm.core.arrays import Floats
from becalm.sensors.record import convert_readings

Run = Callable[..., subprocess.CompletedProcess[str]]
DATA = Path(__file__).parents[2].parent / "shared" / "data"
TRUTH = np.array([[0.0100, 1e-4, -5e-5], [0.0, 0.0102, 2e-4], [0.0, 0.0, 0.0099]])  # m/s^2 per mV
BIAS = np.array([1650.0, 1640.0, 1665.0])
G0 = 9.80665
RATE_HZ = 50


def readings(gravity: float) -> Floats:
    """Return mV of 18 poses of four seconds each, with half a second of turning between them."""
    rng = np.random.default_rng(11)
    corners = [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if abs(x) + abs(y) + abs(z) != 2]
    poses = np.array([corner for corner in corners if any(corner)] + [[1, 2, 0], [0, -1, 2], [-2, 0, 1], [1, -1, -3]])
    blocks = []
    for pose in poses / np.linalg.norm(poses, axis=1, keepdims=True):
        blocks += [np.tile(pose, (4 * RATE_HZ, 1)), rng.normal(0, 1, (RATE_HZ // 2, 3))]
    a = gravity * np.concatenate(blocks)
    return np.asarray(a @ np.linalg.inv(TRUTH).T + BIAS + rng.normal(0, 0.5, a.shape))


def write(path: Path, columns: Floats, names: str) -> Path:
    rows = np.column_stack([np.arange(len(columns)) / RATE_HZ, columns])
    np.savetxt(path, rows, delimiter=",", header=f"time_s,{names}", comments="", fmt="%.8g")
    return path


@pytest.fixture
def laid_down(tmp_path: Path) -> Path:
    return write(tmp_path / "poses.csv", readings(9.81), "ax (mV),ay (mV),az (mV)")


def test_the_truth_is_found_and_read_back_to_the_same_numbers(laid_down: Path, run: Run, tmp_path: Path) -> None:
    ran = run("calibrate", laid_down, "-o", "s.toml", "--gravity", "9.81", "--json")
    assert ran.returncode == 0, ran.stderr
    told = json.loads(ran.stdout)
    assert (told["raw_unit"], told["unit"], told["rests"]) == ("mV", "m/s^2", 18)
    error, std = np.array(told["correction"]) - TRUTH, np.array(told["correction_std"])
    assert (np.abs(error) <= 4 * std).all()
    assert (np.abs(np.array(told["bias"]) - BIAS) < 4 * np.array(told["bias_std"])).all()
    assert told["spread_after"] < told["error_held_out"] < told["spread_before"] / 5
    (record,) = load_sensors(tmp_path / "s.toml")
    columns = readings(9.81)
    expected = (columns - np.array(told["bias"])) @ np.array(told["correction"]).T
    found = convert_readings(record, dict(zip(record.channels, columns.T, strict=True)))
    np.testing.assert_allclose(np.column_stack(list(found.values())), expected, rtol=0, atol=1e-11)
    assert np.array(record.relative_stds) == pytest.approx(np.array(told["scale_uncertainty_percent"]) / 200)
    assert record.offset_std == pytest.approx(told["zero_uncertainty"] / 2)
    assert record.sheet.calibrated is not None
    for said in ("18 rests found.", "before (with one factor for all axes, and the best zero)", "--sensors s.toml"):
        assert said in ran.stderr
    shown = run("inspect", laid_down, "--sensors", "s.toml", "--json")
    assert [column["unit"] for column in json.loads(shown.stdout)["columns"]] == ["s", "m/s^2", "m/s^2", "m/s^2"]


def test_an_accelerometer_in_g_is_bettered_in_g(run: Run, tmp_path: Path) -> None:
    file = write(tmp_path / "g.csv", (readings(G0) - BIAS - 5.0) * 0.01 / G0, "x (g),y (g),z (g)")
    ran = run("calibrate", file, "-o", "s.toml", "--unit", "g", "--json")
    assert ran.returncode == 0, ran.stderr
    told = json.loads(ran.stdout)
    assert (told["raw_unit"], told["unit"]) == ("g", "g")
    np.testing.assert_allclose(np.diag(told["correction"]), [1.0, 1.02, 0.99], atol=1e-3)
    assert "g before (as read)" in ran.stderr
    (record,) = load_sensors(tmp_path / "s.toml")
    assert (record.raw_unit, record.unit) == ("g", "g")


def test_gravity_that_was_not_said_is_uncertain(laid_down: Path, run: Run) -> None:
    said, unsaid = (
        json.loads(run("calibrate", laid_down, "-o", "s.toml", "--json", *words).stdout)
        for words in (["--gravity", str(G0)], [])
    )
    assert said["correction"] == unsaid["correction"]
    added = np.square(unsaid["scale_uncertainty_percent"]) - np.square(said["scale_uncertainty_percent"])
    np.testing.assert_allclose(added, (200 * (9.832 - 9.780) / np.sqrt(12) / G0) ** 2, rtol=1e-9)


MISTAKES = {
    "too many": ("a,b,c,d", ["--channels", "a,b,c,d"], "4 channels came (a, b, c, d); an accelerometer has three axes"),
    "a unit": ("a,b,c,d", ["--channels", "a,b,c", "--unit", "ft/s^2"], "--unit ft/s^2 is not a unit for a calibration"),
    "gravity": ("a,b,c,d", ["--channels", "a,b,c", "--gravity", "-9.81"], "--gravity"),
    "no rest": ("a,b,c,d", ["--channels", "a,b,d"], "rests were found, but 10 are needed"),
    "mixed": ("a (V),b (mV),c (mV),d", ["--channels", "a,b,c"], "The channels are in V, mV; all three must be in one"),
    "itself": ("a,b,c,d", ["-o", "poses.csv"], "is the input itself"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_a_sentence_and_writes_nothing(mistake: str, run: Run, tmp_path: Path) -> None:
    names, words, sentence = MISTAKES[mistake]
    columns = readings(G0)
    motion = np.cumsum(np.random.default_rng(2).normal(size=len(columns)))
    file = write(tmp_path / "poses.csv", np.column_stack([columns, motion]), names)
    before = file.read_bytes()
    ran = run("calibrate", file, *([] if "-o" in words else ["-o", "s.toml"]), *words)
    assert ran.returncode == 2
    assert sentence in ran.stderr
    assert "Traceback" not in ran.stderr
    assert file.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["poses.csv"]


def test_a_real_accelerometer_is_calibrated_and_its_counts_become_accelerations(run: Run, tmp_path: Path) -> None:
    file = DATA / "imu_tk" / "xsens_acc.mat.txt.gz"
    if not file.exists():
        pytest.skip(f"{file} is not here")
    ran = run("calibrate", file, "-o", "s.toml", "--json")
    assert ran.returncode == 0, ran.stderr
    told = json.loads(ran.stdout)
    assert told["raw_unit"] == "counts"
    assert 10 * told["error_held_out"] < told["spread_before"]
    noise = run("noise", file, "--sensors", "s.toml", "--json")
    assert noise.returncode == 0, noise.stderr
    assert {channel["unit"] for channel in json.loads(noise.stdout)["channels"]} == {"m/s^2"}
