"""What was done to time is told by the commands, and the column itself is written as it was."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pyarrow import csv

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
