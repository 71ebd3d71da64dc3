"""The benchmarks run, and hold what the project promises of them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import accuracy
import large_files
from forked import command

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.parametrize(("causal", "noise", "mean", "worst"), [(True, 0.30, 0.80, 1.01), (False, 0.05, 0.95, 1.05)])
def test_no_truth_tuned_classic_filter_beats_the_one_that_nobody_tuned(
    causal: bool, noise: float, mean: float, worst: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All signals, each mode at the noise at which becalm's lead is smaller; both are in docs/accuracy.md."""
    monkeypatch.setattr(accuracy, "NOISES", (noise,))
    ratios = np.array([row["ratio"] for row in accuracy.table(causal)], dtype=float)
    assert len(ratios) == 7
    assert ratios.max() <= worst
    assert np.exp(np.log(ratios).mean()) <= mean


def page_of(folder: Path, *words: str) -> str:
    """Run a benchmark, and return the page it writes; it fails where numbers do not agree."""
    page = folder / "page.md"
    command = [sys.executable, str(ROOT / "benchmarks" / words[0]), *words[1:], "-o", str(page)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    return page.read_text(encoding="utf-8")


def rows_of(page: str) -> list[dict[str, str]]:
    """Read the table of a page."""
    lines = [[cell.strip() for cell in line[2:-1].split("|")] for line in page.splitlines() if line.startswith("| ")]
    return [dict(zip(lines[0], cells, strict=True)) for cells in lines[1:]]


BESIDE_PEERS = {
    "filter, 2 states, 1 channel",
    "filter, 3 states, 1 channel",
    "filter, 3 states, 3 channels",
    "filter, 50 records at once, 2 states",
    "smoother, 2 states, signal only",
    "smoother, 2 states, signal and sigma",
    "log-likelihood, 2 states",
    "one reading a call, 2 states",
    "blocks of 100, 2 states",
    "growth with length, 2 states",
    "growth with channels, 2 states",
    "tuning one channel",
}


@pytest.mark.slow
def test_the_peers_run_and_agree(tmp_path: Path) -> None:
    """Small and untimed; peers that are not installed are named and left out, becalm's own rows are all there."""
    rows = rows_of(page_of(tmp_path, "peers.py", "--quick"))
    assert {row["job"] for row in rows if "becalm" in row["rival"]} == BESIDE_PEERS
    differences = {(row["job"], row["rival"]): row["differs"] for row in rows if row["differs"]}
    assert {
        ("one reading a call, 2 states", "**becalm**, `step`"),
        ("blocks of 100, 2 states", "**becalm**, `run`"),
    } <= (differences.keys())
    assert all(float(cell.strip("*")) <= 1e-6 for cell in differences.values()), differences


@pytest.mark.slow
def test_a_journal_gives_back_what_was_written(tmp_path: Path) -> None:
    """Small and untimed; the benchmark itself compares every number, and fails where one differs."""
    page = page_of(tmp_path, "journal_writing.py", "--seconds", "2", "--repeats", "1")
    assert [row["block"] for row in rows_of(page)] == ["0.05 s", "1 s", "10 s"]
    assert "Rolled into Parquet" in page
    assert "Every number was read again as it was kept." in page


@pytest.mark.slow
def test_large_files_are_cleaned_as_small_recordings_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Small and untimed; the benchmark itself compares rows and numbers, and fails where they differ."""
    alone, forked = large_files.run, []

    def run(words: list[str]) -> large_files.Ran:
        if words[:2] != ["-m", "becalm"]:
            return alone(words)
        forked.append(command(words[2:], tmp_path, {**os.environ, "COLUMNS": "200"}))
        return large_files.Ran(1.0, 1.0, forked[-1].returncode == 0)

    monkeypatch.setattr(large_files, "run", run)
    monkeypatch.setattr(large_files, "CHANNELS", 2)
    page = f"{large_files.table(5_000, 1)}\n{large_files.compare()}"
    assert [row["job"] for row in rows_of(page)] == [
        "pyarrow: read and write",
        "becalm clean, causal",
        "becalm clean, smoothed",
    ]
    assert "Of 20,000 rows every number is that of `becalm.clean`" in page
    assert "exit code 4" not in page
    assert [ran.returncode for ran in forked] == [0] * 8
