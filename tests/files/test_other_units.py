"""Columns in units that were asked for: names, values, uncertainties, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import becalm
from becalm.errors import UsageError
from becalm.files.inputs.opening import open_source, read_source
from becalm.files.inputs.time_bases import open_file
from becalm.files.other_units import ColumnConversion, ConvertedRows
from becalm.files.read_options import ReadOptions, RequestOrigin, RequiredUnits
from becalm.files.rows import MemoryRows
from becalm.files.units.unit_conversion import Conversion

G0 = 9.80665
LOG = "time_s,Accelerometer X (g),force,note\n0.0,1,10,a\n0.1,,12,b\n0.2,-2.5,11,c\n0.3,0.5,13,d\n"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    path.write_text(LOG, encoding="utf-8")
    return path


def in_units(**units: str) -> ReadOptions:
    return ReadOptions(units=units)


def fit(**units: str) -> ReadOptions:
    return ReadOptions(required_units=RequiredUnits(RequestOrigin("The recipe", " Make another."), units))


@pytest.mark.parametrize("asked", ["Accelerometer X", "Accelerometer X (g)"])
def test_a_header_tells_the_new_unit(log: Path, asked: str) -> None:
    source = read_source(log, ReadOptions(units={asked: "m/s2"}))
    assert source.recording.names == ("Accelerometer X (m/s^2)", "force")
    assert source.recording.units == ("m/s^2", "")
    expected = np.array([1, np.nan, -2.5, 0.5]) * G0
    np.testing.assert_allclose(source.recording.channel("Accelerometer X (m/s^2)"), expected, rtol=1e-15)
    np.testing.assert_array_equal(source.recording.channel("force"), [10, 12, 11, 13])
    assert source.table.schema.field(1).metadata == {b"unit": b"m/s^2"}
    assert source.layout.columns[1].missing == 1
    note = "--unit: 'Accelerometer X (g)' is converted from g to m/s^2 (times 9.80665)."
    assert source.layout.notes == (note,)


def test_what_the_file_does_not_tell_is_told(log: Path) -> None:
    source = read_source(log, in_units(force="V"))
    assert source.recording.units == ("g", "V")
    np.testing.assert_array_equal(source.recording.channel("force"), [10, 12, 11, 13])
    assert source.layout.notes == ("--unit: the file has no unit for 'force'; V is assumed.",)


def test_the_unit_it_has_changes_nothing(log: Path) -> None:
    with open_source(log, ReadOptions(units={"Accelerometer X": "g"})) as source:
        assert source.names == ("Accelerometer X (g)", "force")
        assert source.notes == ()


def test_channels_are_found_by_their_old_names(log: Path) -> None:
    options = ReadOptions(channels=("Accelerometer X (g)",), units={"Accelerometer X": "mg"})
    assert read_source(log, options).recording.names == ("Accelerometer X (mg)",)


def test_a_row_of_units_and_a_scale_with_an_offset(tmp_path: Path) -> None:
    path = tmp_path / "two_rows.csv"
    path.write_text("t,temp,T_sigma\ns,degC,-\n0,20,1\n1,21.5,1\n2,22,1\n", encoding="utf-8")
    source = read_source(path, in_units(temp="°F"))
    assert (source.recording.names[0], source.recording.units[0]) == ("temp", "degF")
    np.testing.assert_allclose(source.recording.channel("temp"), [68, 70.7, 71.6], rtol=1e-15)


def test_the_uncertainty_goes_along_and_knows_no_zero(tmp_path: Path) -> None:
    path = tmp_path / "calm.parquet"
    table = {"time_s": [0.0, 0.1, 0.2], "T (degC)": [20.0, 21, 22], "T (degC)_sigma": [1.0, 2, 1]}
    pq.write_table(pa.table(table), path)
    source = read_source(path, in_units(T="degF"))
    assert source.recording.names == ("T (degF)",)
    np.testing.assert_allclose(source.table["T (degF)_sigma"], [1.8, 3.6, 1.8], rtol=1e-15)


def test_read_takes_units(log: Path) -> None:
    recording = becalm.read(log, channels="Accelerometer X", units={"Accelerometer X": "m/s^2"})
    assert recording.samples[2, 0] == pytest.approx(-2.5 * G0)


def test_blocks_are_those_of_the_rows_beneath() -> None:
    table = pa.table({"a": pa.array([1, None, 3, 4]), "b": [1.0, 2, 3, 4], "c": ["x", "y", "z", "w"]})
    rows = ConvertedRows(MemoryRows(table), {"a": ColumnConversion("A", "K", Conversion(2.0, 1.0))})
    assert (rows.schema.names, rows.count) == (["A", "b", "c"], 4)
    blocks = list(rows.blocks(["c", "A"], most_rows=2, start=1))
    assert [block.num_rows for block in blocks] == [2, 1]
    assert pa.concat_tables(blocks).to_pydict() == {"c": ["y", "z", "w"], "A": [None, 7.0, 9.0]}
    assert all(block.schema.equals(pa.schema([rows.schema.field("c"), rows.schema.field("A")])) for block in blocks)


@pytest.mark.parametrize("needed", ["Accelerometer X [m/s²]", "Accelerometer X (m/s^2)", "Accelerometer X"])
def test_a_recipe_gets_its_names_and_units(log: Path, needed: str) -> None:
    options = fit(**{needed: "m/s^2", "force": ""})
    with open_source(log, options) as source:
        assert source.names == (needed, "force")
        assert source.units == ("m/s^2", "")
        assert source.recording().channel(needed)[0] == G0
        assert source.notes == ("The recipe: 'Accelerometer X (g)' is converted from g to m/s^2 (times 9.80665).",)


def test_a_recipe_of_another_spelling_is_no_conversion(log: Path) -> None:
    with open_source(log, fit(**{"Accelerometer X [g]": "g"})) as source:
        assert source.names[0] == "Accelerometer X [g]"
        assert source.notes == ("The recipe: 'Accelerometer X (g)' is read as 'Accelerometer X [g]'.",)


def test_a_recipe_tells_no_unit_that_the_file_does_not(log: Path) -> None:
    with open_source(log, fit(force="N")) as source:
        assert source.units == ("g", "")


def test_what_a_person_tells_comes_before_what_a_recipe_needs(log: Path) -> None:
    options = ReadOptions(
        units={"force": "kN"}, required_units=RequiredUnits(RequestOrigin("The recipe"), {"force": "N"})
    )
    with open_source(log, options) as source:
        assert source.recording().channel("force")[0] == 10000


def test_only_channels_that_are_wanted_need_a_recipe_s_unit(log: Path) -> None:
    fitting = RequiredUnits(RequestOrigin("The recipe"), {"Accelerometer X": "V", "force": ""})
    with open_source(log, ReadOptions(channels=("force",), required_units=fitting)) as source:
        assert source.names == ("force",)


MISTAKES = {
    "no such column": (in_units(forces="N"), "--unit names 'forces', which is not a column; the columns are 'time_s'"),
    "another quantity": (ReadOptions(units={"Accelerometer X": "V"}), "asks for .* in V: 'g' is"),
    "the time": (in_units(time_s="ms"), "--unit names 'time_s', a time, which"),
    "twice": (ReadOptions(units={"Accelerometer X": "mg", "Accelerometer X (g)": "mg"}), "twice; give it one unit"),
    "a recipe": (fit(**{"Accelerometer X": "V"}), "The recipe asks for .* they cannot be converted.* Make another."),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_sentences(log: Path, mistake: str) -> None:
    options, sentence = MISTAKES[mistake]
    with pytest.raises(UsageError, match=sentence):
        open_source(log, options)
    with pytest.raises(UsageError, match=sentence), open_file(log, options):
        pass


def test_text_and_taken_names_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "odd.csv"
    path.write_text("time_s,a (g),a (mg),b (V)\n0,1,2,x\n1,1.5,2,y\n2,1,3,z\n", encoding="utf-8")
    with pytest.raises(UsageError, match="renames 'a \\(g\\)' to 'a \\(mg\\)', which another column is called"):
        open_source(path, ReadOptions(units={"a (g)": "mg"}))
    with pytest.raises(UsageError, match="asks for 'b \\(V\\)' in mV, but not all of its cells are numbers"):
        open_source(path, ReadOptions(units={"b": "mV"}))
