"""Logs of robots, drones and recorders that are damaged, lie, or need what is not installed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from becalm.errors import BecalmError
from robot_logs import EPOCH_NS, bag1, bag2, drone, json_log, mutant, read_through
from test_real_files import real

MORE_MUTANTS = 350


def _stored(storage: str) -> Callable[[Path], Path]:
    return lambda path: next(file for file in bag2(path.with_suffix(""), storage).iterdir() if file.suffix != ".yaml")


def _shock(path: Path) -> Path:
    path.write_bytes(real("endaq/test1.IDE").read_bytes()[:30_000])
    return path


def _json(path: Path) -> Path:
    return json_log(path, [(EPOCH_NS + row, {"x": row, "stamp": {"sec": row, "nsec": 0}}) for row in range(40)])


LOGS: dict[str, Callable[[Path], Path]] = {
    "ulog": lambda path: drone(path, 20),
    "ide": _shock,
    "ros1": bag1,
    "ros1-lz4": lambda path: bag1(path, "lz4"),
    "ros2": _stored("SQLITE3"),
    "mcap": _stored("MCAP"),
    "json": _json,
}

ENOUGH_PERCENT = {"ros1-lz4": 100, "ros2": 70}
"""How much of a log there must be where its messages are in one block, or after its indices."""

MUTANTS = {"ulog": 200, "ide": 200, "ros1": 60, "ros1-lz4": 60, "ros2": 80, "mcap": 80, "json": 120}


def _damage(make: Callable[[Path], Path], folder: Path, seeds: range) -> int:
    """Read mutants; return how many could be read."""
    data = make(folder / "log.bag").read_bytes()
    path, readable = folder / "mutant.bin", 0
    for seed in seeds:
        path.write_bytes(mutant(data, seed))
        readable += _readable(path)
    return readable


def _readable(path: Path) -> bool:
    """Read a file, or be told which it is that cannot be read."""
    try:
        return all(table.num_rows for table in read_through(path))
    except BecalmError as told:
        if not str(told).startswith(str(path)):
            raise
        return False


@pytest.mark.parametrize("name", LOGS)
def test_a_damaged_log_is_read_or_told(name: str, tmp_path: Path) -> None:
    assert 0 < _damage(LOGS[name], tmp_path, range(MUTANTS[name])) < MUTANTS[name]


@pytest.mark.slow
@pytest.mark.parametrize("name", LOGS)
def test_any_damaged_log_is_read_or_told(name: str, tmp_path: Path) -> None:
    assert _damage(LOGS[name], tmp_path, range(MUTANTS[name], MORE_MUTANTS))


@pytest.mark.parametrize("name", LOGS)
def test_a_log_that_is_cut_off_is_read_or_told(name: str, tmp_path: Path) -> None:
    data = LOGS[name](tmp_path / "log.bag").read_bytes()
    path = tmp_path / "cut.bin"
    for kept in range(10, 100, 10):
        path.write_bytes(data[: len(data) * kept // 100])
        assert _readable(path) or kept < ENOUGH_PERCENT.get(name, 60), kept
