"""The command line's contract: columns, exit codes, JSON, recipes, nothing half-written."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

from becalm.cli.commands import demo
from becalm.installation import version
from becalm.studies import drive as drive_simulation

Run = Callable[..., subprocess.CompletedProcess[str]]


def test_clean_keeps_rows_and_columns_and_adds_sigma(run: Run, drive: Path, tmp_path: Path) -> None:
    ran = run("clean", drive, "-o", "out.csv", "--json")
    assert ran.returncode == 0, ran.stderr
    before, after = pyarrow.csv.read_csv(drive), pyarrow.csv.read_csv(tmp_path / "out.csv")
    assert after.column_names == ["time_s", "ramp (m/s)", "ramp (m/s)_sigma", "note", "walk", "walk_sigma"]
    assert after["time_s"].to_pylist() == before["time_s"].to_pylist()
    assert after["note"].to_pylist() == before["note"].to_pylist()
    truth = 2 * np.array(before["time_s"])
    raw, clean = np.array(before["ramp (m/s)"]), np.array(after["ramp (m/s)"])
    assert np.std(clean - truth) < 0.3 * np.std(raw - truth)
    assert (np.array(after["walk_sigma"]) > 0).all()


def test_json_is_one_object_with_what_was_promised(run: Run, drive: Path) -> None:
    ran = run("clean", drive, "-o", "out.csv", "--causal", "--json")
    told = json.loads(ran.stdout)
    assert told["mode"] == "causal"
    assert [channel["name"] for channel in told["channels"]] == ["ramp (m/s)", "walk"]
    promised = {"model", "order", "noise_std", "q_over_r", "bandwidth_hz", "lag_s", "log_likelihood", "whiteness_p"}
    for channel in told["channels"]:
        assert promised | {"nis_mean", "verdicts"} <= channel.keys()
        assert channel["verdicts"]["used"] == 400
    assert told["channels"][1]["noise_std"] == pytest.approx(0.2, rel=0.25)
    assert "\x1b" not in ran.stdout + ran.stderr


def test_a_recipe_gives_the_same_bytes_again(run: Run, drive: Path, tmp_path: Path) -> None:
    run("clean", drive, "-o", "first.csv")
    ran = run("clean", drive, "-o", "again.csv", "--recipe", "first.csv.recipe.toml")
    assert ran.returncode == 0, ran.stderr
    for ending in ("", ".recipe.toml"):
        first, again = tmp_path / f"first.csv{ending}", tmp_path / f"again.csv{ending}"
        assert first.read_bytes() == again.read_bytes()


@pytest.mark.parametrize("said", [["--rate", "50"], ["--time", "walk"], ["--causal"]], ids=lambda said: said[0])
def test_what_is_said_beside_a_recipe_is_in_the_new_one(said: list[str], run: Run, tmp_path: Path) -> None:
    t = np.arange(300) / 100
    a = np.random.default_rng(3).normal(size=300)
    rows = "".join(f"{t[k]:.2f},{2 * t[k]:.2f},{a[k]:.6f}\n" for k in range(300))
    (tmp_path / "in.csv").write_text(f"time_s,walk,a\n{rows}", encoding="utf-8")
    run("tune", "in.csv", "-o", "r.toml", "--channels", "a")
    ran = run("clean", "in.csv", "-o", "first.csv", "--recipe", "r.toml", *said)
    assert ran.returncode in (0, 4), ran.stderr
    run("clean", "in.csv", "-o", "again.csv", "--recipe", "first.csv.recipe.toml")
    for ending in ("", ".recipe.toml"):
        first, again = tmp_path / f"first.csv{ending}", tmp_path / f"again.csv{ending}"
        assert first.read_bytes() == again.read_bytes()


def test_tune_then_clean_is_clean(run: Run, drive: Path, tmp_path: Path) -> None:
    run("clean", drive, "-o", "one.csv")
    assert run("tune", drive, "-o", "r.toml").returncode == 0
    run("clean", drive, "-o", "two.csv", "--recipe", "r.toml")
    assert (tmp_path / "one.csv").read_bytes() == (tmp_path / "two.csv").read_bytes()


def test_channels_choose_and_the_others_pass_through(run: Run, drive: Path, tmp_path: Path) -> None:
    ran = run("clean", drive, "-o", "out.csv", "--channels", "ramp")
    assert ran.returncode == 0, ran.stderr
    before, after = pyarrow.csv.read_csv(drive), pyarrow.csv.read_csv(tmp_path / "out.csv")
    assert "walk_sigma" not in after.column_names
    assert after["walk"].to_pylist() == before["walk"].to_pylist()


def test_parquet_out_and_in(run: Run, drive: Path, tmp_path: Path) -> None:
    assert run("clean", drive, "-o", "out.parquet").returncode == 0
    assert run("clean", drive, "-o", "out.csv").returncode == 0
    table = pyarrow.parquet.read_table(tmp_path / "out.parquet")
    csv = pyarrow.csv.read_csv(tmp_path / "out.csv")
    np.testing.assert_array_equal(np.array(table["walk"]), np.array(csv["walk"]))
    again = run("clean", "out.parquet", "-o", "twice.parquet", "--channels", "walk")
    assert again.returncode in (0, 4), again.stderr


def test_inspect_tells_columns_and_rate(run: Run, drive: Path) -> None:
    ran = run("inspect", drive)
    assert ran.returncode == 0
    assert all(word in ran.stdout for word in ("time_s", "ramp (m/s)", "m/s", "note", "100"))
    told = json.loads(run("inspect", drive, "--json").stdout)
    assert told["rate_hz"] == pytest.approx(100.0)


def vibration(folder: Path, sweep_hz_per_s: float) -> None:
    """Write half a minute at 100 Hz of a vibration that begins at 17 Hz."""
    t = np.arange(3000) / 100
    phase = 2 * np.pi * (17 * t + sweep_hz_per_s * t**2 / 2)
    z = np.sin(phase) + 0.1 * np.random.default_rng(2).normal(size=t.size)
    rows = "\n".join(f"{a:.2f},{b:.6f}" for a, b in zip(t, z, strict=True))
    (folder / "v.csv").write_text(f"time_s,a\n{rows}\n", encoding="utf-8")


def test_a_vibration_that_changes_is_not_described_and_the_output_is_there(run: Run, tmp_path: Path) -> None:
    vibration(tmp_path, 0.5)
    ran = run("clean", "v.csv", "-o", "out.csv")
    assert ran.returncode == 4
    assert "does not describe" in ran.stderr
    assert len(pyarrow.csv.read_csv(tmp_path / "out.csv")) == 3000


def test_a_steady_vibration_is_a_tone(run: Run, tmp_path: Path) -> None:
    vibration(tmp_path, 0.0)
    ran = run("clean", "v.csv", "-o", "out.csv", "--json")
    assert ran.returncode == 0, ran.stderr
    assert "tones at 17 Hz" in ran.stderr
    (channel,) = json.loads(ran.stdout)["channels"]
    assert channel["tones_hz"] == [pytest.approx(17.0, abs=0.01)]
    assert "frequency_hz" in (tmp_path / "out.csv.recipe.toml").read_text(encoding="utf-8")
    again = run("clean", "v.csv", "-o", "again.csv", "--recipe", "out.csv.recipe.toml")
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "out.csv").read_bytes()


def test_demo_prints_figures_and_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A short drive; tests/house/test_pages.py runs the whole demonstration as README.md shows it."""
    monkeypatch.setattr(drive_simulation, "DURATION_S", 6.0)
    demo.run(tmp_path / "d")
    assert "acceleration_z" in capsys.readouterr().out
    assert {"drive.csv", "drive_clean.csv", "drive_clean.csv.recipe.toml"} <= {
        p.name for p in (tmp_path / "d").iterdir()
    }


