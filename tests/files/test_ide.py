"""IDE: each channel by its own time, calibrated once."""

from __future__ import annotations

import logging
from pathlib import Path

import idelib
import numpy as np
import pytest

from becalm.errors import InputError
from becalm.files import ReadOptions, read_source
from robot_logs import by_name, whole
from test_real_files import real

NAME = "endaq/test1.IDE"


def test_channels_units_and_values_are_those_of_the_library() -> None:
    path = real(NAME)
    tables = by_name(path)
    assert list(tables)[:3] == ["100g PE Acceleration", "40g DC Acceleration", "Rotation (channel 84)"]
    with path.open("rb") as file:
        recording = idelib.importer.openFile(file, quiet=True)
        idelib.importer.readData(recording)
        for table, channel in zip(tables.values(), recording.channels.values(), strict=True):
            times_us, *columns = channel.getSession().arraySlice()
            values = whole(table)
            np.testing.assert_array_equal(values["time_s"], times_us * 1e-6)
            for name, column in zip(table.names[1:], columns, strict=True):
                np.testing.assert_array_equal(values[name], column)
            assert [table.units[name] for name in table.names[1:]] == [part.units[1] for part in channel.subchannels]


def test_units_are_tidy_and_the_start_is_known() -> None:
    path = real(NAME)
    expected = {"40g DC Acceleration": "g", "Rotation (channel 47)": "deg/s", "Pressure/Temperature": "Pa"}
    assert {group: read_source(path, ReadOptions(group=group)).recording.units[0] for group in expected} == expected
    table = by_name(path)["40g DC Acceleration"]
    assert table.time is not None
    assert table.time.start == "2020-09-16T19:05:49.869354000Z"


@pytest.mark.parametrize(("start", "rows"), [(0, 7), (100, 1000), (4960, 100)])
def test_a_chunk_is_the_slice_of_the_whole(start: int, rows: int) -> None:
    table = by_name(real(NAME))["40g DC Acceleration"]
    everything = whole(table)
    block = next(iter(table.blocks(table.names, start, rows)))
    assert block.equals(everything.slice(start, rows))


def test_what_is_whole_of_a_recording_is_read(tmp_path: Path) -> None:
    data = real(NAME).read_bytes()
    everything = {name: whole(table) for name, table in by_name(real(NAME)).items()}
    path = tmp_path / "cut.ide"
    for kept in range(10, 100, 10):
        path.write_bytes(data[: len(data) * kept // 100])
        tables = by_name(path)
        assert tables
        for name, table in tables.items():
            assert table.notes == ("The file is damaged or ends too early; the blocks before that were read.",)
            full = everything[name].slice(0, table.count)
            for own, column in zip(full.column_names, whole(table).columns, strict=True):
                assert column.equals(full[own])
            table.rows.close()


def test_a_damaged_recording_is_told_in_a_sentence(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.ide"
    path.write_bytes(real(NAME).read_bytes()[:900])
    with pytest.raises(InputError, match=r"a\.ide"), caplog.at_level(logging.DEBUG):
        by_name(path)
    assert not caplog.records
