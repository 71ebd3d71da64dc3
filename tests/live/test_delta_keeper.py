"""delta: rows and checkpoint in one commit, or in none."""

from __future__ import annotations

import errno
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import deltalake
import duckdb
import numpy as np
import polars
import pytest

from becalm.live.block import Loss, LossKind, Output
from becalm.live.protocols import AwayError, CheckpointSink, StorageFullError
from becalm.live.sinks.delta_files import DeltaFiles
from becalm.live.tables import output_table
from delta_tables import checkpoint_files, close_all, keeper_of, last_of, opened, rows_of
from streams import assert_same_bits, checkpoint_at, head_of, outputs_of


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    close_all()


@pytest.mark.parametrize("form", ["{}/deep/table", "file://{}/table"])
def test_every_bit_comes_back(tmp_path: Path, form: str) -> None:
    place = form.format(tmp_path)
    keeper, head = keeper_of(place), head_of("a", 'b"; drop, {x}')
    assert isinstance(keeper, CheckpointSink)
    assert keeper.last() is None
    keeper.open(head)
    assert keeper.last() is None
    outputs = outputs_of([500, 0, 700], channels=2, begins_s=1.7e9)
    keeper.commit(outputs[:1], checkpoint_at(500))
    keeper.commit(outputs[1:], checkpoint_at(1200))
    keeper.commit([], checkpoint_at(1200))
    keeper.close()
    keeper.close()
    again = keeper_of(place)
    assert again.last() == checkpoint_at(1200)
    again.open(head)
    read = deltalake.DeltaTable(place).to_pyarrow_table().sort_by("row")
    assert_same_bits(read, output_table(head, outputs))
    assert read.schema.field("a_raw").metadata[b"unit"] == b"m"


def test_duckdb_and_polars_read_it(tmp_path: Path) -> None:
    keeper = opened(tmp_path / "t", "a", "b")
    keeper.commit(outputs_of([100], channels=2), checkpoint_at(100))
    frame = polars.read_delta(str(tmp_path / "t"))
    assert frame["row"].to_list() == list(range(100))
    assert set(frame["a_verdict"]) == {"used", "missing", "spike"}
    files = deltalake.DeltaTable(str(tmp_path / "t")).file_uris()
    with duckdb.connect() as reader:
        told = reader.execute(f"select count(*), sum(b_sigma) from read_parquet({files})").fetchall()
    assert told == [(100, pytest.approx(10))]


@pytest.mark.parametrize("step", ["put_table", "put", "create_write_transaction", "sync_commit"])
def test_a_crash_at_any_step_leaves_rows_and_checkpoint_of_one_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    """The process is as good as dead at the step; another one opens the table."""
    keeper = opened(tmp_path)
    keeper.commit(outputs_of([10]), checkpoint_at(10))
    with monkeypatch.context() as patched:

        class Dead(BaseException):
            pass

        def die(*_: Any, **__: Any) -> None:
            raise Dead

        patched.setattr(deltalake.DeltaTable if step.startswith("create") else DeltaFiles, step, die)
        with pytest.raises(Dead):
            keeper.commit(outputs_of([5], first_row=10), checkpoint_at(15))
    last, again = last_of(tmp_path), keeper_of(tmp_path)
    kept = 15 if step == "sync_commit" else 10
    assert last == checkpoint_at(kept)
    assert rows_of(tmp_path) == list(range(kept))
    again.open(head_of("a"))
    again.commit(outputs_of([5], first_row=kept), checkpoint_at(kept + 5))
    assert rows_of(tmp_path) == list(range(kept + 5))
    again.open(head_of("a"))
    assert len(checkpoint_files(tmp_path)) == 1  # what crashes left is removed


