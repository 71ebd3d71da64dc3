"""The accuracy benchmark runs, and holds what the project promises of it."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "benchmarks" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_no_truth_tuned_classic_filter_beats_the_one_that_nobody_tuned() -> None:
    ratios = np.array([row["ratio"] for row in load("accuracy").table()], dtype=float)
    assert len(ratios) == 14
    assert ratios.max() <= 1.01
    assert np.exp(np.log(ratios).mean()) <= 0.89


@pytest.mark.slow
@pytest.mark.parametrize("words", [["peers.py", "--quick"], ["large_files.py", "--rows", "20000", "--repeats", "1"]])
def test_a_benchmark_runs_and_agrees(words: list[str], tmp_path: Path) -> None:
    """Small and untimed; peers that are not installed are named and left out."""
    page = tmp_path / "page.md"
    script = str(ROOT / "benchmarks" / words[0])
    ran = subprocess.run(
        [sys.executable, script, *words[1:], "-o", str(page)], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert "becalm" in page.read_text(encoding="utf-8")
