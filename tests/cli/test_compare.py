"""`becalm compare`: a table or JSON on stdout, and sentences for what cannot be compared."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """A random walk with noise, and its truth beside it."""
    rng = np.random.default_rng(5)
    truth = np.cumsum(0.1 * rng.normal(size=4000))
    for name, values in (("walk.csv", truth + rng.normal(size=4000)), ("truth.csv", truth)):
        table = np.column_stack([np.arange(4000) / 100, values])
        np.savetxt(tmp_path / name, table, delimiter=",", header="time_s,a (m/s^2)", comments="")
    return tmp_path / "walk.csv"


def test_a_person_sees_every_filter_at_equal_noise_and_equal_lag(run: Run, walk: Path) -> None:
    ran = run("compare", walk, "--causal")
    assert ran.returncode == 0, ran.stderr
    lines = ran.stdout.splitlines()
    assert lines[0] == "a (m/s^2): The model describes the signal."
    assert lines[2].startswith("becalm ")
    assert sum("equal lag" in line for line in lines) == 8
    assert "rms error" not in ran.stdout
    assert "…" not in ran.stdout
    assert "best with truth" not in ran.stdout


def test_with_truth_errors_are_told_as_json(run: Run, walk: Path) -> None:
    ran = run("compare", walk, "--truth", "truth.csv", "--json", "--causal")
    assert ran.returncode == 0, ran.stderr
    (channel,) = json.loads(ran.stdout)["channels"]
    errors = {(one["name"], one["rule"]): one["rms_error"] for one in channel["filters"]}
    assert channel["unit"] == "m/s^2"
    assert 0 < errors["becalm", ""] < 1.05 * min(errors.values())
    assert len(errors) == len(channel["filters"])


def test_a_truth_of_other_rows_or_channels_is_refused(run: Run, walk: Path, tmp_path: Path) -> None:
    lines = (tmp_path / "truth.csv").read_text(encoding="utf-8").splitlines()
    (tmp_path / "short.csv").write_text("\n".join(lines[:3000]) + "\n", encoding="utf-8")
    (tmp_path / "other.csv").write_text("\n".join(["time_s,b", *lines[1:]]) + "\n", encoding="utf-8")
    for truth, said in (
        ("short.csv", "The truth has 2999 rows"),
        ("other.csv", "Give a truth of the same channels"),
        ("none.csv", "none.csv"),
    ):
        ran = run("compare", walk, "--truth", truth)
        assert ran.returncode != 0
        assert said in ran.stderr
        assert "Traceback" not in ran.stderr


def test_a_rate_that_is_said_holds_for_the_truth_too(run: Run, walk: Path, tmp_path: Path) -> None:
    for name in ("walk.csv", "truth.csv"):
        rows = (tmp_path / name).read_text(encoding="utf-8").splitlines()[:500]
        (tmp_path / name).write_text("\n".join(row.split(",")[1] for row in rows) + "\n", encoding="utf-8")
    ran = run("compare", walk, "--truth", "truth.csv", "--rate", "100")
    assert ran.returncode == 0, ran.stderr
    assert "best with truth" in ran.stdout


def test_a_file_whose_name_is_no_text_has_a_page(run: Run, walk: Path, tmp_path: Path) -> None:
    strange = os.fsdecode(b"w\xe4lk.csv")
    rows = walk.read_text(encoding="utf-8").splitlines()[:500]
    (tmp_path / strange).write_text("\n".join(rows) + "\n", encoding="utf-8")
    ran = run("compare", strange, "-o", "compared")
    assert ran.returncode == 0, ran.stderr
    assert "<h1>w" in (tmp_path / "compared" / "compare.html").read_text(encoding="utf-8")


def test_what_is_not_known_of_the_truth_makes_no_number_that_json_has_not(run: Run, walk: Path, tmp_path: Path) -> None:
    rows = (tmp_path / "truth.csv").read_text(encoding="utf-8").splitlines()
    rows[300] = "2.99,inf"
    (tmp_path / "truth.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    ran = run("compare", walk, "--truth", "truth.csv", "--json")
    assert ran.returncode == 0, ran.stderr
    assert "Infinity" not in ran.stdout
    assert "NaN" not in ran.stdout
