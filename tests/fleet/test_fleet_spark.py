"""Spark itself: a cluster of two workers on this machine, killed in many ways, which changes nothing."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from threading import Thread

import numpy as np
import pyarrow.parquet as pq
import pytest

import becalm
from becalm.errors import InputError, UsageError
from becalm.fleet.recipes import open_book
from becalm.fleet.sensor_cleaning import clean_whole
from becalm.fleet.session import session
from made import Lake, Run, job_of, read_parts, recipe_of, same, table_of, walk, write_parts

pytestmark = [pytest.mark.slow, pytest.mark.spark, pytest.mark.usefixtures("quick_spark")]

CLUSTER = "local-cluster[2,1,1024]"
EXECUTOR, WORKER = "CoarseGrainedExecutorBackend", r"-m \w*pyspark\.daemon"
SENSORS, ROWS = 24, 40_000
LONG = "sensor=long"


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """Write a lake of usual sensors, a long one, and rubbish."""
    folder = tmp_path_factory.mktemp("fleet")
    for sensor in range(SENSORS):
        table = table_of(np.arange(ROWS) / 100, a=walk(sensor, ROWS, holes=sensor % 3))
        write_parts(folder / "lake" / f"sensor={sensor}", table, (ROWS // 3,))
    times_s = np.arange(8 * ROWS) / 100 + 12.0 * (np.arange(8 * ROWS) > 5 * ROWS)
    write_parts(folder / "lake" / LONG, table_of(times_s, a=walk(99, 8 * ROWS, holes=30)), (ROWS, 5 * ROWS + 7))
    (folder / "lake" / "sensor=rubbish").mkdir()
    (folder / "lake" / "sensor=rubbish" / "a.parquet").write_bytes(b"PAR1 and no end")
    (folder / "r.toml").write_text(recipe_of("a").to_toml(), encoding="utf-8")
    return Lake(folder / "lake", folder / "r.toml")


@pytest.fixture(scope="module")
def whole(lake: Lake) -> Path:
    """Clean every sensor as a whole, in this very process."""
    out = lake.root.parent / "whole"
    book = open_book(lake.recipe)
    job, sensors = job_of(lake.root, out, book)
    assert sum(clean_whole(job, sensor).state == "cleaned" for sensor in sensors) == SENSORS + 1
    return out


def command(lake: Lake, out: Path, master: str) -> list[str]:
    words = ["fleet", "clean", lake.root, "-o", out, "--recipe", lake.recipe, "--stretch", 65536, "--master", master]
    return [sys.executable, "-m", "becalm", *map(str, words)]


def begun(lake: Lake, out: Path, master: str = "local[2]") -> subprocess.Popen[str]:
    """Start a job in a group of processes of its own."""
    return subprocess.Popen(
        command(lake, out, master), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def finished(process: subprocess.Popen[str]) -> str:
    told, _ = process.communicate(timeout=300)
    assert process.returncode == 4, told  # one sensor is refused
    assert f"{SENSORS + 1} of {SENSORS + 2} sensors are cleaned" in told, told
    return told


def marks(out: Path) -> int:
    return len(list(out.glob("*/_becalm.json")))


def wait_until(process: subprocess.Popen[str], out: Path, count: int) -> None:
    """Wait until so many sensors are finished, while others are not."""
    while marks(out) < count and process.poll() is None:
        time.sleep(0.02)
    assert process.poll() is None, process.communicate()[0]


def as_it_would_have_been(lake: Lake, out: Path, whole: Path) -> None:
    names = sorted(path.name for path in lake.root.iterdir() if path.name != "sensor=rubbish")
    assert sorted(path.name for path in out.iterdir() if path.is_dir() and "=" in path.name) == names
    for name in names:
        assert same(read_parts(out / name), read_parts(whole / name)), name
        assert len(becalm.read(out / name)) == read_parts(whole / name).num_rows
    assert not list(out.rglob("*.part"))


def processes(pattern: str, group: int) -> Iterator[int]:
    """Find processes of a job by their command lines."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode("utf-8", "replace")
                if re.search(pattern, line) and os.getsid(int(entry.name)) == group:
                    yield int(entry.name)
            except OSError:  # it is gone
                continue


def killed(pids: Iterable[int]) -> int:
    """Kill processes; return how many of them were still there: a worker ends with its executor."""
    count = 0
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
            count += 1
    return count


