"""Arrays as loggers name them: names, units and times stand beside them, or in their names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from becalm.files import ReadOptions, open_source, read
from becalm.files.registry import read_tables

COUNT = 300
ACC = np.random.default_rng(5).standard_normal((COUNT, 3))
TIME = np.arange(COUNT) / 100


def test_times_in_the_middle_of_a_name_are_those_of_one_channel(tmp_path: Path) -> None:
    path = tmp_path / "dewesoft.mat"
    held = {"Sample_rate": 100.0, "Data1_AI_1": ACC[:, 0], "Data1_time_AI_1": TIME}
    savemat(path, held | {"Data1_AI_2": ACC[:60, 1], "Data1_time_AI_2": TIME[::5]})
    rates = [
        open_source(path, ReadOptions(group=group)).rate_hz for group in (table.group for table in read_tables(path))
    ]
    assert rates == pytest.approx([100, 20])


HEADED: dict[str, dict[str, Any]] = {
    "catman": {
        "Channel_1_Header": {"SignalName": "Zeit", "Unit": "s"},
        "Channel_1_Data": TIME,
        "Channel_2_Header": {"SignalName": "Kraft", "Unit": "kN"},
        "Channel_2_Data": ACC[:, 0],
        "Channel_3_Header": {"SignalName": "DMS 1", "Unit": "um/m"},
        "Channel_3_Data": ACC[:, 1],
    },
    "catman with rates": {
        "Channel_1_Header": {"SignalName": "Kraft", "Unit": "kN", "SampleFrequency": 100.0},
        "Channel_1_Data": ACC[:, 0],
        "Channel_2_Header": {"SignalName": "DMS 1", "Unit": "um/m", "SampleFrequency": 100.0},
        "Channel_2_Data": ACC[:, 1],
    },
    "a struct for each channel": {
        "a": {"Name": "Kraft", "Unit": "kN", "Values": ACC[:, 0], "fs": 100.0},
        "b": {"Name": "DMS 1", "Unit": "um/m", "Values": ACC[:, 1], "fs": 100.0},
    },
    "what all share, in a struct of its own": {
        "rec": {
            "meta": {"fs": 100.0, "name": "a person", "units": np.array(["kN", "um/m"], object)},
            "names": np.array(["Kraft", "DMS 1"], object),
            "ch": ACC[:, :2],
        }
    },
}


@pytest.mark.parametrize("arrays", HEADED.values(), ids=HEADED)
def test_heads_beside_arrays_name_them(arrays: dict[str, Any], tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", arrays)
    recording = read(tmp_path / "a.mat")
    assert recording.names == ("Kraft", "DMS 1")
    assert recording.units == ("kN", "um/m")
    assert recording.rate_hz == pytest.approx(100)
    np.testing.assert_array_equal(recording.samples, ACC[:, :2])


def test_a_timeseries_has_its_own_units(tmp_path: Path) -> None:
    series = {"Name": "Kraft", "Data": ACC[:, 0], "DataInfo": {"Units": "kN"}}
    savemat(tmp_path / "a.mat", {"ts": {**series, "Time": TIME * 1e3, "TimeInfo": {"Units": "ms"}}})
    recording = read(tmp_path / "a.mat")
    assert (recording.names, recording.units) == (("Kraft",), ("kN",))
    assert recording.rate_hz == pytest.approx(100)


def test_structs_that_begin_at_other_times_stay_apart(tmp_path: Path) -> None:
    begun = ("2024-01-01T10:00:00", "2024-01-01T11:00:00")
    one, other = ({"name": n, "data": ACC[:, 0], "fs": 100.0, "start": s} for n, s in zip("ab", begun, strict=True))
    savemat(tmp_path / "a.mat", {"one": one, "other": other})
    assert {table.group: table.time.start for table in read_tables(tmp_path / "a.mat") if table.time} == {
        "one": begun[0],
        "other": begun[1],
    }
