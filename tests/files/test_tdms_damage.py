"""TDMS files that are cut, lie or are damaged are read as far as they go, or refused."""

from __future__ import annotations

import logging
import os
import struct
import tracemalloc
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import becalm
from becalm.errors import BecalmError, InputError
from becalm.files.recorders.tdms import read as read_tdms
from robot_logs import read_through
from tables_of_files import Tables
from tdms_logs import ROWS, SIGNAL, WAVE, channel, written


@pytest.mark.parametrize("tenth", range(1, 10))
def test_a_cut_file_gives_its_whole_rows_and_says_so(tenth: int, tmp_path: Path, tables: Tables) -> None:
    path = written(tmp_path, *[[channel("a", SIGNAL + k, **WAVE), channel("b", SIGNAL - k, **WAVE)] for k in range(7)])
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * tenth // 10])
    read = becalm.read(path)
    (table,) = tables(path)
    assert f"{table.count} rows are whole" in table.notes[-1]
    assert (tenth - 2) / 10 < table.count / (7 * ROWS) < (tenth + 0.5) / 10
    np.testing.assert_array_equal(read.channel("a"), np.concatenate([SIGNAL + k for k in range(7)])[: table.count])
    np.testing.assert_array_equal(read.channel("b"), np.concatenate([SIGNAL - k for k in range(7)])[: table.count])


def test_a_whole_file_is_not_said_to_be_cut(tmp_path: Path, tables: Tables) -> None:
    (table,) = tables(written(tmp_path, [channel("a", SIGNAL, **WAVE)], [channel("a", SIGNAL, **WAVE)]))
    assert table.notes == ()


def test_a_program_that_crashed_while_writing(tmp_path: Path, tables: Tables) -> None:
    path = written(tmp_path, [channel("a", SIGNAL, **WAVE)])
    data = bytearray(path.read_bytes())
    data[12:20] = b"\xff" * 8  # where the next segment begins is not known
    path.write_bytes(data)
    (table,) = tables(path)
    assert (table.count, len(table.notes)) == (ROWS, 1)


@pytest.mark.parametrize("rows", [2**31, 2**50, 2**63])
def test_a_head_that_promises_too_much(rows: int, tmp_path: Path) -> None:
    path = written(tmp_path, [channel("a", SIGNAL, **WAVE)])
    data = path.read_bytes()
    assert data.count(struct.pack("<IQ", 1, ROWS)) == 1
    path.write_bytes(data.replace(struct.pack("<IQ", 1, ROWS), struct.pack("<IQ", 1, rows)))
    with suppress(BecalmError):
        assert becalm.read(path).samples.shape[0] <= ROWS


def test_a_head_alone_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.tdms"
    for data in (b"TDSm", b"TDSm" + bytes(24), b"TDSm" + bytes(range(100))):
        path.write_bytes(data)
        with pytest.raises(InputError):
            becalm.read(path)


def test_no_word_of_the_library_reaches_the_person(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, tables: Tables
) -> None:
    path = written(tmp_path, [channel("a", SIGNAL, **WAVE)])
    path.write_bytes(path.read_bytes()[:-100])
    tables(path)
    assert not caplog.records
    assert not logging.getLogger("nptdms.reader").disabled


def test_mutants_are_read_or_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(13)
    path = written(
        tmp_path, [channel("a", SIGNAL[:9], **WAVE), channel("s", ["x", "yy", "z"])], [channel("a", SIGNAL[:9])]
    )
    whole = path.read_bytes()
    for _ in range(200):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 9)):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        with suppress(BecalmError):
            assert all(len(table) <= len(data) for table in read_through(path))


@pytest.mark.slow
def test_a_chunk_takes_the_memory_of_one_of_its_channels(tmp_path: Path) -> None:
    path = written(tmp_path, [channel(name, SIGNAL) for name in "abcdefgh"])
    data, rows = path.read_bytes(), 4_000_000
    head = data[: -8 * 8 * ROWS].replace(struct.pack("<IQ", 1, ROWS), struct.pack("<IQ", 1, rows))
    path.write_bytes(head[:12] + struct.pack("<Q", len(head) - 28 + 64 * rows) + head[20:])
    os.truncate(path, len(head) + 64 * rows)
    tracemalloc.start()
    try:
        (table,) = read_tdms(path)
        assert sum(block.num_rows for block in table.blocks(table.names, most_rows=50_000)) == rows
        assert tracemalloc.get_traced_memory()[1] < 2 * 8 * rows  # of 8 channels
        table.rows.close()
    finally:
        tracemalloc.stop()
