"""MDF files that are cut, unfinished, lie or are damaged are read as far as they go, or refused."""

from __future__ import annotations

from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asammdf import MDF

import becalm
from becalm.errors import BecalmError, InputError
from becalm.files.registry import read_tables
from mdf_logs import ROWS, SIGNAL, signal, written
from tables_of_files import Tables


def test_no_word_of_the_library_reaches_the_person(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    path = written(tmp_path, [signal("a", SIGNAL)])
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError):
        becalm.read(path)
    assert capsys.readouterr() == ("", "")
    assert not caplog.records


def raw_blocks(path: Path, kind: bytes) -> list[int]:
    """Return where blocks of a kind begin."""
    data, found, at = path.read_bytes(), [], 0
    while (at := data.find(kind + bytes(4), at)) >= 0:
        if at % 8 == 0:
            found.append(at)
        at += 4
    return found


def rearranged(folder: Path) -> Path:
    """Write a file as recorders do: what describes the numbers first, the numbers last."""
    path = written(folder, [signal("a", SIGNAL), signal("b", 2 * SIGNAL)])
    data = bytearray(path.read_bytes())
    (numbers,), (group,) = raw_blocks(path, b"##DT"), raw_blocks(path, b"##DG")
    length = int.from_bytes(data[numbers + 8 : numbers + 16], "little")
    data += bytes(-len(data) % 8)
    data[group + 40 : group + 48] = len(data).to_bytes(8, "little")
    data += data[numbers : numbers + length]
    data[numbers : numbers + length] = bytes(length)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("left", [1, 7, 24, 25, 700, 1000, 1400])
def test_a_cut_file_gives_its_whole_rows_and_says_so(left: int, tmp_path: Path, tables: Tables) -> None:
    path = rearranged(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[:-left])
    (table,) = tables(path)
    assert table.count == (24 * ROWS - left) // 24
    assert "incomplete" in table.notes[-1]
    np.testing.assert_array_equal(table.head["a"].to_numpy(), SIGNAL[: table.count])


@pytest.mark.parametrize("tenth", range(1, 10))
def test_a_file_cut_before_what_describes_it_is_refused(tenth: int, tmp_path: Path) -> None:
    path = written(tmp_path, [signal("a", SIGNAL)])
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * tenth // 10])
    with pytest.raises(InputError, match=r"damaged|is cut short"):
        becalm.read(path)


@pytest.mark.parametrize("flags", [0x1, 0x4, 0x5, 0x15])
def test_a_recorder_that_was_not_stopped(flags: int, tmp_path: Path, tables: Tables) -> None:
    path = rearranged(tmp_path)
    data = bytearray(path.read_bytes())
    data[:8], data[60:62] = b"UnFinMF ", flags.to_bytes(2, "little")
    if flags & 4:
        numbers = raw_blocks(path, b"##DT")[-1]
        data[numbers + 8 : numbers + 16] = (24).to_bytes(8, "little")
    if flags & 1:
        (group,) = raw_blocks(path, b"##CG")
        data[group + 24 + 48 + 8 : group + 24 + 48 + 16] = bytes(8)
    path.write_bytes(data)
    before = path.read_bytes()
    (table,) = tables(path)
    np.testing.assert_array_equal(table.head["a"].to_numpy(), SIGNAL)
    assert path.read_bytes() == before


@pytest.mark.parametrize("compression", [0, 1])
@pytest.mark.parametrize("chained", [False, True])
def test_a_list_of_blocks_that_was_not_completed(
    compression: Any, chained: bool, tmp_path: Path, tables: Tables
) -> None:
    times, path = np.arange(20_000) / 100, tmp_path / "list.mf4"
    with MDF(written(tmp_path, [signal("a", times * 2, t=times)])) as log:
        log.configure(write_fragment_size=16_000)
        log.save(path, overwrite=True, compression=compression)
    data, (start,) = bytearray(path.read_bytes()), raw_blocks(path, b"##DL")
    if chained:  # a second list, of no blocks
        data += bytes(-len(data) % 8)
        data[start + 24 : start + 32] = len(data).to_bytes(8, "little")
        data += b"##DL" + bytes(4) + (40).to_bytes(8, "little") + (1).to_bytes(8, "little") + bytes(16)
    data[:8], data[60:62] = b"UnFinMF ", (0x11).to_bytes(2, "little")
    path.write_bytes(data)
    (table,) = tables(path)
    assert table.count == 20_000
    assert bool(table.notes) == chained
    (block,) = table.blocks(["a"], most_rows=20_000)
    np.testing.assert_array_equal(block["a"].to_numpy(), times * 2)