def test_killed_processes_leave_all_or_nothing(tmp_path: Path) -> None:
    script = tmp_path / "writes.py"
    script.write_text(
        "import sys\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from streams import checkpoint_at, head_of, outputs_of\n"
        "from becalm.live.address import Address\n"
        "from becalm.live.sinks.delta import DeltaSink\n"
        "keeper = DeltaSink(Address.parsed('delta:' + sys.argv[1]))\n"
        "last = keeper.last()\n"
        "rows = 0 if last is None else last.rows\n"
        "keeper.open(head_of('a'))\n"
        "print('ready', flush=True)\n"
        "while True:\n"
        "    keeper.commit(outputs_of([100], first_row=rows), checkpoint_at(rows := rows + 100))\n",
        encoding="utf-8",
    )
    random, table = np.random.default_rng(5), tmp_path / "table"
    for _ in range(6):
        with subprocess.Popen([sys.executable, script, table], stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            time.sleep(random.uniform(0.0, 0.15))
            process.send_signal(signal.SIGKILL)
        last = last_of(table)
        rows = 0 if last is None else last.rows
        assert last is None or last == checkpoint_at(rows)
        assert rows_of(table) == list(range(rows))


@pytest.mark.parametrize("cut", [0.0, 0.5, 0.99])
def test_a_torn_last_commit_is_set_aside(tmp_path: Path, cut: float, caplog: pytest.LogCaptureFixture) -> None:
    keeper = opened(tmp_path)
    keeper.commit(outputs_of([10]), checkpoint_at(10))
    before = checkpoint_files(tmp_path)
    keeper.commit(outputs_of([10], first_row=10), checkpoint_at(20))
    torn = tmp_path / "_delta_log" / f"{2:020}.json"
    torn.write_bytes(torn.read_bytes()[: int(cut * torn.stat().st_size)])
    for name, content in before.items():  # it is removed only when the commit is on the disk
        (tmp_path / "_becalm" / name).write_bytes(content)
    assert last_of(tmp_path) == checkpoint_at(10)
    assert "torn" in caplog.text
    again = keeper_of(tmp_path)
    again.open(head_of("a"))
    again.commit(outputs_of([10], first_row=10), checkpoint_at(20))
    assert rows_of(tmp_path) == list(range(20))


@pytest.mark.parametrize("step", ["put_table", "put", "create_write_transaction"])
def test_a_full_disk_keeps_nothing_and_can_be_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    keeper = opened(tmp_path)
    keeper.commit(outputs_of([10]), checkpoint_at(10))
    files = sorted(path.name for path in tmp_path.rglob("*"))
    more = outputs_of([5], first_row=10)

    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device (os error 28)")

    with monkeypatch.context() as patched:
        patched.setattr(deltalake.DeltaTable if step.startswith("create") else DeltaFiles, step, full)
        with pytest.raises(StorageFullError, match="no room"):
            keeper.commit(more, checkpoint_at(15))
    assert sorted(path.name for path in tmp_path.rglob("*")) == files
    keeper.commit(more, checkpoint_at(15))
    assert rows_of(tmp_path) == list(range(15))


def test_an_error_after_the_commit_is_none_of_the_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where deltalake has no room for what it writes after a commit."""
    keeper = opened(tmp_path)
    committed: Callable[..., None] = deltalake.DeltaTable.create_write_transaction

    def fails_late(*words: Any, **options: Any) -> None:
        committed(*words, **options)
        raise OSError(errno.ENOSPC, "No space left on device (os error 28)")

    with monkeypatch.context() as patched:
        patched.setattr(deltalake.DeltaTable, "create_write_transaction", fails_late)
        keeper.commit(outputs_of([10]), checkpoint_at(10))
    keeper.commit(outputs_of([5], first_row=10), checkpoint_at(15))
    assert rows_of(tmp_path) == list(range(15))


def test_a_log_that_cannot_be_read_after_a_commit_is_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keeper = opened(tmp_path)

    def unreadable(*_: Any) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with monkeypatch.context() as patched:
        patched.setattr(deltalake.DeltaTable, "update_incremental", unreadable)
        with pytest.raises(AwayError):
            keeper.commit(outputs_of([10]), checkpoint_at(10))
    keeper.close()
    assert keeper.last() == checkpoint_at(10)


def test_others_may_make_the_table_compact_meanwhile(tmp_path: Path) -> None:
    keeper = opened(tmp_path)
    rows = 0
    for size in (3, 4, 5, 6):
        keeper.commit(outputs_of([size], first_row=rows), checkpoint_at(rows := rows + size))
        table = deltalake.DeltaTable(str(tmp_path))
        table.optimize.compact()
    table.vacuum(retention_hours=0, enforce_retention_duration=False, dry_run=False)
    assert keeper.last() == checkpoint_at(18)
    keeper.commit(outputs_of([2], first_row=18), checkpoint_at(20))
    assert rows_of(tmp_path) == list(range(20))


def test_losses_are_in_the_history(tmp_path: Path) -> None:
    keeper = opened(tmp_path)
    (empty,) = outputs_of([0], first_row=4)
    loss = Loss(LossKind.MISSING, 3, "Three rows.", 5.0)
    told = Output(4, empty.time_s, empty.values, empty.signal, empty.sigma, empty.verdicts, (loss,))
    keeper.commit([told], checkpoint_at(4))
    (newest,) = deltalake.DeltaTable(str(tmp_path)).history(1)
    for said in ('"row": 4', '"kind": "missing"', '"rows": 3', '"noticed_s": 5.0', "Three rows."):
        assert said in newest["becalm"]
