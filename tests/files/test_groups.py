"""Channels of one file at several times: each time a table of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from becalm.errors import InputError, UsageError
from becalm.files.column_statistics import Column
from becalm.files.groups import TIME, Group, chosen_table, tables
from becalm.files.inputs.opening import OpenSource
from becalm.files.library_reader import LibraryFile
from becalm.files.read_options import ReadOptions
from becalm.files.source import FormatTime, RawTable

PATH = Path("log.xyz")
FOREIGN = LibraryFile(PATH, "XYZ")


def column(rows: int, seed: int = 0, unit: str = "m/s^2") -> Column:
    return Column.of(np.random.default_rng(seed).normal(size=rows), unit)


def log() -> tuple[RawTable, ...]:
    stamps = Column.of(5.0 + np.arange(20) * 0.5, "s")
    groups = [
        Group("fast", {"ax": column(300), "ay": column(300, 1)}, 300, FormatTime(rate_hz=100.0, start="2026-01-02")),
        Group("empty", {"b": column(0)}, 0),
        Group("slow", {TIME: stamps, "ax": column(20, 2, "g"), "flag": column(20, 3, "")}, 20, FormatTime(TIME)),
    ]
    return tables(FOREIGN, "xyz", groups)


def test_names_differ_in_all_tables_and_time_is_a_column_of_each() -> None:
    fast, slow = log()
    assert (fast.group, fast.names) == ("fast", [TIME, "fast/ax", "ay"])
    assert (slow.group, slow.names) == ("slow", [TIME, "slow/ax", "flag"])
    assert fast.units == {TIME: "s", "fast/ax": "m/s^2", "ay": "m/s^2"}
    assert slow.units["slow/ax"] == "g"


def test_what_is_written_of_a_table_tells_its_group_and_its_start() -> None:
    fast, slow = log()
    assert fast.rows.schema.metadata == {b"becalm.group": b"fast", b"becalm.start": b"2026-01-02"}
    assert next(slow.blocks(["flag"])).schema.metadata == {b"becalm.group": b"slow"}


def test_a_told_rate_is_the_rate_and_a_told_column_the_time() -> None:
    fast, slow = (OpenSource(PATH, table, ReadOptions()) for table in log())
    assert (fast.rate_hz, fast.names, fast.units) == (100.0, ("fast/ax", "ay"), ("m/s^2", "m/s^2"))
    assert (slow.rate_hz, slow.names, slow.units) == (2.0, ("slow/ax", "flag"), ("g", ""))
    assert fast.layout.time_start == "2026-01-02"
    times = np.concatenate([np.asarray(chunk.table.column(TIME)) for chunk in fast.chunks(7)])
    np.testing.assert_allclose(times, np.arange(300) / 100, rtol=1e-15)


def test_the_rate_that_a_person_says_counts_more() -> None:
    fast, _ = log()
    assert OpenSource(PATH, fast, ReadOptions(rate_hz=99.0)).rate_hz == pytest.approx(99.0)


@pytest.mark.parametrize(
    ("options", "group"),
    [
        (ReadOptions(group="slow"), "slow"),
        (ReadOptions(channels=("flag", "slow/ax")), "slow"),
        (ReadOptions(channels=("ay",)), "fast"),
    ],
)
def test_what_was_said_chooses_a_table(options: ReadOptions, group: str) -> None:
    assert chosen_table(PATH, log(), options).group == group


@pytest.mark.parametrize(
    ("options", "error", "sentence"),
    [
        (ReadOptions(), InputError, r"'fast' \(300 rows of fast/ax, ay\).*--group"),
        (ReadOptions(group="other"), UsageError, "'other'.*'fast'"),
        (ReadOptions(channels=("ay", "flag")), UsageError, "do not share one time"),
        (ReadOptions(channels=("az",)), UsageError, "'az'.*'slow'"),
    ],
)
def test_what_chooses_none_is_refused_in_a_sentence(
    options: ReadOptions, error: type[Exception], sentence: str
) -> None:
    with pytest.raises(error, match=sentence):
        chosen_table(PATH, log(), options)


def test_one_table_needs_no_choice_and_has_no_group() -> None:
    (only,) = tables(FOREIGN, "xyz", [Group("all", {"a": column(5)}, 5, FormatTime(rate_hz=1.0))])
    assert only.group == ""
    assert chosen_table(PATH, [only], ReadOptions()) is only
    with pytest.raises(UsageError, match="leave --group out"):
        chosen_table(PATH, [only], ReadOptions(group="all"))


def test_a_file_without_rows_is_refused_and_closed() -> None:
    closed: list[bool] = []
    with pytest.raises(InputError, match="no channel with rows"):
        tables(FOREIGN, "xyz", [Group("a", {"b": column(0)}, 0)], lambda: closed.append(True))
    assert closed


def test_what_is_shared_is_closed_with_the_last_table() -> None:
    closed: list[bool] = []
    groups = [Group(name, {name: column(3)}, 3) for name in "ab"]
    one, other = tables(FOREIGN, "xyz", groups, lambda: closed.append(True))
    one.rows.close()
    one.rows.close()
    assert not closed
    other.rows.close()
    assert closed == [True]


def test_a_library_that_fails_is_told_in_a_sentence() -> None:
    def read(start: int, stop: int) -> np.ndarray:
        raise KeyError("block 7")

    broken = Column(column(3).type, read)
    (table,) = tables(FOREIGN, "xyz", [Group("", {"a": broken}, 3)])
    with pytest.raises(InputError, match=r"log.xyz is a damaged XYZ file \('block 7'\)"):
        next(table.blocks(["a"]))


def test_a_library_that_is_not_here_is_named_with_what_brings_it() -> None:
    with pytest.raises(InputError, match=r"read by no_such_library.*becalm\[formats\]"):
        FOREIGN.library("no_such_library.reader")


def test_a_claim_beyond_what_noise_packs_to_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.xyz"
    path.write_bytes(b"x" * 1000)
    LibraryFile(path, "XYZ").refuse_claim(100 << 20)
    with pytest.raises(InputError, match="claims to hold 10,000,000,000 bytes in a file of 1,000"):
        LibraryFile(path, "XYZ").refuse_claim(10_000_000_000)