@pytest.mark.parametrize("kind", [b"##DG", b"##CG", b"##CN"])
def test_blocks_in_a_ring_are_refused(kind: bytes, tmp_path: Path) -> None:
    path = written(tmp_path, [signal("a", SIGNAL)])
    data, at = bytearray(path.read_bytes()), raw_blocks(path, kind)[0]
    data[at + 24 : at + 32] = at.to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(InputError, match="form a ring"):
        becalm.read(path)


def test_a_group_that_promises_more_rows_than_there_are(tmp_path: Path, tables: Tables) -> None:
    path = written(tmp_path, [signal("a", SIGNAL)])
    data, (group,) = bytearray(path.read_bytes()), raw_blocks(path, b"##CG")
    links = int.from_bytes(data[group + 16 : group + 24], "little")
    data[group + 24 + 8 * links + 8 : group + 24 + 8 * links + 16] = (2**40).to_bytes(8, "little")
    path.write_bytes(data)
    (table,) = tables(path)
    assert table.count == ROWS
    assert table.notes == (f"Of {2**40} rows {ROWS} are whole and were read.",)


@pytest.mark.parametrize(("version", "at"), [("4.10", 24 + 8 * 8 + 4), ("4.10", 24 + 8 * 8 + 16), ("3.30", 186)])
def test_a_channel_outside_its_rows_is_refused(version: str, at: int, tmp_path: Path) -> None:
    path = written(tmp_path, [signal("a", SIGNAL, invalidation_bits=SIGNAL > 0)], version=version)
    data = bytearray(path.read_bytes())
    start = raw_blocks(path, b"##CN")[-1] if version > "4" else data.rindex(b"CN\xe4\0")
    data[start + at : start + at + 2] = b"\xff\xff"
    path.write_bytes(data)
    with pytest.raises(InputError, match="outside"):
        becalm.read(path)


def test_a_text_longer_than_its_block_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, [signal("s", np.array([b"abc", b"defgh"] * (ROWS // 2)), encoding="utf-8")])
    data, (texts,) = bytearray(path.read_bytes()), raw_blocks(path, b"##SD")
    data[texts + 24 : texts + 28] = (1 << 30).to_bytes(4, "little")
    path.write_bytes(data)
    with pytest.raises(InputError, match="holds no channel"):
        becalm.read(path)


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_mutants_are_read_or_refused(version: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(410)
    told = {"val_0": 0, "text_0": b"low", "val_1": 1, "text_1": b"high"}
    made = [signal("a", SIGNAL), signal("n", np.arange(ROWS) % 2, conversion=told)]
    path = written(tmp_path, made, version=version)
    whole = path.read_bytes()
    for _ in range(100):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 9)):
            data[at] = rng.integers(256)
        path.write_bytes(data)
        with suppress(BecalmError):
            for table in read_tables(path):
                with closing(table.rows):
                    assert len(table.head) <= len(data)


@pytest.mark.parametrize("place", [2**62, 3, 2**16])
def test_a_row_that_points_to_no_text_leaves_the_channel_out(place: int, tmp_path: Path, tables: Tables) -> None:
    texts = signal("s", np.array([b"abc", b"defgh"] * (ROWS // 2)), encoding="utf-8")
    path = written(tmp_path, [signal("a", SIGNAL), texts])
    data, (numbers, *_) = bytearray(path.read_bytes()), raw_blocks(path, b"##DT")
    (texts_at,) = raw_blocks(path, b"##SD")
    second = 4 + int.from_bytes(data[texts_at + 24 : texts_at + 28], "little")
    at = data.index(second.to_bytes(8, "little"), numbers + 24)  # where the row says that it begins
    data[at : at + 8] = place.to_bytes(8, "little")
    path.write_bytes(data)
    (table,) = tables(path)
    assert table.names == ["time_s", "a"]
    assert table.notes == ("'s' was left out: its texts are not where its rows say.",)


@pytest.mark.parametrize("compression", [1, 2])
def test_a_packed_block_that_holds_more_than_it_says_is_refused(compression: Any, tmp_path: Path) -> None:
    with MDF(written(tmp_path, [signal("a", SIGNAL)])) as log:
        path = Path(log.save(tmp_path / "packed.mf4", compression=compression))
    assert becalm.read(path).channel("a").tolist() == SIGNAL.tolist()
    data, (block,) = bytearray(path.read_bytes()), raw_blocks(path, b"##DZ")
    claimed = int.from_bytes(data[block + 32 : block + 40], "little")
    data[block + 32 : block + 40] = (claimed - 8).to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(InputError, match="does not hold"):
        becalm.read(path)
