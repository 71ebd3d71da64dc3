"""Datasets of which parts were never written: missing, and never zero."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

import becalm
from becalm.files.registry import read_tables

ROWS = 90
VALUES = np.arange(1.0, ROWS + 1)


def _gappy(file: h5py.File, name: str, kind: str, **said: object) -> None:
    data = file.create_dataset(name, (ROWS,), kind, chunks=(10,), **said)
    data[:20] = VALUES[:20].astype(kind)
    data[50:] = VALUES[50:].astype(kind)


@pytest.mark.parametrize("packed", [{}, {"compression": "gzip", "shuffle": True}])
@pytest.mark.parametrize("kind", ["f8", "i2", "u1"])
def test_what_nobody_wrote_is_missing(kind: str, packed: dict[str, object], tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = np.arange(ROWS) / 10
        _gappy(file, "a", kind, **packed)
    expected = VALUES.copy()
    expected[20:50] = np.nan
    read = becalm.read(tmp_path / "a.h5")
    np.testing.assert_array_equal(read.channel("a"), expected)
    (table,) = read_tables(tmp_path / "a.h5")
    assert table.notes == ("Parts of 'a' were never written, and are missing.",)
    (block,) = table.blocks(["a"], start=15, most_rows=10_000)
    np.testing.assert_array_equal(block["a"].to_numpy(), expected[15:])
    table.rows.close()


def test_long_whole_numbers_beside_what_nobody_wrote_keep_their_digits(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = np.arange(ROWS) / 10
        for name in ("a", "b"):
            file.create_dataset(name, (ROWS,), "i8", chunks=(10,))[10:] = 2**60 + np.arange(10, ROWS)
        file["b"].attrs["_FillValue"] = np.int64(2**60 + 12)
    (table,) = read_tables(tmp_path / "a.h5")
    (block,) = table.blocks(["a", "b"])
    assert block["a"].to_pylist() == [None] * 10 + [2**60 + row for row in range(10, ROWS)]
    assert block["b"].to_pylist() == [None] * 10 + [None if row == 12 else 2**60 + row for row in range(10, ROWS)]
    table.rows.close()


def test_columns_fields_and_texts_have_gaps_of_their_own(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        both = file.create_dataset("b", (ROWS, 3), "f8", chunks=(30, 2))
        both[:, :2] = 1.0
        both[60:] = 1.0
        rows = file.create_dataset("c", (ROWS,), [("x", "f4", (2,)), ("s", "S2")], chunks=(30,))
        rows[30:] = np.array([((2.0, 3.0), b"on")] * 60, rows.dtype)
    tables = {table.group: table for table in read_tables(tmp_path / "a.h5")}
    held = {
        name: block[name].to_pylist()
        for one in tables.values()
        for block in one.blocks(one.names)
        for name in one.names
    }
    for table in tables.values():
        table.rows.close()
    missing = {
        name: [row for row, one in enumerate(values) if one in ("", None) or one != one]
        for name, values in held.items()
    }
    assert missing == {
        "b_0": [],
        "b_1": [],
        "b_2": list(range(60)),
        **{name: list(range(30)) for name in ("x_0", "x_1", "s")},
    }


def test_a_view_of_other_arrays_is_left_to_them(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"] = VALUES
        layout = h5py.VirtualLayout((3 * ROWS,), "f8")  # of which two thirds are nowhere
        layout[:ROWS] = h5py.VirtualSource(file["a"])
        file.create_virtual_dataset("view", layout)
    (table,) = read_tables(tmp_path / "a.h5")
    assert (table.names, table.count) == (["a"], ROWS)
    assert table.notes == ("'view' is not read: its values are in other arrays, which are read themselves.",)
    table.rows.close()
