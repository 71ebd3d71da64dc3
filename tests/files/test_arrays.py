"""MAT, HDF5 and NPZ: which arrays belong together, what they are called, and what is said of the rest."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pytest
from scipy.io import savemat

from becalm.errors import InputError, OutputError
from becalm.files import ReadOptions, open_source, read, write_table
from becalm.files.registry import read_tables
from becalm.files.source import RawTable
from becalm.files.units.named_rates import hertz_of

DATA = Path(__file__).parents[2].parent / "shared" / "data"
COUNT = 300
RANDOM = np.random.default_rng(5)
ACC = RANDOM.standard_normal((COUNT, 3))
TIME = np.arange(COUNT) / 100


def real(name: str) -> Path:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"the recordings are not beside the project ({name})")
    return path


def tables_of(path: Path) -> dict[str, RawTable]:
    return {table.group: table for table in read_tables(path)}


def values_of(table: RawTable, name: str) -> Any:
    return next(iter(table.blocks([name])))[0].to_numpy()


def save_h5(path: Path, arrays: dict[str, Any]) -> None:
    with h5py.File(path, "w", track_order=True) as file:
        for name, values in arrays.items():
            file[name] = values


def save_mat73(path: Path, arrays: dict[str, Any]) -> None:
    with h5py.File(path, "w", userblock_size=512, track_order=True) as file:
        for name, values in arrays.items():
            file[name] = np.atleast_2d(values).T
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    data = bytearray(path.read_bytes())
    data[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path.write_bytes(data)


SAVERS: dict[str, Callable[[Path, dict[str, Any]], None]] = {
    "mat5": lambda path, arrays: savemat(path, arrays),
    "mat5 packed": lambda path, arrays: savemat(path, arrays, do_compression=True),
    "mat4": lambda path, arrays: savemat(path, arrays, format="4"),
    "mat73": save_mat73,
    "hdf5": save_h5,
    "npz": lambda path, arrays: np.savez(path, **arrays),
    "npz packed": lambda path, arrays: np.savez_compressed(path, **arrays),
}
FILES = {
    "mat5": "a.mat",
    "mat5 packed": "a.mat",
    "mat4": "a.mat",
    "mat73": "a.mat",
    "hdf5": "a.h5",
    "npz": "a.npz",
    "npz packed": "a.npz",
}


@pytest.mark.parametrize("form", SAVERS)
def test_a_vector_of_times_and_matrices_are_a_table(form: str, tmp_path: Path) -> None:
    path = tmp_path / FILES[form]
    SAVERS[form](path, {"t": TIME, "acc": ACC, "gyr": ACC.T * 2, "gain": 3.0})
    found = read(path)
    assert found.names == ("acc_0", "acc_1", "acc_2", "gyr_0", "gyr_1", "gyr_2")
    assert found.rate_hz == pytest.approx(100.0)
    np.testing.assert_array_equal(found.samples, np.hstack([ACC, ACC * 2]))


@pytest.mark.parametrize("form", SAVERS)
@pytest.mark.parametrize(
    ("name", "number"), [("Fs", 50.0), ("sampling_rate", 50.0), ("dt", 0.02), ("fs_hz", 50.0), ("Tinterval", 0.02)]
)
def test_a_number_tells_the_rate(form: str, name: str, number: float, tmp_path: Path) -> None:
    path = tmp_path / FILES[form]
    SAVERS[form](path, {"acc": ACC, name: number})
    assert read(path).rate_hz == pytest.approx(50.0)


@pytest.mark.parametrize("form", SAVERS)
def test_two_rates_that_differ_are_not_believed(form: str, tmp_path: Path) -> None:
    path = tmp_path / FILES[form]
    SAVERS[form](path, {"acc": ACC, "fs": 50.0, "dt": 0.5})
    (table,) = read_tables(path)
    assert table.time is None
    assert "two rates" in table.notes[0]


@pytest.mark.parametrize("form", SAVERS)
def test_arrays_of_other_lengths_stay_apart(form: str, tmp_path: Path) -> None:
    path = tmp_path / FILES[form]
    arrays = {"t_imu": TIME, "imu_acc": ACC, "gps_t": np.arange(40) / 10, "gps_speed": RANDOM.standard_normal(40)}
    SAVERS[form](path, arrays | {"bias": np.ones((3, 3))})
    assert read(path, channels=["gps_speed"]).rate_hz == pytest.approx(10.0)
    found = {len(table.rows.schema) - 1: table for table in read_tables(path)}
    assert {channels: table.count for channels, table in found.items()} == {3: COUNT, 1: 40}
    assert any("bias" in note for note in found[1].notes)


@pytest.mark.parametrize("form", SAVERS)
@pytest.mark.parametrize("percent", range(10, 100, 10))
def test_a_file_cut_short_gives_what_is_whole_and_says_so(form: str, percent: int, tmp_path: Path) -> None:
    path = tmp_path / FILES[form]
    SAVERS[form](path, {"t": TIME, "acc": ACC, "gyr": ACC * 2})
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * percent // 100])
    try:
        tables = read_tables(path)
    except InputError as refusal:
        assert str(refusal).endswith((".", ".)")) or "damaged" in str(refusal)  # noqa: PT017
        return
    for table in tables:
        assert table.notes
        for name in table.names:
            true = {"t": TIME} | {f"{n}_{i}": v[:, i] for n, v in (("acc", ACC), ("gyr", ACC * 2)) for i in range(3)}
            if name in true:
                np.testing.assert_array_equal(values_of(table, name), true[name][: table.count])


@pytest.mark.parametrize("form", SAVERS)
def test_a_chunk_is_a_slice_of_the_whole(form: str, tmp_path: Path) -> None:
    path = tmp_path / FILES[form]
    SAVERS[form](path, {"t": TIME, "acc": ACC})
    with open_source(path) as source:
        chunks = [chunk.samples for chunk in source.chunks(77)]
    assert [len(chunk) for chunk in chunks] == [77, 77, 77, 69]
    np.testing.assert_array_equal(np.vstack(chunks), ACC)


def test_structs_have_dotted_names_units_and_times_of_their_own(tmp_path: Path) -> None:
    channels = np.zeros((1, 2), [("name", object), ("data", object), ("unit", object), ("fs", object)])
    channels[0, 0] = ("accel", RANDOM.standard_normal((COUNT, 1)), "g", 100.0)
    channels[0, 1] = ("strain", RANDOM.standard_normal((2 * COUNT, 1)), "um/m", 200.0)
    imu = {"acc": ACC, "t": TIME[:, None], "units": {"acc": "m/s^2"}}
    savemat(tmp_path / "a.mat", {"imu": imu, "ch": channels, "cell": np.array(["a", "b"], object)})
    found = tables_of(tmp_path / "a.mat")
    assert list(found) == ["imu", "ch(1)", "ch(2)"]
    assert found["imu"].names == ["imu.t", "imu.acc_0", "imu.acc_1", "imu.acc_2"]
    assert found["imu"].units["imu.acc_1"] == "m/s^2"
    assert found["ch(2)"].units["strain"] == "um/m"
    assert read(tmp_path / "a.mat", channels=["strain"]).rate_hz == 200.0


def test_texts_flags_and_names_of_columns_are_kept(tmp_path: Path) -> None:
    savemat(
        tmp_path / "a.mat",
        {
            "t": TIME,
            "x": ACC[:, :2],
            "x_names": np.array(["left", "right"], object),
            "x_units": np.array(["V", "mV"], object),
            "on": TIME > 1,
            "state": np.array(["run", "stop"] * (COUNT // 2), object),
            "z": ACC[:, 0] * 1j,
            "big": np.full(COUNT, (1 << 60) + 1),
        },
    )
    (table,) = read_tables(tmp_path / "a.mat")
    assert table.names == ["t", "left", "right", "on", "state", "z_real", "z_imag", "big"]
    assert (table.units["left"], table.units["right"]) == ("V", "mV")
    assert str(table.type_of("on")) == "bool"
    assert values_of(table, "state").tolist()[:2] == ["run", "stop"]
    assert values_of(table, "big")[0] == (1 << 60) + 1


@pytest.mark.parametrize("form", ["mat", "hdf5"])
def test_real_recordings_agree_with_their_libraries(form: str) -> None:
    from scipy.io import loadmat

    if form == "mat":
        path = real("broad/04_undisturbed_slow_rotation_with_breaks_A.mat")
        held = loadmat(path)
        rate = float(held["sampling_rate"].item())
    else:
        path = real("broad/05_undisturbed_slow_rotation_with_breaks_B.hdf5")
        with h5py.File(path) as file:
            held, rate = {name: file[name][:] for name in file}, float(file.attrs["sampling_rate"])
    found = read(path)
    assert found.rate_hz == pytest.approx(rate, rel=1e-9)
    units = {"imu_acc": "m/s^2", "imu_gyr": "rad/s", "imu_mag": "uT", "opt_pos": "m", "opt_quat": ""}
    for name, unit in units.items():
        for axis in range(held[name].shape[1]):
            number = found.names.index(f"{name}_{axis}")
            assert found.units[number] == unit
            np.testing.assert_array_equal(found.samples[:, number], held[name][:, axis])


def test_a_rate_may_be_insisted_on(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", ACC)
    with open_source(tmp_path / "a.npy", ReadOptions(rate_hz=20.0)) as source:
        assert source.rate_hz == 20.0
        assert source.names == ("a_0", "a_1", "a_2")


def test_what_matlab_keeps_in_version_73_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"

    def put(group: Any, name: str, values: Any, kind: str) -> Any:
        group[name] = values
        group[name].attrs["MATLAB_class"] = np.bytes_(kind)
        return group[name]

    def text(group: Any, name: str, letters: str) -> Any:
        return put(group, name, np.array([[ord(one)] for one in letters], np.uint16), "char")

    with h5py.File(path, "w", userblock_size=512) as file:
        kept = file.create_group("#refs#")
        names = [text(kept, name, word).ref for name, word in (("a", "left"), ("b", "right"), ("c", "up"))]
        imu = file.create_group("imu")
        imu.attrs["MATLAB_class"] = np.bytes_("struct")
        put(imu, "acc", ACC.T, "double")
        put(imu, "acc_names", np.array([names], h5py.ref_dtype).T, "cell")
        put(imu, "t", TIME[None], "double")
        put(imu, "on", (TIME > 1).astype(np.uint8)[None], "logical")
        text(imu, "unit", "m/s^2")
        put(file, "plan", np.zeros((1, 6), np.uint32), "timetable").attrs["MATLAB_object_decode"] = 3
        put(file, "none", np.zeros(2, np.uint64), "double").attrs["MATLAB_empty"] = 1
        fields = file.create_group("ch")
        fields.attrs["MATLAB_class"] = np.bytes_("struct")
        both = [put(kept, f"d{n}", RANDOM.standard_normal((1, 500 * n)), "double").ref for n in (1, 2)]
        rates = [put(kept, f"f{n}", np.full((1, 1), 10.0 * n), "double").ref for n in (1, 2)]
        fields["data"] = np.array([both], h5py.ref_dtype).T
        fields["fs"] = np.array([rates], h5py.ref_dtype).T
    data = bytearray(path.read_bytes())
    data[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path.write_bytes(data)
    found = tables_of(path)
    assert found["imu"].names == ["imu.t", "left", "right", "up", "imu.on"]
    assert found["imu"].units["up"] == "m/s^2"
    np.testing.assert_array_equal(values_of(found["imu"], "right"), ACC[:, 1])
    assert str(found["imu"].type_of("imu.on")) == "bool"
    assert {table.count: table.time.rate_hz for table in found.values() if table.time} == {500: 10.0, 1000: 20.0}
    assert any("timetable" in note and "table2struct" in note for note in found["imu"].notes)


def test_the_last_bytes_of_a_file_of_matlab_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        values = file.create_dataset("a", (1, 4000), np.float64, chunks=(1, 1000))
        values.attrs["MATLAB_class"] = np.bytes_("double")
        file.flush()
        values[:] = np.arange(4000.0)
        last = values.id.get_chunk_info(3)
    data = bytearray(path.read_bytes())
    assert last.byte_offset + last.size == len(data)
    data[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    path.write_bytes(data)
    (table,) = tables_of(path).values()
    np.testing.assert_array_equal(values_of(table, "a"), np.arange(4000.0))
    assert table.notes == ()


@pytest.mark.parametrize(
    ("name", "number", "unit", "rate_hz"),
    [("dt_ms", 10, "ms", 100), ("dt_ms", 10, "", 100), ("dt", 10, "ms", 100), ("dt_ms", 10, "s", None),
     ("fs (kHz)", 1, "kHz", 1000), ("fs", 1, "kHz", 1000), ("fs", 1, "V", None), ("dt", 0, "s", None)],
)  # fmt: skip
def test_a_unit_counts_once(name: str, number: float, unit: str, rate_hz: float | None, tmp_path: Path) -> None:
    assert hertz_of(name, number, unit) == (None if rate_hz is None else pytest.approx(rate_hz))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["acc"] = ACC
        file[name] = number
        file[name].attrs["units"] = unit
    (table,) = tables_of(tmp_path / "a.h5").values()
    found = None if table.time is None else table.time.rate_hz
    assert found == (None if rate_hz is None else pytest.approx(rate_hz))


def test_tables_of_pandas_have_their_own_names_and_times(tmp_path: Path) -> None:
    ticks = np.arange(COUNT) * 10_000 + 1_704_067_200_000_000
    with h5py.File(tmp_path / "a.h5", "w") as file:
        group = file.create_group("run")
        group.attrs["pandas_type"] = np.bytes_("frame_table")
        rows = np.zeros(COUNT, [("index", "i8"), ("values_block_0", "f8", (2,))])
        rows["index"], rows["values_block_0"] = ticks, ACC[:, :2]
        group["table"] = rows
        group["table"].attrs["index_kind"] = np.bytes_("datetime64[us]")
        group["table"].attrs["values_block_0_kind"] = np.bytes_("(lp0\nVacc_x\np1\naVacc_y\np2\na.")
    found = read(tmp_path / "a.h5")
    assert found.names == ("acc_x", "acc_y")
    assert found.rate_hz == pytest.approx(100.0)
    np.testing.assert_array_equal(found.samples, ACC[:, :2])


def test_scales_fill_values_and_dates_of_netcdf_are_used_once(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.nc", "w", track_order=True) as file:
        file["time"] = np.arange(COUNT) * 20
        file["time"].attrs["units"] = "milliseconds since 2024-05-01 12:00:00"
        raw = RANDOM.integers(-900, 900, COUNT).astype(">i2")
        raw[7] = -999
        file["level"] = raw
        file["level"].attrs.update(
            {"_FillValue": np.int16(-999), "scale_factor": 0.01, "add_offset": 5.0, "units": "m"}
        )
    with open_source(tmp_path / "a.nc") as source:
        assert source.rate_hz == pytest.approx(50.0)
        assert source.layout.time_start.startswith("2024-05-01T12:00:00")
        expected = np.where(raw == -999, np.nan, raw.astype(float) * 0.01 + 5.0)
        np.testing.assert_array_equal(source.recording().channel("level"), expected)
        assert source.units == ("m",)


FILLED: dict[str, tuple[Any, dict[str, Any], list[float | None]]] = {
    "a wider fill": (np.array([1.5, -999.9, 2.5], "f4"), {"missing_value": -999.9}, [1.5, None, 2.5]),
    "several fills": (np.array([1.0, -1.0, -2.0]), {"missing_value": [-1.0, -2.0]}, [1.0, None, None]),
    "limits": (np.array([1.0, -0.5, 9.0]), {"valid_range": [0.0, 8.0]}, [1.0, None, None]),
    "one limit": (np.array([1, -5, 9], "i2"), {"valid_min": np.int16(0)}, [1, None, 9]),
    "limits of scaled numbers": (
        np.array([10, 400, 900], "i2"),
        {"scale_factor": 0.5, "valid_range": [10.0, 300.0]},
        [None, 200.0, None],
    ),
    "unsigned": (np.array([1, -2, -1], "i1"), {"_Unsigned": "true", "_FillValue": np.int8(-1)}, [1, 254, None]),
    "long whole numbers": (
        np.array([2**60 + 1, -1, 5]),
        {"_FillValue": np.int64(-1)},
        [2**60 + 1, None, 5],
    ),
}


@pytest.mark.parametrize("kind", FILLED)
def test_missing_numbers_by_attributes(kind: str, tmp_path: Path) -> None:
    values, attributes, expected = FILLED[kind]
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["a"] = values
        file["a"].attrs.update(attributes)
    (table,) = read_tables(tmp_path / "a.nc")
    (block,) = table.blocks(["a"])
    found = [None if one != one else one for one in block["a"].to_pylist()]
    assert found == expected
    table.rows.close()


def test_a_missing_whole_number_of_time_is_no_instant(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["time"] = np.array([0, -1, 2, 3, 4])
        file["time"].attrs.update({"units": "seconds since 2024-05-01", "_FillValue": np.int64(-1)})
        file["a"] = np.arange(5.0) ** 2
    (table,) = read_tables(tmp_path / "a.nc")
    (block,) = table.blocks(["time"])
    assert block["time"].null_count == 1
    table.rows.close()


@pytest.mark.parametrize("ending", ["mat", "npz"])
def test_whole_numbers_that_a_missing_one_would_round_are_refused(ending: str, tmp_path: Path) -> None:
    table = pa.table({"time_s": [0.0, 0.1, 0.2], "id": pa.array([2**60 + 1, None, 5], pa.int64())})
    with pytest.raises(OutputError, match="'id' has missing cells"):
        write_table(tmp_path / f"a.{ending}", table)
