"""The journal: what goes in comes out, in order and to the bit; a restart goes on; strangers are refused."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as some

from becalm.core.reading_verdicts import Verdict
from becalm.errors import UsageError
from becalm.live.address import Address
from becalm.live.block import Checkpoint, Head, Loss, LossKind, Output
from becalm.live.journal.checking import faults
from becalm.live.journal.database import JournalError
from becalm.live.journal.journal import Journal
from becalm.live.journal.reading import open_journal
from becalm.live.journal.records import BlockRow
from becalm.live.journal.row_bytes import join_outputs, pack_rows, split_by_period, unpack_rows
from becalm.live.protocols import CheckpointSink
from journals import EPOCH_S, HEAD, SOURCE, assert_rows, checkpoint_at, fill, journal_in, rows_of, table_of

HOUR_S = 1_700_002_800  # 2023-11-14 23:00 UTC
FLOATS = st.floats(allow_nan=True, allow_infinity=True)


def test_it_is_a_keeper(tmp_path: Path) -> None:
    assert isinstance(Journal(Address.parsed(f"journal:{tmp_path}")), CheckpointSink)


def test_a_new_folder_has_no_checkpoint_and_is_made(tmp_path: Path) -> None:
    journal = Journal(Address.parsed(f"journal:{tmp_path / 'a' / 'b'}"))
    assert journal.last() is None
    journal.close()
    journal.close()


def test_a_restart_goes_on_where_the_last_commit_was(tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        assert fill(journal, 3) == 300
        assert journal.last() == journal.last() is not None
    with journal_in(tmp_path) as journal:
        assert journal.last() == checkpoint_at(300)
        assert journal.repair_losses == ()
        fill(journal, 2)
    assert_rows(tmp_path, 500)


@settings(max_examples=30)
@given(st.lists(st.integers(0, 40), min_size=1, max_size=6), st.data())
def test_any_rows_come_out_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory, sizes: list[int], data: st.DataObject
) -> None:
    folder, row, outputs = tmp_path_factory.mktemp("any"), 0, []
    for size in sizes:
        parts: list[Any] = [data.draw(some.arrays(np.float64, (size, 2), elements=FLOATS)) for _ in range(3)]
        verdicts = data.draw(some.arrays(np.int8, (size, 2), elements=st.integers(0, max(Verdict))))
        values, signal, sigma = parts
        stamps = np.arange(row, row + size, dtype=np.float64) * 700.0 + EPOCH_S
        outputs.append(Output(row, stamps, values, signal, sigma, verdicts))
        row += size
    half = len(outputs) // 2
    with journal_in(folder) as journal:
        journal.commit(outputs[:half], checkpoint_at(sum(map(len, outputs[:half]))))
        journal.commit(outputs[half:], checkpoint_at(row))
        assert journal.wait_until_rolled(30)
    if row:
        table = table_of(folder)
        assert table["row"].to_pylist() == list(range(row))
        for ending, part in {"": "signal", "_raw": "values", "_sigma": "sigma"}.items():
            expected = np.concatenate([getattr(one, part) for one in outputs])
            assert table[f"ax{ending}"].to_numpy().tobytes() == expected[:, 0].tobytes()
        words = [Verdict(code).name.lower() for one in outputs for code in one.verdicts[:, 1]]
        assert table["strain (um/m)_verdict"].to_pylist() == words


def test_other_channels_and_another_recipe_are_refused(tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        fill(journal, 1)
    others = {
        "holds ax \\(m/s\\^2\\), strain .*; the stream has ay": replace(HEAD, names=("ay", "az")),
        "the stream has ax \\(g\\)": replace(HEAD, units=("g", "um/m")),
        "Leave out --recipe": replace(HEAD, recipe="recipe = 2\n"),
    }
    for said, head in others.items():
        with pytest.raises(UsageError, match=said), journal_in(tmp_path, head=head):
            pass
    with journal_in(tmp_path) as journal:
        assert journal.last() == checkpoint_at(100)


def test_a_stream_that_is_tuned_anew_goes_on_with_its_new_recipe(tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        fill(journal, 1)
        journal.commit([rows_of(100, 50)], checkpoint_at(150, "recipe = 2\n"))
    with journal_in(tmp_path, head=replace(HEAD, recipe="recipe = 2\n")) as journal:
        assert journal.last() == checkpoint_at(150, "recipe = 2\n")
    with pytest.raises(UsageError, match="another recipe"), journal_in(tmp_path):
        pass
    assert_rows(tmp_path, 150)


def test_units_may_be_told_later_and_a_head_without_rows_binds_nobody(tmp_path: Path) -> None:
    with journal_in(tmp_path, head=replace(HEAD, recipe="recipe = 0\n")):
        pass
    with journal_in(tmp_path, head=replace(HEAD, units=("", ""))) as journal:
        fill(journal, 1)
    for units in (("m/s^2", ""), ("", "um/m"), ("", "")):
        with journal_in(tmp_path, head=replace(HEAD, units=units)) as journal:
            fill(journal, 1)
    with open_journal(tmp_path) as reader:
        assert reader.head() == HEAD
    assert_rows(tmp_path, 400)


def test_columns_of_one_name_are_refused(tmp_path: Path) -> None:
    head = Head(("a", "a_raw"), ("", ""), 1.0, "")
    with pytest.raises(UsageError, match="rename a channel at its source"), journal_in(tmp_path, head=head):
        pass


HOLD = """
import sys, time
from journals import fill, journal_in
from pathlib import Path
with journal_in(Path(sys.argv[1])) as journal:
    fill(journal, 1)
    print("there", flush=True)
    sys.stdin.read()
