"""Spark for tests: one JVM in each process of tests, which starts quickly and leaves no temporary file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

JAVA = "-XX:TieredStopAtLevel=1 -XX:+UseSerialGC -XX:-UsePerfData"
"""A JVM that lives for seconds: full compilation and parallel collection cost more than they save."""

Run = Callable[..., subprocess.CompletedProcess[str]]
_LOADED = Path(__file__).with_name("preloaded")


@pytest.fixture(scope="session")
def spark_environment() -> Iterator[dict[str, str]]:
    """Give the environment in which Spark starts; all of its temporary files go at the end."""
    with tempfile.TemporaryDirectory(prefix="s", ignore_cleanup_errors=True) as folder:  # sockets need a short path
        java = f"'{JAVA} -Djava.io.tmpdir={folder}'"
        settings = {
            "spark.driver.extraJavaOptions": java,
            "spark.executor.extraJavaOptions": java,
            "spark.local.dir": folder,
            "spark.python.daemon.module": "warm_pyspark.daemon",
        }
        words = [f"--conf {name}={value}" for name, value in settings.items()]
        yield {
            "PYSPARK_SUBMIT_ARGS": " ".join([*words, "pyspark-shell"]),
            "SPARK_LAUNCHER_OPTS": JAVA,
            "PYTHONPATH": os.pathsep.join([str(_LOADED), *filter(None, [os.environ.get("PYTHONPATH")])]),
        }


@pytest.fixture(scope="module")
def quick_spark(spark_environment: dict[str, str]) -> Iterator[None]:
    """Let Spark start quickly, in this process and in commands."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in spark_environment.items():
            patch.setenv(name, value)
        yield


@pytest.fixture
def run_here(
    quick_spark: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Iterator[Run]:
    """Run a command of becalm in this very process, whose JVM is there already."""
    from becalm.cli import main, stopping  # not before it is needed

    def becalm(*words: object) -> subprocess.CompletedProcess[str]:
        monkeypatch.setattr(sys, "argv", ["becalm", *map(str, words)])
        monkeypatch.chdir(tmp_path)
        capfd.readouterr()
        code = main._run()
        return subprocess.CompletedProcess([*map(str, words)], code, *capfd.readouterr())

    before = {number: signal.getsignal(number) for number in stopping._SIGNALS}
    yield becalm
    for number, handler in before.items():
        signal.signal(number, handler)
