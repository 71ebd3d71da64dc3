"""The cluster that `deploy/` describes, by its very files, on one machine: without the secret nothing is run."""

from __future__ import annotations

import os
import re
import shlex
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from configparser import RawConfigParser
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from becalm.fleet.recipes import open_book
from becalm.fleet.sensor_cleaning import clean_whole
from made import job_of, read_parts, recipe_of, same, table_of, walk, write_parts
from spark_settings import JAVA

pytestmark = [pytest.mark.slow, pytest.mark.spark]

DEPLOY = Path(__file__).parents[2] / "deploy" / "spark"
PLACE = Path(sys.executable).parent
PATIENCE_S = 60.0


class Cluster(NamedTuple):
    """Where it is, and what a job of its has around it."""

    master: str
    around: dict[str, str]


def started(unit: str, folder: Path, **told: object) -> list[str]:
    """Return the command of a unit, as systemd would run it, with becalm where it is here."""
    parser = RawConfigParser(strict=False, delimiters=("=",), comment_prefixes=("#",))
    parser.read_string((DEPLOY / unit).read_text(encoding="utf-8"))
    words = shlex.split(parser["Service"]["ExecStart"])
    known = {f"${{{name}}}": str(value) for name, value in told.items()} | {"%C": str(folder)}
    here = [word.replace("/opt/becalm/bin", str(PLACE)) for word in words]
    return [re.sub(r"\$\{\w+\}|%C", lambda found: known[found[0]], word) for word in here]


def settings(folder: Path, secret: str) -> dict[str, str]:
    """Write the settings; return what processes have around them."""
    text = (DEPLOY / "spark-defaults.conf").read_text(encoding="utf-8")
    assert "REPLACE-ME" in text
    folder.mkdir()
    here = text.replace("REPLACE-ME", secret).replace("/opt/becalm/bin", str(PLACE))
    (folder / "spark-defaults.conf").write_text(here, encoding="utf-8")
    around = {"SPARK_CONF_DIR": str(folder), "PYSPARK_PYTHON": sys.executable, "SPARK_LOCAL_IP": "127.0.0.1"}
    return {name: value for name, value in os.environ.items() if not name.startswith("SPARK")} | around


@contextmanager
def running(command: list[str], around: dict[str, str], log: Path, says: str) -> Iterator[None]:
    """Run a service until it is left, from when it says something on."""
    with log.open("wb") as told:
        process = subprocess.Popen(command, env=around, stdout=told, stderr=told, start_new_session=True)
        try:
            until = time.monotonic() + PATIENCE_S
            while says not in log.read_text(encoding="utf-8"):
                assert process.poll() is None, log.read_text(encoding="utf-8")
                assert time.monotonic() < until, log.read_text(encoding="utf-8")
                time.sleep(0.1)
            yield
        finally:
            process.terminate()
            process.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    around, master = settings(tmp_path / "conf", "of this test"), f"spark://127.0.0.1:{port}"
    here = {"ADDRESS": "127.0.0.1", "PAGE_PORT": 0}
    with ExitStack() as services:
        short = tempfile.TemporaryDirectory(prefix="s", ignore_cleanup_errors=True)  # as sockets need
        java = f"{JAVA} -Djava.io.tmpdir={services.enter_context(short)}"
        around |= dict.fromkeys(("SPARK_DAEMON_JAVA_OPTS", "SPARK_SUBMIT_OPTS", "SPARK_LAUNCHER_OPTS"), java)
        around |= {"SPARK_LOCAL_DIRS": short.name}
        for unit, told, says in (
            ("becalm-spark-master.service", {"PORT": port}, "New state: ALIVE"),
            ("becalm-spark-worker.service", {"MASTER": master, "CORES": 2, "MEMORY": "2g"}, "Successfully registered"),
        ):
            command = started(unit, tmp_path / "cache", **here, **told)
            services.enter_context(running(command, around, tmp_path / f"{unit}.log", says))
        yield Cluster(master, around)


def test_a_cluster_as_deploy_has_it_cleans_a_lake(cluster: Cluster, tmp_path: Path) -> None:
    for sensor in range(4):
        table = table_of(np.arange(20_000) / 100, a=walk(sensor, 20_000, holes=2))
        write_parts(tmp_path / "lake" / f"sensor={sensor}", table, (7000,))
    recipe = tmp_path / "r.toml"
    recipe.write_text(recipe_of("a").to_toml(), encoding="utf-8")
    words = ["fleet", "clean", "lake", "-o", "out", "--recipe", "r.toml", "--master", cluster.master]
    command = [sys.executable, "-m", "becalm", *words]
    ran = subprocess.run(command, cwd=tmp_path, env=cluster.around, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert "4 of 4 sensors are cleaned" in ran.stderr
    job, sensors = job_of(tmp_path / "lake", tmp_path / "alone", open_book(recipe))
    for one in sensors:
        clean_whole(job, one)
        assert same(read_parts(tmp_path / "out" / one.name), read_parts(tmp_path / "alone" / one.name))
    stranger = cluster.around | {"SPARK_CONF_DIR": settings(tmp_path / "another", "guessed")["SPARK_CONF_DIR"]}
    command[command.index("out")] = "stolen"
    refused = subprocess.run(command, cwd=tmp_path, env=stranger, capture_output=True, text=True, check=False)
    assert refused.returncode == 2, refused.stderr
    assert "Spark does not start on spark://" in refused.stderr
    assert not list((tmp_path / "stolen").rglob("*.parquet"))
