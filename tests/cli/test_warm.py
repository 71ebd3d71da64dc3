"""`becalm warm` compiles once, says where it keeps what it made, and leaves nothing for the first clean."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import becalm
from becalm.core.warming import warm

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "becalm"
COMPILED_BY_MAKE = ROOT / ".venv" / "kernels"

OF_MOTIONS = ("forward", "backward", "gate", "late", "live run", "live step")

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def fresh(tmp_path: Path) -> Run:
    """Run a copy of becalm, of which nothing was compiled."""
    site = tmp_path / "site"
    shutil.copytree(SOURCE, site / "becalm", ignore=shutil.ignore_patterns("__pycache__"))

    def becalm(*words: object, **more: str) -> subprocess.CompletedProcess[str]:
        environment = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA", "XDG"))}
        environment |= {"PYTHONPATH": str(site), "COLUMNS": "200"} | more
        command = [sys.executable, "-m", "becalm", *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False)

    return becalm


@pytest.fixture
def levels(tmp_path: Path) -> Path:
    """A file of levels that hold and jump."""
    rng, path = np.random.default_rng(1), tmp_path / "levels.csv"
    z = np.repeat(4 * rng.normal(size=10), 600) + rng.normal(size=6000)
    np.savetxt(path, np.column_stack([np.arange(6000) / 100, z]), delimiter=",", header="time,a", comments="")
    return path


def kernels(folder: Path) -> list[Path]:
    return list(folder.rglob("*.nbc"))


def test_where_nothing_can_be_kept_it_says_so(fresh: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    (tmp_path / "site" / "becalm" / "core" / "__pycache__").write_text("", encoding="utf-8")
    ran = fresh("warm", XDG_CACHE_HOME=str(tmp_path / "file"))
    assert ran.returncode == 2
    assert "NUMBA_CACHE_DIR" in ran.stderr
    assert "Traceback" not in ran.stderr


def test_an_interpreter_that_may_not_compile_is_told(fresh: Run) -> None:
    ran = fresh("warm", NUMBA_DISABLE_JIT="1")
    assert ran.returncode == 2, ran.stderr
    assert ran.stderr.startswith("becalm: NUMBA_DISABLE_JIT is set")
    assert "Traceback" not in ran.stderr


def test_cleaning_a_drive_compiles_nothing(fresh: Run, drive: Path) -> None:
    """It is one filter in C for each channel, compiled with becalm itself."""
    for mode in ([], ["--causal"]):
        ran = fresh("clean", drive, "-o", "out.csv", *mode, NUMBA_DISABLE_JIT="1")
        assert ran.returncode in (0, 4), ran.stderr
        assert "Traceback" not in ran.stderr


@pytest.fixture
def warmed(fresh: Run, tmp_path: Path) -> Path:
    """Compile ahead beside the copy; what `make` has compiled already of the same sources is taken as it is."""
    beside = tmp_path / "site" / "becalm" / "core" / "__pycache__"
    beside.mkdir()
    for kernel in COMPILED_BY_MAKE.glob("*.nbc"):
        shutil.copy(kernel, beside)
    ran = fresh("warm")
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout == ""
    assert str(beside) in ran.stderr.splitlines()[-1]
    return beside


@pytest.mark.slow
def test_warm_leaves_nothing_to_compile(fresh: Run, drive: Path, levels: Path, warmed: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    again = fresh("warm", NUMBA_CACHE_DIR=str(cache))
    assert again.returncode == 0, again.stderr
    assert len(again.stderr.splitlines()) == 1
    assert "already" in again.stderr
    for mode in ([], ["--causal"], ["--lag", "1s"]):
        for file in (drive, levels):
            ran = fresh("clean", file, "-o", "out.csv", *mode, NUMBA_CACHE_DIR=str(cache))
            assert ran.returncode in (0, 4), ran.stderr
            assert ("switching" in ran.stderr) == (file == levels)
    assert not kernels(cache)


@pytest.mark.slow
def test_warm_names_what_it_compiles(fresh: Run, warmed: Path) -> None:
    for kernel in warmed.glob("*kernel_gate.find_outliers*"):
        kernel.unlink()
    *compiled, where = fresh("warm").stderr.splitlines()
    assert sorted(line.partition(":")[0] for line in compiled) == [
        f"gate, {states} state{'s' * (states > 1)}" for states in range(1, 7)
    ]
    assert str(warmed) in where


@pytest.mark.slow
def test_every_kernel_of_a_channel_is_warmed() -> None:
    assert [(kernel.name, kernel.states) for kernel in warm()] == [
        (kernel, states) for states in (1, 2, 3, 4, 5, 6) for kernel in OF_MOTIONS
    ]


@pytest.mark.slow
def test_three_first_runs_at_once(fresh: Run, drive: Path, tmp_path: Path) -> None:
    assert fresh("--help").returncode == 0
    recipe = tmp_path / "drive.toml"
    recipe.write_text(becalm.tune(becalm.read(drive), causal=True).to_toml(), encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "site"), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    started = [
        subprocess.Popen(
            [sys.executable, "-m", "becalm", "clean", drive, "-o", tmp_path / f"out{k}.csv", "--recipe", recipe],
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        for k in range(3)
    ]
    for process in started:
        said = process.communicate()[1]
        assert process.returncode in (0, 4), said
    outputs = {(tmp_path / f"out{k}.csv").read_bytes() for k in range(3)}
    assert len(outputs) == 1
