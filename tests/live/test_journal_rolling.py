"""Closed hours become Parquet files, whatever dies when; who reads them; what is too old goes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import polars as pl
import pyarrow.parquet as pq
import pytest

from becalm.live.block import Loss, LossKind, Output
from becalm.live.journal import rolling
from becalm.live.journal.checking import faults
from becalm.live.journal.database import transaction
from becalm.live.journal.parquet_files import prune
from becalm.live.journal.reading import open_journal
from becalm.live.protocols import StorageFullError
from journal_writer import STEPS, writing
from journals import EPOCH_S, HEAD, assert_rows, checkpoint_at, fill, journal_in, rows_of, table_of

HOUR_ROWS = 36_000  # at 10 Hz


def files_in(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.glob("*/*"))


def asked(query: str) -> list[tuple[object, ...]]:
    """Ask DuckDB."""
    with duckdb.connect() as connection:
        return list(connection.execute(query).fetchall())


def test_hours_become_files_and_the_open_one_stays(tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        fill(journal, 8, 10_000)
        assert journal.wait_until_rolled(30)
        assert files_in(tmp_path) == [f"2023-11-14/{hour}.parquet" for hour in (22, 23)]
        fill(journal, 3, 10_000)
    assert files_in(tmp_path) == ["2023-11-14/22.parquet", "2023-11-14/23.parquet", "2023-11-15/00.parquet"]
    assert_rows(tmp_path, 110_000)
    assert list(faults(tmp_path)) == []
    stamps = pq.read_table(tmp_path / "2023-11-14/23.parquet")["time_s"].to_numpy()
    assert len(stamps) == HOUR_ROWS
    assert stamps[0] == 1_700_002_800.0


def test_a_commit_that_failed_after_it_reached_the_file_records_its_hour_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def failing(*told: Any) -> Iterator[None]:
        with transaction(*told):
            yield
        raise StorageFullError("disk I/O error")

    start_s = EPOCH_S + 2795  # an hour begins after 50 rows
    with journal_in(tmp_path) as journal:
        fill(journal, 2, 100, start_s)
        assert journal._roller is not None
        assert journal._roller.wait_until_rolled(30)
        assert len(journal._roller.done()) == 1
        with monkeypatch.context() as patch:
            patch.setattr("becalm.live.journal.journal.transaction", failing)
            with pytest.raises(StorageFullError):
                fill(journal, 1, 100, start_s)
        fill(journal, 2, 100, start_s)
    assert list(faults(tmp_path)) == []
    assert_rows(tmp_path, 400, start_s)


def test_files_have_units_and_recipe_and_every_reader_reads_them(tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        fill(journal, 8, 10_000)
    count = HOUR_ROWS * 2 - 8000  # the stream begins 13 minutes and 20 seconds past the hour
    names = ["row", "time_s", *(f"{name}{end}" for name in HEAD.names for end in ("", "_raw", "_sigma", "_verdict"))]
    expected = rows_of(0, count)
    pattern = str(tmp_path / "*" / "*.parquet")
    schema = pq.read_schema(tmp_path / "2023-11-14/22.parquet")
    assert schema.names == names
    assert schema.metadata[b"recipe"] == HEAD.recipe.encode()
    assert schema.field("strain (um/m)_raw").metadata[b"unit"] == b"um/m"
    told = asked(
        f"SELECT count(*), sum(row), sum(ax), count(*) FILTER (isnan(ax_raw)), count(*) FILTER (ax_verdict = 'missing')"
        f" FROM '{pattern}'"
    )
    missing = int(np.isnan(expected.values[:, 0]).sum())
    assert told == [(count, count * (count - 1) // 2, pytest.approx(expected.signal[:, 0].sum()), missing, missing)]
    by_polars = pl.read_parquet(pattern).sort("row")
    assert by_polars.columns == names
    np.testing.assert_array_equal(by_polars["ax_raw"].to_numpy(), expected.values[:, 0])
    assert by_polars["ax_verdict"].unique().sort().to_list() == ["missing", "used"]
    pandas = import_module("pandas")  # which has no types
    by_pandas = pandas.concat([pandas.read_parquet(path) for path in sorted(tmp_path.glob("*/*.parquet"))])
    np.testing.assert_array_equal(by_pandas["strain (um/m)_raw"].to_numpy(), expected.values[:, 1])
    assert by_pandas["row"].dtype == np.int64


def test_stamps_that_are_no_dates_roll_by_arrival(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [EPOCH_S]
    monkeypatch.setattr(time, "time", lambda: clock[0])
    with journal_in(tmp_path) as journal:
        for _ in range(5):
            fill(journal, 1, 100, start_s=0.0)
            clock[0] += 1800.0
    assert files_in(tmp_path) == ["2023-11-14/rows-000000000000.parquet", "2023-11-14/rows-000000000200.parquet"]
    assert_rows(tmp_path, 500, start_s=0.0)


def test_an_hour_with_much_is_parted_and_the_last_block_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("rolling", "journal"):
        monkeypatch.setattr(f"becalm.live.journal.{module}.MOST_BYTES", 100_000)
    with journal_in(tmp_path) as journal:
        for _ in range(4):
            fill(journal, 10, 1000, start_s=EPOCH_S + 3000)
            assert journal.wait_until_rolled(30)
        names = files_in(tmp_path)
        assert len(names) > 5
        assert names[:2] == ["2023-11-14/23.parquet", "2023-11-14/23_02.parquet"]
    assert_rows(tmp_path, 40_000, start_s=EPOCH_S + 3000)
    with journal_in(tmp_path) as journal:
        assert journal.last() == checkpoint_at(40_000)


def test_a_clock_that_jumps_back_gives_an_hour_two_files(tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        for start_s in (EPOCH_S, EPOCH_S + 7200, EPOCH_S, EPOCH_S + 7200):
            fill(journal, 1, 100, start_s=start_s)
    assert files_in(tmp_path) == [f"2023-11-1{name}.parquet" for name in ("4/22", "4/22_02", "5/00")]
    assert table_of(tmp_path)["row"].to_pylist() == list(range(400))


@pytest.mark.parametrize("step", STEPS)
def test_a_crash_at_any_step_neither_loses_nor_doubles_rows(step: str, tmp_path: Path) -> None:
    """The process dies there at its first roll; the next one goes on."""
    words = ["--options", "?roll=1min&keep=1s", "--rows", "250", "--blocks", "9"]
    if "pruned" not in step:
        words[1] = "?roll=1min"
    with writing(tmp_path, *words, "--die", step) as process:
        told = int(process.communicate()[0].split()[-1])
    assert process.returncode == 9
    with open_journal(tmp_path) as reader:
        rows = reader.stretches()[-1].end_row
    assert rows in (told, told + 250)  # it may die between a commit and the telling of it
    if "pruned" not in step:
        assert list(faults(tmp_path)) == []
        assert_rows(tmp_path, rows)
    with journal_in(tmp_path, words[1]) as journal:
        assert journal.repair_losses == ()
        assert journal.last() == checkpoint_at(rows)
        rows = fill(journal, 10, 250)
        assert journal.wait_until_rolled(30)
    assert list(faults(tmp_path)) == []
    with open_journal(tmp_path) as reader:
        kept = [one.where for one in reader.stretches() if one.where.endswith("parquet") and not one.pruned]
        assert reader.stretches()[-1].end_row == rows
    assert files_in(tmp_path) == sorted(kept)
    if "pruned" not in step:
        assert_rows(tmp_path, rows)
        found = asked(f"SELECT row FROM '{tmp_path}/*/*.parquet' ORDER BY row")
        assert found == [(row,) for row in range(len(found))]


def test_a_file_that_cannot_be_written_stops_no_stream(tmp_path: Path) -> None:
    (tmp_path / "2023-11-14").write_text("in the way", encoding="utf-8")
    with journal_in(tmp_path, "?roll=1min") as journal:
        fill(journal, 10, 250)
        assert not journal.wait_until_rolled(0.1)
    (tmp_path / "2023-11-14").unlink()
    with journal_in(tmp_path, "?roll=1min") as journal:
        assert journal.wait_until_rolled(30)
    assert len(files_in(tmp_path)) == 4
    assert_rows(tmp_path, 2500)


def test_a_strangers_file_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "2023-11-14").mkdir()
    (tmp_path / "2023-11-14" / "22.parquet").write_text("mine", encoding="utf-8")
    with journal_in(tmp_path) as journal:
        fill(journal, 4, 10_000)
    assert (tmp_path / "2023-11-14" / "22.parquet").read_text(encoding="utf-8") == "mine"
    assert files_in(tmp_path) == ["2023-11-14/22.parquet", "2023-11-14/22_02.parquet"]
    assert_rows(tmp_path, 40_000)


def test_prune_removes_old_files_and_verify_does_not_miss_them(tmp_path: Path) -> None:
    now = time.time()
    lost = Loss(LossKind.MISSING, 3, "three", 1.0)
    with journal_in(tmp_path) as journal:
        journal.commit([rows_of(0, 10, losses=(lost,))], checkpoint_at(10))
        fill(journal, 7, 10_000)
        assert journal.wait_until_rolled(30)
        assert prune(tmp_path, now - 1_700_002_800.0 - 60) != []  # the stream goes on
        assert files_in(tmp_path) == ["2023-11-14/23.parquet"]
        fill(journal, 1, 10_000)
    assert list(faults(tmp_path)) == []
    assert table_of(tmp_path)["row"][0].as_py() == 28_000
    with open_journal(tmp_path) as reader:
        assert reader.losses() == []
        assert [one.pruned for one in reader.stretches()] == [True, False, False]
    with journal_in(tmp_path) as journal:
        assert journal.repair_losses == ()


def test_a_journal_that_keeps_for_a_time_removes_older_files(tmp_path: Path) -> None:
    with journal_in(tmp_path, "?roll=1min&keep=30d") as journal:
        fill(journal, 10, 250)
        assert journal.wait_until_rolled(30)
        fill(journal, 1, 250)
        assert journal.wait_until_rolled(30)
    assert files_in(tmp_path) == []
    assert list(faults(tmp_path)) == []


def test_neither_database_nor_log_grows_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("becalm.live.journal.rolling.MOST_BYTES", 1 << 20)
    monkeypatch.setattr("becalm.live.journal.journal.MOST_BYTES", 1 << 20)
    rng, rows, sizes = np.random.default_rng(1), 0, []
    noise = rng.normal(size=(2000, 2))
    with journal_in(tmp_path) as journal:
        for turn in range(300):
            stamps = EPOCH_S + np.arange(rows, rows + 2000) / 1e6
            output = Output(rows, stamps, noise, noise + turn, noise, np.zeros((2000, 2), np.int8))
            rows += 2000
            journal.commit([output], replace(checkpoint_at(rows), snapshot=b"s" * 3000))
            if turn % 10 == 9:
                assert journal.wait_until_rolled(30)
                files = ("journal.sqlite", "journal.sqlite-wal")
                sizes.append([(tmp_path / name).stat().st_size for name in files])
    database, log = np.array(sizes).T
    assert database.max() < 8 << 20  # of 33 MB that were written
    assert log.max() < 34 << 20
    assert table_of(tmp_path).num_rows == rows


def test_a_damaged_block_is_told_and_the_others_roll(tmp_path: Path) -> None:
    with journal_in(tmp_path, "?roll=1h") as journal:
        fill(journal, 3, 1000)
        with open_journal(tmp_path) as reader:
            assert reader.rolls() == []
        journal._database.execute("UPDATE blocks SET data = zeroblob(1000) WHERE number = 2")
        fill(journal, 2, 1000, start_s=EPOCH_S + 7200)
        assert journal.wait_until_rolled(30)
    assert list(faults(tmp_path)) == []
    with open_journal(tmp_path) as reader:
        assert reader.holes() == [(1000, 2000)]
        assert [(row.row, row.rows, row.kind) for row in reader.losses()] == [(1000, 1000, "storage")]
        assert reader.rolls()[0].rows == 2000
    assert rolling.MOST_BYTES == 1 << 30
