"""What was done to time is told by the commands, and the column itself is written as it was."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pyarrow import csv

from becalm.errors import UsageError

Run = Callable[..., subprocess.CompletedProcess[str]]


def test_a_wrap_is_told_and_the_column_kept(run: Run, tmp_path: Path) -> None:
    ticks = (100 + 5000 * np.arange(3000)) % 65_536
    values = np.sin(np.arange(3000) / 80) + np.random.default_rng(1).normal(0, 0.1, 3000)
    table = np.column_stack([ticks, values])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="time_us,force", comments="", fmt=["%d", "%.5f"])
    said = "The counter of 'time_us' wraps at 65536; 228 wraps were undone."
    seen = run("inspect", tmp_path / "log.csv", "--json")
    assert json.loads(seen.stdout)["notes"] == [said]
    ran = run("clean", tmp_path / "log.csv", "-o", "out.csv")
    assert ran.returncode == 0, ran.stderr
    assert said in ran.stderr.replace("\n", " ")
    written = csv.read_csv(tmp_path / "out.csv")
    np.testing.assert_array_equal(np.asarray(written["time_us"]), ticks)


def jittered(path: Path) -> None:
    rng = np.random.default_rng(3)
    stamps = np.sort(np.arange(3000) / 200 + rng.normal(0.0, 0.0003, 3000))
    table = np.column_stack([stamps, np.sin(5 * stamps) + rng.normal(0, 0.001, 3000)])
    np.savetxt(path, table, delimiter=",", header="time_s,force", comments="", fmt=["%.7f", "%.6f"])


def test_stamps_as_written_and_jitter_are_kept_in_the_recipe(run: Run, tmp_path: Path) -> None:
    jittered(tmp_path / "log.csv")
    asked = ("--stamps", "as-written", "--time-jitter", "500us")
    ran = run("clean", tmp_path / "log.csv", "-o", "out.csv", *asked, "--json")
    assert ran.returncode in (0, 4), ran.stderr
    assert "jitter by" not in ran.stderr
    assert "An uncertainty of 500 us in time increases sigma by up to" in ran.stderr.replace("\n", " ")
    told = json.loads(ran.stdout)["channels"][0]["timing_share"]
    assert told > 0.01
    recipe = tmp_path / "out.csv.recipe.toml"
    assert 'stamps = "as-written"' in recipe.read_text()
    again = run("clean", tmp_path / "log.csv", "-o", "again.csv", "--recipe", recipe)
    assert again.returncode == ran.returncode, again.stderr
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "out.csv").read_bytes()
    assert (tmp_path / "again.csv.recipe.toml").read_text() == recipe.read_text()
    mended = run("clean", tmp_path / "log.csv", "-o", "mended.csv", "--recipe", recipe, "--stamps", "mended")
    assert "jitter by" in mended.stderr.replace("\n", " ")
    assert "stamps" not in (tmp_path / "mended.csv.recipe.toml").read_text().partition("[[channel]]")[0]


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--stamps", "raw", "--stamps raw is unknown; write --stamps as-written or --stamps mended."),
        ("--time-jitter", "50", "--time-jitter 50 is not a time; write a positive number and then s, ms or us: 50us."),
        ("--time-jitter", "0us", "--time-jitter 0us is not a time"),
    ],
)
def test_what_cannot_be_read_is_said(option: str, value: str, said: str, run: Run, tmp_path: Path) -> None:
    jittered(tmp_path / "log.csv")
    ran = run("clean", tmp_path / "log.csv", "-o", "out.csv", option, value)
    assert ran.returncode == UsageError.exit_code
    assert said in ran.stderr.replace("\n", " ")
    assert not (tmp_path / "out.csv").exists()