"""


def test_a_second_process_is_refused_until_the_first_is_gone(tmp_path: Path) -> None:
    here = str(Path(__file__).parent)
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {here!r})\n{HOLD}", str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == b"there\n"
        second = Journal(Address.parsed(f"journal:{tmp_path}"))
        with pytest.raises(UsageError, match="Another becalm process writes the journal"):
            second.last()
        first.kill()
    assert second.last() == checkpoint_at(100)
    with pytest.raises(UsageError, match="Another becalm"):
        Journal(Address.parsed(f"journal:{tmp_path}")).last()
    second.close()


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("journal:", "needs a folder"),
        ("journal:d?rol=1h", "no option 'rol'; its options are roll, keep"),
        ("journal:d?roll=0s", "roll must be from 1s to 30d"),
        ("journal:d?keep=often", "is not a time"),
    ],
)
def test_an_address_that_cannot_be_is_refused(address: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        Journal(Address.parsed(address))


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("text", encoding="utf-8")
    with pytest.raises(UsageError, match="file"):
        Journal(Address.parsed(f"journal:{tmp_path / 'file'}")).last()


def test_rows_that_do_not_follow_are_refused_and_nothing_is_kept(tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        fill(journal, 1)
        for outputs, rows in (([rows_of(99, 5)], 104), ([rows_of(101, 5)], 106), ([rows_of(100, 5)], 104)):
            with pytest.raises(ValueError, match="rows"):
                journal.commit(outputs, checkpoint_at(rows))
        fill(journal, 1)
    assert_rows(tmp_path, 200)


def test_losses_are_kept_with_the_rows_they_come_before(tmp_path: Path) -> None:
    missing = Loss(LossKind.MISSING, 17, "17 rows never came", 5.5)
    silent = Loss(LossKind.SILENT, None, "nothing came for a minute", 6.5)
    with journal_in(tmp_path) as journal:
        journal.commit([rows_of(0, 10), rows_of(10, 5, losses=(missing,))], checkpoint_at(15))
        journal.commit([rows_of(15, 0, losses=(silent,))], checkpoint_at(15))
    with open_journal(tmp_path) as reader:
        assert [(row.row, row.loss()) for row in reader.losses()] == [(10, missing), (15, silent)]


def test_a_stream_that_tells_no_rows_for_long_fills_no_disk(tmp_path: Path) -> None:
    with journal_in(tmp_path) as journal:
        fill(journal, 1)
        for turn in range(20):
            stands = Checkpoint(100, str(turn), b"s" * 5000, HEAD.recipe, SOURCE)
            journal.commit([], stands)
        fill(journal, 1)
        journal.commit([], Checkpoint(200, "end", b"", HEAD.recipe, SOURCE))
    with journal_in(tmp_path) as journal:
        assert journal.last() == Checkpoint(200, "end", b"", HEAD.recipe, SOURCE)
    with open_journal(tmp_path) as reader:
        (blocks,) = reader.connection.execute("SELECT count(*) FROM blocks").fetchone()
    assert blocks == 4
    assert_rows(tmp_path, 200)


def test_one_output_is_one_block_and_empty_ones_are_none() -> None:
    one = rows_of(5, 3)
    assert join_outputs([rows_of(5, 0), one, rows_of(8, 0)], 5) is one
    assert join_outputs([rows_of(5, 0)], 5) is None
    assert join_outputs([], 5) is None


def test_packing_copies_what_is_strided(tmp_path: Path) -> None:
    wide = rows_of(0, 20)
    strided = replace(wide, values=np.asfortranarray(wide.values), signal=np.repeat(wide.signal, 2, 0)[::2])
    block = BlockRow(1, 1, 0, 20, 0.0, 0.0, 0.0, 0, 0, "", "", None, pack_rows(strided))
    for part in ("time_s", "values", "signal", "sigma", "verdicts"):
        assert getattr(unpack_rows(block), part).tobytes() == getattr(wide, part).tobytes()


@pytest.mark.parametrize(
    ("stamps", "starts"),
    [
        ([EPOCH_S, EPOCH_S + 1], [(HOUR_S - 3600, True, 2)]),
        (
            [HOUR_S - 0.5, HOUR_S, HOUR_S + 7199],
            [(HOUR_S - 3600, True, 1), (HOUR_S, True, 1), (HOUR_S + 3600, True, 1)],
        ),
        ([HOUR_S + 0.0, HOUR_S - 0.5], [(HOUR_S, True, 2)]),
        ([0.0, 7200.0], [(3600, False, 2)]),
        ([np.nan, 1.0], [(3600, False, 2)]),
        ([EPOCH_S, np.inf], [(3600, False, 2)]),
        ([EPOCH_S, np.nan, EPOCH_S + 9000], [(HOUR_S - 3600, True, 3)]),
    ],
)
def test_rows_are_parted_by_the_hours_of_their_stamps(stamps: list[float], starts: list[tuple[int, bool, int]]) -> None:
    rows = replace(rows_of(0, len(stamps)), time_s=np.array(stamps))
    assert [(start, dated, len(part)) for start, dated, part in split_by_period(rows, 3600.0, 5000.0)] == starts


def test_readers_go_on_while_it_is_written(tmp_path: Path) -> None:
    with journal_in(tmp_path, "?roll=1min") as journal, open_journal(tmp_path) as reader:
        assert reader.head() == HEAD
        assert reader.checkpoint() is None
        fill(journal, 30)
        tables = reader.tables()
        rows = [*next(tables)["row"].to_pylist()]
        fill(journal, 30)
        assert journal.wait_until_rolled(30)
        assert list(faults(tmp_path)) == []
        fill(journal, 30)  # and the blocks that have rolled are removed
        for table in tables:
            rows += table["row"].to_pylist()
        assert rows == list(range(9000))
        assert reader.checkpoint() == checkpoint_at(9000)
    with pytest.raises(JournalError, match="holds no journal"):
        open_journal(tmp_path / "none")
