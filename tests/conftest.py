"""A recording to try commands on, a way to run them as a person does, tables of files; no clock fails a property."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does: threads of small matrices only wait

import numpy as np
import pytest
from hypothesis import settings

from forked import can_fork, command
from spark_settings import quick_spark, run_here, spark_environment

__all__ = ["quick_spark", "run_here", "spark_environment"]

settings.register_profile("becalm", deadline=None)  # a shared machine stands still at times: that fails no test
settings.load_profile("becalm")

Run = Callable[..., subprocess.CompletedProcess[str]]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with files that wait long; leave Spark out where there is no Java, but not in CI, where there must be."""
    files = {mark: {item.path for item in items if item.get_closest_marker(mark)} for mark in ("spark", "slow")}
    items.sort(key=lambda item: (item.path not in files["spark"], item.path not in files["slow"]))
    if shutil.which("java") or {"CI", "JAVA_HOME"} & os.environ.keys():
        return
    for item in items:
        if item.get_closest_marker("spark"):
            item.add_marker(pytest.mark.skip(reason="Spark needs Java 17: install Debian's openjdk-17-jre-headless"))


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Write a CSV of 400 rows at 100 Hz: a ramp and a random walk, both noisy, and a column of text."""
    rng = np.random.default_rng(4)
    t = np.arange(400) / 100
    ramp = 2 * t + rng.normal(0, 0.1, t.size)
    walk = np.cumsum(rng.normal(0, 0.1, t.size)) + rng.normal(0, 0.2, t.size)
    path = tmp_path / "drive.csv"
    rows = [f"{t[k]:.2f},{ramp[k]:.6f},gear {k // 100},{walk[k]:.6f}" for k in range(t.size)]
    path.write_text("time_s,ramp (m/s),note,walk\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def tables() -> Iterator[Callable[[Path], Any]]:
    """Look into files, at their tables, and close them at the end."""
    from becalm.files.registry import read_tables  # not before it is needed

    with ExitStack() as stack:

        def look(path: Path) -> Any:
            found = read_tables(path)
            for table in found:
                stack.callback(table.rows.close)
            return found

        yield look


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Run becalm in a process of its own, in an empty folder."""

    def becalm(*words: object, **more: object) -> subprocess.CompletedProcess[str]:
        arguments, environment = [*map(str, words)], {**os.environ, "COLUMNS": "200"}
        if not more.keys() - {"input"} and can_fork(environment):
            return command(arguments, tmp_path, environment, str(more.get("input", "")))
        ran: subprocess.CompletedProcess[str] = subprocess.run(
            [sys.executable, "-m", "becalm", *arguments],
            capture_output=True, text=True, cwd=tmp_path, env=environment, check=False, **more,
        )  # type: ignore[call-overload]  # fmt: skip
        return ran

    return becalm
