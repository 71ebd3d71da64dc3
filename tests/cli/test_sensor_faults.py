"""Faults of sensors, from a CSV to verdicts, sentences and numbers: each at its place, nothing lost."""

from __future__ import annotations

import json
import subprocess
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.csv
import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]
ROWS, GAP, REPEATED = 6000, 4000, 5000
STUCK, SPIKES = slice(2000, 2300), slice(50, None, 200)
NAMES = ["stuck", "clipped", "spiky", "healthy"]


def walk(seed: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(0, 0.05, ROWS)) + rng.normal(0, 1.0, ROWS)


@pytest.fixture
def faulty(tmp_path: Path) -> Path:
    """Write 6000 rows at 100 Hz: a stuck channel, a clipped one, one with spikes, a healthy one; a gap, a repeat."""
    columns = {name: walk(seed) for seed, name in enumerate(NAMES)}
    columns["stuck"][STUCK] = columns["stuck"][STUCK.start]
    columns["clipped"] = np.minimum(columns["clipped"] + 5 * np.sin(np.arange(ROWS) / 300), 4.0)
    columns["spiky"][SPIKES] += 25.0
    t = np.arange(ROWS) / 100 + 1.0 * (np.arange(ROWS) >= GAP)
    t[REPEATED] = t[REPEATED - 1]
    cells = zip(t, *columns.values(), strict=True)
    text = "\n".join(",".join([f"{row[0]:.2f}", *(f"{value:.4f}" for value in row[1:])]) for row in cells)
    path = tmp_path / "faulty.csv"
    path.write_text(f"time_s,{','.join(NAMES)}\n{text}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("mode", [[], ["--causal"], ["--lag", "100ms"]])
def test_each_fault_is_told_at_its_place(mode: list[str], faulty: Path, run: Run, tmp_path: Path) -> None:
    ran = run("clean", faulty, "-o", "out.csv", "--verdicts", "--json", *mode)
    assert ran.returncode == 0, ran.stderr
    table, raw = (pyarrow.csv.read_csv(path) for path in (tmp_path / "out.csv", faulty))
    assert table.num_rows == ROWS
    assert table["time_s"].equals(raw["time_s"])
    words = {name: np.array(table[f"{name}_verdict"].to_pylist()) for name in NAMES}
    assert {word[GAP] for word in words.values()} == {"gap"}
    assert {word[REPEATED] for word in words.values()} == {"repeated"}
    channels = {channel["name"]: channel for channel in json.loads(ran.stdout)["channels"]}
    recipe = tomllib.loads((tmp_path / "out.csv.recipe.toml").read_text(encoding="utf-8"))
    limits = {channel["name"]: channel["limits"] for channel in recipe["channel"]}
    from_row = STUCK.start + (limits["stuck"]["stuck_readings"] - 1 if mode else 0)  # a smoother sees the whole run
    assert from_row < STUCK.start + 20
    assert np.flatnonzero(words["stuck"] == "stuck").tolist() == list(range(from_row, STUCK.stop))
    clipped = np.array(raw["clipped"]) == 4.0
    assert clipped.sum() > 100
    assert limits["clipped"]["high"] == 4.0
    assert (words["clipped"][clipped] == "clipped").all()
    assert not (words["clipped"][~clipped] == "clipped").any()
    if mode[:1] != ["--lag"]:
        assert set(words["spiky"][SPIKES]) == {"spike"}
    assert set(words["healthy"]) == {"used", "gap", "repeated"}
    for name in NAMES:
        told = {word: count for word, count in channels[name]["verdicts"].items() if count}
        assert told == dict(zip(*np.unique(words[name], return_counts=True), strict=True))
        faults = {fault["what"]: fault for fault in channels[name]["faults"]}
        assert faults["gap"]["first_row"] == GAP + 1
        assert faults["gap"]["first_s"] == pytest.approx(GAP / 100 + 1.0, abs=1e-3)
        assert np.isfinite(np.array(table[name])).all()
    fault = {fault["what"]: fault for fault in channels["stuck"]["faults"]}["stuck"]
    assert (fault["readings"], fault["first_row"]) == (STUCK.stop - from_row, from_row + 1)
    assert fault["found_within_s"] == pytest.approx(limits["stuck"]["stuck_readings"] / 100, rel=1e-3)
    assert "A stuck channel repeats its last reading" in ran.stderr
    assert any("Clipped readings show only" in sentence for sentence in channels["clipped"]["advice"])
    assert not any(fault["what"] == "stuck" for fault in channels["healthy"]["faults"])
    sigma = np.array(table["stuck_sigma"])
    assert sigma[STUCK.stop - 150] > 2 * sigma[1000], "what is stuck is predicted across"


def test_of_a_healthy_channel_nothing_is_said(run: Run, tmp_path: Path) -> None:
    rows = "\n".join(f"{k / 100:.2f},{value:.4f}" for k, value in enumerate(walk(7)))
    (tmp_path / "in.csv").write_text(f"time_s,a\n{rows}\n", encoding="utf-8")
    ran = run("clean", "in.csv", "-o", "out.csv", "--verdicts", "--json")
    assert ran.returncode == 0, ran.stderr
    (channel,) = json.loads(ran.stdout)["channels"]
    assert (channel["faults"], channel["advice"]) == ([], [])
    assert channel["verdicts"]["used"] == ROWS
    assert "a: " not in ran.stderr


def test_a_range_is_written_by_hand(faulty: Path, run: Run, tmp_path: Path) -> None:
    assert run("tune", faulty, "-o", "r.toml", "--channels", "healthy").returncode == 0
    text = (tmp_path / "r.toml").read_text(encoding="utf-8")
    (tmp_path / "r.toml").write_text(text.replace("[channel.limits]", "[channel.limits]\nhigh = 1.5"), encoding="utf-8")
    ran = run("clean", faulty, "-o", "out.csv", "--recipe", "r.toml", "--verdicts")
    assert ran.returncode in (0, 4), ran.stderr
    table, raw = (pyarrow.csv.read_csv(path) for path in (tmp_path / "out.csv", faulty))
    assert np.array_equal(np.array(table["healthy_verdict"]) == "clipped", np.array(raw["healthy"]) >= 1.5)
    (tmp_path / "r.toml").write_text(text.replace("[channel.limits]", "[channel.limits]\nlow = 2.0\nhigh = 1.5"))
    ran = run("clean", faulty, "-o", "new.csv", "--recipe", "r.toml")
    assert ran.returncode == 2
    assert "low is not below high" in ran.stderr
