"""Columns in what sensors measured: values, names, units, uncertainties, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.cleaning.sensor_files.sensor_file import load_sensors
from becalm.core.arrays import Floats
from becalm.errors import InputError, UsageError
from becalm.files.calibrated.calibrated_source import with_sensors
from becalm.files.inputs.opening import open_source, read_source
from becalm.files.read_options import ReadOptions
from becalm.files.rows import MemoryRows
from becalm.files.source import RawTable
from becalm.sensors.bridge import Bridge
from becalm.sensors.record import SensorRecord

TRIAXIAL = """
[[sensor]]
kind = "triaxial"
channels = ["x", "y", "z"]
raw_unit = "V"
unit = "m/s^2"
sensitivity_mv = [10.0, 20.0, 40.0]
sensitivity_uncertainty_mv = [0.1, 0.2, 0.8]
cross_axis_percent = [[0, 2, 0], [0, 0, 0], [0, 0, 0]]
bias_mv = [1500, 0, 0]
lowest_reading = -5.0
highest_reading = 5.0
zero_uncertainty = 0.04
"""
BRIDGE = """
[[sensor]]
kind = "bridge"
channel = "root"
raw_unit = "mV/V"
configuration = "quarter I"
gauge_factor = 2.0
"""
CELL = """
[[sensor]]
kind = "load cell"
channel = "pull"
raw_unit = "mV"
unit = "N"
rated_output_mv_per_v = 2.0
capacity = 1000
excitation_v = 10.0
zero_uncertainty = 6.0
"""
LOG = "time_s,x (mV),y,z,root,pull,note\n0.0,1600,0.2,0,0,5,a\n0.1,1510,0.4,4.999,-1,20,b\n0.2,,0.6,1,1,0,c\n"


def sensors(folder: Path, text: str) -> tuple[SensorRecord, ...]:
    path = folder / "sensors.toml"
    path.write_text(text, encoding="utf-8")
    return load_sensors(path)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    path.write_text(LOG, encoding="utf-8")
    return path


def read(path: Path, text: str, **said: Any) -> Any:
    return read_source(path, ReadOptions(sensors=sensors(path.parent, text), **said))


def test_axes_in_other_sizes_of_volts_become_accelerations_together(log: Path) -> None:
    source = read(log, TRIAXIAL)
    assert source.recording.names == ("x (m/s^2)", "y", "z", "root", "pull")
    assert source.recording.units == ("m/s^2", "m/s^2", "m/s^2", "", "")
    # x hears 2 % of y: at 0.2 V along y (10 m/s^2) it reads 2 mV of it; its third reading is missing
    np.testing.assert_allclose(source.recording.channel("x (m/s^2)"), [9.8, 0.6, np.nan], rtol=1e-12)
    np.testing.assert_allclose(source.recording.channel("y"), [10.0, 20.0, 30.0], rtol=1e-12)
    np.testing.assert_allclose(source.recording.channel("z"), [0.0, np.nan, 25.0], rtol=1e-12)  # the second is clipped
    assert source.layout.columns[3].missing == 1
    assert source.table.schema.field("y").metadata == {b"unit": b"m/s^2"}
    assert source.table.column("note").to_pylist() == ["a", "b", "c"]
    said = "--sensors: 'x (mV)', 'y', 'z' are converted from V to m/s^2 by the sensor's data sheet."
    taken = "--sensors: the file has no unit for 'y', 'z'; V is assumed."
    assert source.layout.notes == (said, taken)


def test_a_bridge_tells_strain_exactly_and_a_load_cell_force(log: Path) -> None:
    source = read(log, BRIDGE + CELL)
    strain = 1e6 * Bridge("quarter I", 2.0).strain(np.array([0.0, -1e-3, 1e-3]))
    np.testing.assert_allclose(source.recording.channel("root"), strain, rtol=1e-12)
    assert abs(strain[1] + strain[2]) > 1  # um/m: a quarter bridge is no straight line
    np.testing.assert_allclose(source.recording.channel("pull"), [250.0, 1000.0, 0.0], rtol=1e-12)
    assert source.recording.units[3:] == ("um/m", "N")
    np.testing.assert_array_equal(source.recording.channel("y"), [0.2, 0.4, 0.6])


@pytest.mark.parametrize("named", ["x", "x (mV)"])
def test_channels_are_asked_for_by_what_they_were_called(log: Path, named: str) -> None:
    text = TRIAXIAL.replace('"x"', f'"{named}"')
    source = read(log, text, channels=(named, "z"))
    assert source.recording.names == ("x (m/s^2)", "z")
    np.testing.assert_allclose(source.recording.channel("x (m/s^2)"), [9.8, 0.6, np.nan], rtol=1e-12)


def test_units_are_asked_for_after_the_sensor(log: Path) -> None:
    g0 = 9.80665
    with open_source(log, ReadOptions(sensors=sensors(log.parent, TRIAXIAL), units={"x": "g", "z": "g"})) as source:
        assert source.names[:3] == ("x (g)", "y", "z")
        np.testing.assert_allclose(source.recording().channel("x (g)"), np.array([9.8, 0.6, np.nan]) / g0, rtol=1e-12)
        told = {name: one[:2] for name, one in source.calibrations.items()}
    assert told["x (g)"] == pytest.approx((0.005, 0.02 / g0))
    assert told["y"] == pytest.approx((0.005, 0.02))
    assert told["z"] == pytest.approx((0.01, 0.02 / g0))


def test_text_with_a_decimal_comma_is_read(tmp_path: Path) -> None:
    path = tmp_path / "comma.csv"
    path.write_text("time_s;pull (V)\n0,0;0,02\n0,1;0,01\n0,2;\n0,3;-0,005\n", encoding="utf-8")
    source = read(path, CELL)
    assert source.recording.names == ("pull (N)",)
    np.testing.assert_allclose(source.recording.samples[:, 0], [1000.0, 500.0, np.nan, -250.0], rtol=1e-12)


@pytest.mark.parametrize("rows", [1, 7, 64, 1000])
def test_blocks_of_any_size_give_the_same_bits(rows: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    table = pa.table({name: rng.normal(0, 1, 300) for name in ("x", "y", "z", "root")})
    raw = RawTable(MemoryRows(table), 300, "test")
    (sensed,), _ = with_sensors([raw], ReadOptions(sensors=sensors(tmp_path, TRIAXIAL + BRIDGE)))

    def bits(most_rows: int) -> list[Floats]:
        blocks = list(sensed.blocks(["x", "root", "z"], most_rows=most_rows))
        return [np.concatenate([block.column(k).to_numpy() for block in blocks]) for k in range(3)]

    for whole, parts in zip(bits(300), bits(rows), strict=True):
        np.testing.assert_array_equal(parts, whole)


def two_times() -> tuple[RawTable, RawTable]:
    fast = pa.table({"t": np.arange(4) / 4, "root": [0.0, 1.0, 0.0, 1.0], "other": [1.0, 2.0, 3.0, 4.0]})
    slow = pa.table({"t": [0.0, 1.0], "pull": [20.0, 10.0], "other": [1.0, 2.0]})
    return RawTable(MemoryRows(fast), 4, "test", group="fast"), RawTable(MemoryRows(slow), 2, "test", group="slow")


def test_each_sensor_finds_its_time(tmp_path: Path) -> None:
    (fast, slow), _ = with_sensors(two_times(), ReadOptions(sensors=sensors(tmp_path, BRIDGE + CELL)))
    assert (fast.units, slow.units) == ({"root": "um/m"}, {"pull": "N"})
    assert (set(fast.calibrations), set(slow.calibrations)) == ({"root"}, {"pull"})
    assert slow.head.column("pull").to_pylist() == [1000.0, 500.0]


@pytest.mark.parametrize(
    ("channel", "said"), [("other", "more than one time base"), ("none", "no time base of the file")]
)
def test_a_sensor_whose_time_is_not_clear_is_refused(channel: str, said: str, tmp_path: Path) -> None:
    text = CELL.replace("pull", channel)
    with pytest.raises(UsageError, match=f"--sensors names '{channel}', which {said}"):
        with_sensors(two_times(), ReadOptions(sensors=sensors(tmp_path, text)))


MISTAKES = {
    "no channel": (
        '"pull"',
        '"push"',
        "pull,y",
        "names 'push', which is not a column; the columns are 'time_s', 'pull', 'y'",
    ),
    "another unit": ('"pull"', '"pull (g)"', "pull (g)", r"--sensors expects 'pull \(g\)' in mV: 'g' is a unit of"),
    "a name taken": ('"pull"', '"pull (V)"', "pull (V),pull (N)", r"renames 'pull \(V\)' to 'pull \(N\)', but another"),
}


@pytest.mark.parametrize("cells", ["12,1x,14,15", "on,off,on,on"])
def test_a_column_that_is_not_of_numbers_is_refused(cells: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = "".join(f"{k},{cell},1\n" for k, cell in enumerate(cells.split(",")))
    path.write_text("time_s,pull (mV),y\n" + rows, encoding="utf-8")
    with pytest.raises(InputError, match=r"Column 'pull \(mV\)' holds '(1x|on)' in .*, which is not a number"):
        read(path, CELL)


def test_a_share_of_a_temperature_is_none_of_another_scale(log: Path) -> None:
    text = TRIAXIAL.replace('"m/s^2"', '"degC"')
    with pytest.raises(UsageError, match="which depends on where the scale has its zero"):
        open_source(log, ReadOptions(sensors=sensors(log.parent, text), units={"x": "K"}))


@pytest.mark.parametrize("kind", ["two sensors", "two axes"])
def test_a_column_with_two_sensors_is_refused(kind: str, log: Path) -> None:
    text = BRIDGE + CELL.replace('"pull"', '" root"') if kind == "two sensors" else TRIAXIAL.replace('"y"', '"x (mV)"')
    with pytest.raises(UsageError, match=r"names '.*' twice; a channel has one sensor"):
        read(log, text)


def test_two_columns_that_would_be_called_alike_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,pull (V),pull (mV)\n0,1,1\n1,2,1\n2,1,1\n", encoding="utf-8")
    text = "".join(CELL.replace('"pull"', f'"pull ({unit})"') for unit in ("V", "mV"))
    with pytest.raises(UsageError, match=r"makes both 'pull \(V\)' and 'pull \(mV\)' 'pull \(N\)'"):
        read(path, text)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_a_sentence(mistake: str, tmp_path: Path) -> None:
    old, new, header, said = MISTAKES[mistake]
    path, width = tmp_path / "log.csv", header.count(",") + 1
    path.write_text(f"time_s,{header}\n" + "".join(f"{k}{',1' * width}\n" for k in range(4)), encoding="utf-8")
    with pytest.raises(UsageError, match=said):
        read(path, CELL.replace(old, new))


def test_a_format_with_types_keeps_what_no_sensor_fed(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    counts = pa.array([10, 20, None, 0], pa.int16())
    pq.write_table(pa.table({"time_s": [0.0, 0.1, 0.2, 0.3], "pull": counts, "gear": [1, 2, 3, 4]}), path)
    source = read(path, CELL)
    np.testing.assert_array_equal(source.recording.channel("pull"), [500.0, 1000.0, np.nan, 0.0])
    assert source.table.schema.field("pull").type == pa.float64()
    assert source.table.schema.field("gear").type == pa.int64()