def rows_of(place: Path) -> int | None:
    """Return how many rows a sensor's output has; None where it is not finished, which reading it says."""
    try:
        return len(becalm.read(place))
    except InputError:
        return None


def test_killed_workers_of_a_cluster_change_nothing(lake: Lake, whole: Path, tmp_path: Path) -> None:
    """Executors, workers and both are killed in one job, one kind after the other, while sensors are finished."""
    process, out = begun(lake, tmp_path / "out", CLUSTER), tmp_path / "out"
    for count, pattern, most in (
        (2, EXECUTOR, 1),
        (8, WORKER, None),
        (14, f"{EXECUTOR}|{WORKER}", None),
    ):
        wait_until(process, out, count)
        assert killed(list(processes(pattern, process.pid))[:most]), pattern
    assert "sensor=rubbish: " in finished(process)
    as_it_would_have_been(lake, out, whole)


def test_whatever_ends_a_job_the_next_one_takes_it_up(lake: Lake, whole: Path, tmp_path: Path) -> None:
    """What was finished stays, no half sensor is ever read, and no process is left."""
    out = tmp_path / "out"
    for count, end in ((2, killed_group), (6, interrupted), (10, terminated), (14, without_its_jvm)):
        process = begun(lake, out)
        wait_until(process, out, count)
        end(process)
        read = [rows_of(place) for place in out.glob("sensor=*")]
        assert len([rows for rows in read if rows is not None]) >= count - 2  # two that were at it have marks too
        assert {rows for rows in read if rows is not None} <= {ROWS, 8 * ROWS}
    told = finished(begun(lake, out))
    assert int(re.search(r"\((\d+) were finished before", told)[1]) >= 12  # type: ignore[index]
    as_it_would_have_been(lake, out, whole)


def killed_group(process: subprocess.Popen[str]) -> None:
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def without_its_jvm(process: subprocess.Popen[str]) -> None:
    assert killed(processes("SparkSubmit", process.pid))
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 2, told
    assert "becalm: Spark gave the job up (" in told
    assert "Make room" not in told


def interrupted(process: subprocess.Popen[str], number: signal.Signals = signal.SIGINT) -> None:
    process.send_signal(number)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 128 + number, told
    assert "Stopped; what is finished stays, and half-written files are not read. Repeat it to continue." in told
    assert "Traceback" not in told
    until = time.monotonic() + 60
    while (left := list(processes("", process.pid))) and time.monotonic() < until:
        time.sleep(0.2)
    assert not left


def terminated(process: subprocess.Popen[str]) -> None:
    interrupted(process, signal.SIGTERM)


def _another_session() -> None:
    with session("local[1]"):
        pass


def test_a_session_is_of_this_machine_alone(tmp_path: Path) -> None:
    with session("local[1]") as spark:
        assert spark.conf.get("spark.driver.bindAddress") == "127.0.0.1"
        assert spark.conf.get("spark.ui.enabled") == "false"
        assert spark.range(3).count() == 3
        with session("local[1]") as same_one:
            assert same_one.sparkContext is spark.sparkContext
        beside = Thread(target=_another_session)
        beside.start()
        beside.join()
        with pytest.raises(UsageError, match=r"has Spark on local\[1,4\]"), session("local[2]"):
            pass
        assert spark.range(3).count() == 3  # whoever came later has not stopped it


def test_what_spark_cannot_do_is_said(lake: Lake, tmp_path: Path, run: Run) -> None:
    words = command(lake, tmp_path / "out", "nonsense")
    ran = run(*words[3:])
    assert (ran.returncode, ran.stdout) == (2, "")
    assert "--master nonsense is not a Spark master; give local[4], spark://HOST:7077 or yarn" in ran.stderr
    assert "Exception" not in ran.stderr
    environment = os.environ | {"PATH": "/nonexistent", "JAVA_HOME": "/nonexistent"}
    words = command(lake, tmp_path / "out", "local[1]")
    ran = subprocess.run(words, capture_output=True, text=True, check=False, env=environment)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert "It needs Java 17 or newer: install one" in ran.stderr
    assert "Traceback" not in ran.stderr


def test_a_file_never_seen_by_its_name(lake: Lake, whole: Path, tmp_path: Path, run: Run) -> None:
    """A recipe made on one machine runs on another: what comes out of a file comes out of a lake."""
    one = tmp_path / "one.parquet"
    run("clean", lake.root / LONG, "-o", one, "--verdicts", "--recipe", lake.recipe)
    assert same(read_parts(whole / LONG), pq.read_table(one))
