"""HDF5, MAT, MF4 and NPZ: what is written reads back the same, with names, units and what is told of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pytest
from scipy.io import loadmat

from becalm.errors import OutputError
from becalm.files import open_output
from becalm.files.arrays import array_writer
from becalm.files.inputs.opening import OpenSource
from becalm.files.outputs.tables import verdict_words
from becalm.files.read_options import ReadOptions
from becalm.files.registry import read_tables

ENDINGS = ["h5", "mat", "mf4", "npz"]
COUNT = 7


def table() -> pa.Table:
    columns = {
        "time_s": pa.array(np.arange(COUNT) / 10),
        "force (kN)": pa.array([float("nan"), 0.1, 1.5, -2.0, 1e300, 5e-324, 7.5]),
        "a/b": pa.array(np.arange(COUNT, dtype=np.float32) / 3),
        "großer Wert": pa.array(np.arange(COUNT) * 1.5),
        "n": pa.array([1, None, 3, 4, 5, 6, 7]),
        "big": pa.array([(1 << 60) + 1] * COUNT),
        "flag": pa.array([True, False, True, True, False, True, False]),
        "a_verdict": verdict_words(np.arange(COUNT, dtype=np.int8) % np.int8(4)),
        "note": pa.array(["a", "ü", None, "", 'b, "c"', "x" * 70, "z"]),
        "when": pa.array(range(COUNT), pa.timestamp("ms")),
        "long": pa.array(range(COUNT), pa.duration("ms")),
    }
    made = pa.table(columns)
    place = made.schema.get_field_index("force (kN)")
    return made.cast(made.schema.set(place, made.schema.field(place).with_metadata({b"unit": b"kN"})))


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("cut", [0, 3, COUNT])
def test_every_column_reads_back(ending: str, cut: int, tmp_path: Path) -> None:
    path, told = tmp_path / f"a.{ending}", table()
    with open_output(path, {"becalm.recipe": "{}"}) as out:
        out.write(told.slice(0, 0))
        out.write(told.slice(0, cut))
        out.write(told.slice(cut))
    (again,) = read_tables(path)
    assert again.names == told.column_names
    assert again.units["force (kN)"] == "kN"
    block = next(iter(again.blocks(again.names)))
    again.rows.close()
    for name in ("time_s", "force (kN)", "a/b", "großer Wert", "big", "flag"):
        np.testing.assert_array_equal(block[name].to_numpy(), told[name].to_numpy())
        assert block[name].type == told[name].type
    np.testing.assert_array_equal(block["n"].to_numpy(), [1, np.nan, 3, 4, 5, 6, 7])
    assert block["a_verdict"].to_pylist() == told["a_verdict"].to_pylist()
    assert block["note"].to_pylist() == [text or "" for text in told["note"].to_pylist()]
    assert block["when"].to_pylist()[1] == "1970-01-01 00:00:00.001"
    assert block["long"].to_pylist() == list(range(COUNT))


def test_the_recipe_is_found_by_each_formats_own_library(tmp_path: Path) -> None:
    recipe = '{"ä": "' + "x" * 100_000 + '"}'  # longer than an attribute of old HDF5 may be
    for ending in ("h5", "mat", "npz"):
        with open_output(tmp_path / f"a.{ending}", {"becalm.recipe": recipe}) as out:
            out.write(table())
    with h5py.File(tmp_path / "a.h5") as file:
        assert file.attrs["becalm.recipe"] == recipe
        assert file["force_kN"].attrs["unit"] == "kN"
    held = loadmat(tmp_path / "a.mat")
    assert held["becalm_recipe"].item() == recipe
    assert held["force_kN"].shape == (COUNT, 1)
    assert np.load(tmp_path / "a.npz")["becalm_recipe"].item() == recipe


@pytest.mark.parametrize("ending", ENDINGS)
def test_what_cannot_be_held_is_refused(ending: str, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"write \.parquet"), open_output(tmp_path / f"a.{ending}") as out:
        out.write(pa.table({"a": [[1], [2]]}))
    assert not list(tmp_path.iterdir())


def test_a_mat_file_over_two_gigabytes_is_refused_as_soon_as_it_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(array_writer, "_MOST_BYTES", 50)
    with pytest.raises(OutputError, match=r"write \.h5"), open_output(tmp_path / "a.mat") as out:
        out.write(table())
    assert not list(tmp_path.iterdir())


def test_each_folder_of_an_archive_has_its_own_times(tmp_path: Path) -> None:
    times, path = np.arange(200) / 100, tmp_path / "a.npz"
    arrays: dict[str, Any] = {"a/time": times, "a/x": np.sin(times), "b/time": times * 10, "b/x": np.cos(times)}
    np.savez(path, **arrays)
    found = [OpenSource(path, one, ReadOptions()) for one in read_tables(path)]
    assert [one.rate_hz for one in found] == [100.0, 10.0]
    assert [one.names for one in read_tables(path)] == [["a/time", "a/x"], ["b/time", "b/x"]]
