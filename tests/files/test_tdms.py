"""TDMS: waveforms, channels of times, every type, scales applied once; cut, lying and damaged files."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nptdms import GroupObject, RootObject, TdmsFile
from nptdms.test import scenarios
from nptdms.test import test_daqmx as cards

import becalm
from becalm.errors import InputError
from becalm.files import open_source
from tables_of_files import Tables
from tdms_logs import ROWS, SIGNAL, WAVE, channel, written


def test_a_waveform_tells_rate_start_and_unit(tmp_path: Path, tables: Tables) -> None:
    path = written(tmp_path, [channel("a", SIGNAL, **WAVE), channel("b", SIGNAL * 2, **WAVE)])
    with open_source(path) as source:
        assert (source.names, source.units, source.rate_hz) == (("a", "b"), ("m/s^2", "m/s^2"), 100)
        np.testing.assert_array_equal(source.recording().channel("b"), SIGNAL * 2)
    (table,) = tables(path)
    assert table.time
    assert table.time.start == "2024-02-29T23:59:59.250000Z"


def test_segments_are_one_channel_and_a_chunk_is_a_slice(tmp_path: Path) -> None:
    segments = [[channel("a", SIGNAL + k, **WAVE), channel("b", SIGNAL[:30].astype("i2"), **WAVE)] for k in range(4)]
    path = written(tmp_path, *segments)
    with open_source(path, becalm.files.ReadOptions(channels=("a",))) as source:
        whole = source.recording().samples
        np.testing.assert_array_equal(whole[:, 0], np.concatenate([SIGNAL + k for k in range(4)]))
        for chunk in source.chunks(37):
            np.testing.assert_array_equal(chunk.samples, whole[chunk.first_row : chunk.first_row + len(chunk)])


def test_other_rates_lengths_and_groups_stay_apart(tmp_path: Path, tables: Tables) -> None:
    path = written(
        tmp_path,
        [
            RootObject({"author": "us"}),
            GroupObject("run", {"what": "a run"}),
            channel("fast", SIGNAL, **WAVE),
            channel("slow", SIGNAL[:6], **WAVE | {"wf_increment": 0.1}),
            channel("late", SIGNAL, **WAVE | {"wf_start_offset": 1.0}),
            channel("fast", SIGNAL, "rest", **WAVE),
            GroupObject("nothing", {}),
        ],
    )
    found = tables(path)
    assert [(one.group, one.names[1:], one.count) for one in found] == [
        ("run", ["run/fast"], ROWS),
        ("run_2", ["slow"], 6),
        ("run_3", ["late"], ROWS),
        ("rest", ["rest/fast"], ROWS),
    ]


def test_a_channel_of_times_is_found(tmp_path: Path) -> None:
    path = written(tmp_path, [channel("Time", np.arange(ROWS) / 50, unit_string="s"), channel("a", SIGNAL)])
    read = becalm.read(path)
    assert read.names == ("a",)
    assert read.rate_hz == pytest.approx(50)


def test_stamps_keep_their_digits(tmp_path: Path) -> None:
    stamps = np.datetime64("2024-05-06T07:08:09.123456") + np.arange(ROWS) * np.timedelta64(20_000, "us")
    read = becalm.read(written(tmp_path, [channel("when", stamps), channel("a", SIGNAL)]))
    assert read.timebase.uniform
    assert read.rate_hz == pytest.approx(50)


def test_without_time_a_rate_is_asked_for(tmp_path: Path) -> None:
    path = written(tmp_path, [channel("a", SIGNAL), channel("b", SIGNAL)])
    with pytest.raises(InputError, match="--rate HZ"):
        becalm.read(path)
    assert becalm.read(path, rate_hz=9.0).names == ("a", "b")


@pytest.mark.parametrize("step_s", [0.0, -1.0, float("nan"), "0.01"])
def test_a_step_that_is_none_tells_no_time(step_s: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--rate HZ"):
        becalm.read(written(tmp_path, [channel("a", SIGNAL, wf_increment=step_s)]))


def test_a_spectrum_is_no_waveform(tmp_path: Path) -> None:
    path = written(tmp_path, [channel("a", SIGNAL, **WAVE, wf_xunit_string="Hz")])
    with pytest.raises(InputError, match="--rate HZ"):
        becalm.read(path)


@pytest.mark.parametrize("unit", ["s", "seconds", "Seconds"])
def test_the_unit_of_time_may_be_a_word(unit: str, tmp_path: Path) -> None:
    path = written(tmp_path, [channel("a", SIGNAL, **WAVE, wf_xunit_string=unit)])
    assert becalm.read(path).rate_hz == 100


def test_a_preset_step_beside_a_channel_of_times_is_no_rate(tmp_path: Path) -> None:
    times = channel("Time", np.arange(len(SIGNAL)) / 50, unit_string="s")
    path = written(tmp_path, [times, channel("a", SIGNAL, wf_increment=1.0, wf_samples=1, unit_string="Volts")])
    recording = becalm.read(path)
    assert (recording.names, recording.units) == (("a",), ("V",))
    assert recording.rate_hz == pytest.approx(50)


def test_a_time_that_was_not_set_is_no_start(tmp_path: Path, tables: Tables) -> None:
    (table,) = tables(written(tmp_path, [channel("a", SIGNAL, **WAVE | {"wf_start_time": datetime(1904, 1, 1)})]))
    assert table.time
    assert table.time.start == ""


def test_every_type_comes_through(tmp_path: Path, tables: Tables) -> None:
    values = {
        kind: (np.arange(ROWS) % 100).astype(kind) for kind in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4")
    }
    made = [channel(kind, one) for kind, one in values.items()]
    made += [
        channel("wave", SIGNAL, **WAVE),
        channel("on", SIGNAL > 0),
        channel("text \u00e4 / 'q'", ["\u00fc", "b"] * (ROWS // 2)),
        channel("z", SIGNAL + 2j * SIGNAL),
        channel("big", np.full(ROWS, 2**62 + 1)),
        channel("time_s", SIGNAL),
        channel("empty", np.empty(0)),
    ]
    (table,) = tables(written(tmp_path, made))
    head = table.head
    for kind, one in values.items():
        np.testing.assert_array_equal(head[kind].to_numpy(), one)
        assert head[kind].to_numpy().dtype == one.dtype
    assert head["on"].to_pylist() == (SIGNAL > 0).tolist()
    assert head["text \u00e4 / 'q'"].to_pylist()[:2] == ["\u00fc", "b"]
    np.testing.assert_array_equal(head["z_imag"].to_numpy(), 2 * SIGNAL)
    assert head["big"][0].as_py() == 2**62 + 1
    np.testing.assert_array_equal(head["time_s"].to_numpy(), np.arange(ROWS) * 0.01)
    np.testing.assert_array_equal(head["time_s_2"].to_numpy(), SIGNAL)
    assert table.notes == ("'empty' has no rows, and was left out.",)


def test_a_scale_is_applied_once(tmp_path: Path) -> None:
    scale: dict[str, Any] = {
        "NI_Number_Of_Scales": 1,
        "NI_Scaling_Status": "unscaled",
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": 0.5,
        "NI_Scale[0]_Linear_Y_Intercept": -3.0,
        "NI_Scale[0]_Linear_Input_Source": 0xFFFFFFFF,
        "NI_UnitDescription": "kN",
    }
    counts = np.arange(ROWS, dtype=np.int16)
    wave = {name: value for name, value in WAVE.items() if name != "unit_string"}
    read = becalm.read(written(tmp_path, [channel("f", counts, **scale | wave)]))
    np.testing.assert_array_equal(read.samples[:, 0], counts * 0.5 - 3)
    assert read.units == ("kN",)


def test_an_index_file_of_another_state_does_not_matter(tmp_path: Path) -> None:
    path = written(tmp_path, [channel("a", SIGNAL, **WAVE)], index_file=True)
    Path(f"{path}_index").write_bytes(b"rubbish")
    assert becalm.read(path).samples.shape == (ROWS, 1)


@pytest.mark.parametrize(("made", "expected"), scenarios.get_scenarios())
def test_what_the_library_is_tested_with(made: Any, expected: Any, tmp_path: Path, tables: Tables) -> None:
    """Interleaved, big-endian, changing and unfinished segments."""
    path = tmp_path / "case.tdms"
    with made.get_tempfile() as file:
        path.write_bytes(file.read())
    found: dict[tuple[str, str], list[Any]] = {}
    wanted = {key: values for key, values in expected.items() if len(values)}
    if not wanted:
        with pytest.raises(InputError):
            tables(path)
        return
    for table in tables(path):
        for name in table.names:
            found[table.group, name.rpartition("/")[2]] = table.head[name].to_pylist()
    for (group, name), values in wanted.items():
        if values.dtype.kind not in "cOM" and (named := [key for key in found if key[1] == name]):
            assert any(found[key] == values[: len(found[key])].tolist() for key in named), (group, name)


def test_raw_samples_of_a_card(tmp_path: Path) -> None:
    scalers = [cards.daqmx_scaler_metadata(number, 3, 2 * number) for number in range(2)]
    metadata = cards.segment_objects_metadata(
        cards.root_metadata(),
        cards.group_metadata(),
        cards.daqmx_channel_metadata("a", 4, [4], scalers[:1], {"NI_Number_Of_Scales": (3, "01 00 00 00")}),
        cards.daqmx_channel_metadata("b", 4, [4], scalers[1:], {"NI_Number_Of_Scales": (3, "02 00 00 00")}),
    )
    made = cards.GeneratedFile()
    made.add_segment(cards.segment_toc(), metadata, "07 00 11 00 02 00 12 00 FF FF 16 00 04 00 14 00")
    path = tmp_path / "card.tdms"
    with made.get_tempfile() as file:
        path.write_bytes(file.read())
    read = becalm.read(path, rate_hz=10.0)
    assert read.samples.tolist() == [[7, 17], [2, 18], [-1, 22], [4, 20]]


def test_it_agrees_with_its_own_library(tmp_path: Path) -> None:
    path = written(tmp_path, [channel("a", SIGNAL, **WAVE)])
    with TdmsFile.open(path) as theirs:
        np.testing.assert_array_equal(becalm.read(path).times_s + 0.25, theirs["run"]["a"].time_track())