def noisy(folder: Path) -> None:
    """Write ten seconds at 200 Hz of a walk in noise."""
    rng = np.random.default_rng(6)
    z = np.cumsum(0.1 * rng.normal(size=2000)) + rng.normal(size=2000)
    rows = "\n".join(f"{k / 200:.3f},{value:.6f}" for k, value in enumerate(z))
    (folder / "n.csv").write_text(f"time_s,a\n{rows}\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("dial", "kept"),
    [
        (["--bandwidth", "5Hz"], lambda told: told["bandwidth_hz"] == pytest.approx(5.0, rel=0.01)),
        (["--bandwidth", "0.004 kHz", "--causal"], lambda told: told["bandwidth_hz"] == pytest.approx(4.0, rel=0.01)),
        (["--max-lag", "30ms", "--causal"], lambda told: told["lag_s"] <= 0.0301),
        (["--noise-gain", "-12dB", "--causal"], lambda told: told["bandwidth_hz"] < 20.0),
    ],
)
def test_a_dial_is_turned(run: Run, tmp_path: Path, dial: list[str], kept: Callable[[dict[str, float]], bool]) -> None:
    noisy(tmp_path)
    ran = run("clean", "n.csv", "-o", "out.csv", "--json", *dial)
    assert ran.returncode in (0, 4), ran.stderr
    (channel,) = json.loads(ran.stdout)["channels"]
    assert kept(channel)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--bandwidth", "40"], "write a number and then Hz or kHz"),
        (["--max-lag", "5 parsecs", "--causal"], "--max-lag 5 parsecs is not a number with its unit"),
        (["--bandwidth", "40Hz", "--noise-gain", "-20dB"], "each determines the others"),
        (["--max-lag", "5ms"], "A smoother has no lag"),
        (["--bandwidth", "1kHz"], "less than 100 Hz, half the rate"),
        (["--bandwidth", "4Hz", "--recipe", "r.toml"], "give either --recipe, or options"),
    ],
)
def test_a_dial_that_cannot_be_turned_is_said(run: Run, tmp_path: Path, words: list[str], says: str) -> None:
    noisy(tmp_path)
    ran = run("clean", "n.csv", "-o", "out.csv", *words)
    assert ran.returncode == 2, ran.stderr
    assert says in " ".join(ran.stderr.split())
    assert not (tmp_path / "out.csv").exists()


def test_a_file_whose_time_jitters_is_shown(run: Run, tmp_path: Path) -> None:
    t = np.arange(300) / 100 + np.random.default_rng(5).uniform(0, 2e-3, 300)
    (tmp_path / "in.csv").write_text("time_s,a\n" + "".join(f"{at:.7f},{k % 7}\n" for k, at in enumerate(t)))
    ran = run("inspect", "in.csv")
    assert ran.returncode == 0, ran.stderr
    assert "jitter s" in ran.stdout


def test_the_version_is_told(run: Run) -> None:
    ran = run("--version")
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, f"becalm {version()}\n", "")
    assert version()
