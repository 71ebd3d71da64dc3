"""Processes that keep a stream and are killed, or find no room: all of a block or nothing, and no row twice."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from becalm.live.block import Output
from becalm.live.journal.checking import faults
from becalm.live.protocols import StorageFullError
from journal_writer import path, writing
from journals import EPOCH_S, HEAD, assert_rows, checkpoint_at, fill, journal_in, rows_of

KILLS = 12


@pytest.mark.slow
def test_a_journal_that_is_killed_again_and_again_has_each_row_once(tmp_path: Path) -> None:
    """What the process said to be kept is there; beside it at most the block that it was about to say."""
    rng, said = np.random.default_rng(7), 0
    for _ in range(KILLS):
        with writing(tmp_path, "--options", "?roll=5min", "--rows", "300") as process:
            assert process.stdout is not None
            begun = int(process.stdout.readline().split()[-1])
            assert begun in (said, said + 300)
            time.sleep(rng.uniform(0, 0.5))
            process.kill()
            told = process.stdout.read().split()
        said = int(told[-1]) if told else begun
    assert said > 300 * KILLS
    assert list(faults(tmp_path)) == []
    with journal_in(tmp_path, "?roll=5min") as journal:
        assert journal.repair_losses == ()
        rows = fill(journal, 1, 300)
        assert rows in (said + 300, said + 600)
        assert journal.wait_until_rolled(30)
    assert_rows(tmp_path, rows)
    assert len(list(tmp_path.glob("*/*.parquet"))) > 1
    assert not list(tmp_path.glob("*/.*"))


FULL = """
import resource, sys
from pathlib import Path
from journals import checkpoint_at, fill, journal_in, rows_of
from becalm.live.protocols import StorageFullError

limit = int(sys.argv[2])
with journal_in(Path(sys.argv[1]), "?roll=1min") as journal:
    row = fill(journal, 5)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    failures = 0
    while failures < 3:
        try:
            journal.commit([rows_of(row, 100)], checkpoint_at(row + 100))
            row += 100
        except StorageFullError as cause:
            assert "Free disk space" in str(cause), cause
            failures += 1
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    journal.commit([rows_of(row, 100)], checkpoint_at(row + 100))
    print(row + 100)
"""


@pytest.mark.parametrize("limit", [200_000, 300_001, 1_000_000])
def test_where_files_may_grow_no_more_nothing_is_half_written_and_room_lets_it_go_on(
    limit: int, tmp_path: Path
) -> None:
    command = [sys.executable, "-c", FULL, str(tmp_path), str(limit)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, env={"PYTHONPATH": path()})
    assert ran.returncode == 0, ran.stderr
    assert list(faults(tmp_path)) == []
    assert_rows(tmp_path, int(ran.stdout))


def test_a_full_database_keeps_nothing_of_a_call_and_the_same_call_works_later(tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        rows = fill(journal, 5)
        (pages,) = journal._database.execute("PRAGMA page_count").fetchone()
        journal._database.execute(f"PRAGMA max_page_count = {pages}")
        noise = np.random.default_rng(2).normal(size=(20_000, 2))
        big = Output(rows, EPOCH_S + np.arange(20_000) / 10, noise, noise, noise, np.zeros((20_000, 2), np.int8))
        for _ in range(3):
            with pytest.raises(StorageFullError, match=r"full\); nothing was half-written"):
                journal.commit([big], checkpoint_at(rows + 20_000))
            assert journal.last() == checkpoint_at(rows)
        journal._database.execute("PRAGMA max_page_count = 1000000")
        journal.commit([rows_of(rows, 100)], checkpoint_at(rows + 100))
    assert_rows(tmp_path, rows + 100)


def test_a_commit_that_is_there_though_it_seemed_to_fail_is_not_made_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with journal_in(tmp_path) as journal:
        rows = fill(journal, 1)
        forget = "becalm.live.journal.rolling_thread.Roller.forget"
        with monkeypatch.context() as patch:
            patch.setattr(forget, fails)
            with pytest.raises(StorageFullError):
                journal.commit([rows_of(rows, 100)], checkpoint_at(rows + 100))
        journal.commit([rows_of(rows, 100)], checkpoint_at(rows + 100))
        rows = fill(journal, 1)
    assert rows == 300
    assert_rows(tmp_path, 300)
    assert HEAD.names


def fails(*_: object) -> None:
    raise StorageFullError("as if")
