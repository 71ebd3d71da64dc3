"""Universal files: even and uneven times, text and binary, sets of several times, what is no time response."""

from __future__ import annotations

import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyuff import UFF

import becalm
from becalm.errors import BecalmError, InputError
from becalm.files import open_source
from becalm.files.registry import read_tables

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "pyuff"
ROWS = 101
X = np.arange(ROWS) / 64
RNG = np.random.default_rng(5)
SIGNAL = RNG.normal(size=ROWS)


def one_set(**said: Any) -> dict[str, Any]:
    return {
        "type": 58,
        "binary": 0,
        "func_type": 1,
        "rsp_node": 3,
        "rsp_dir": 2,
        "ref_node": 0,
        "ref_dir": 0,
        "data": SIGNAL,
        "x": X,
        "id1": "front left",
        "abscissa_spacing": 1,
        "abscissa_spec_data_type": 17,
        "ordinate_spec_data_type": 12,
        "orddenom_spec_data_type": 0,
        "ordinate_axis_units_lab": "m/s2",
        "abscissa_axis_units_lab": "s",
        "ord_data_type": 4,
        "byte_ordering": 1,
        "fp_format": 2,
        "n_ascii_lines": 11,
    } | said


def written(folder: Path, *sets: dict[str, Any], double: bool = True) -> Path:
    path = folder / "test.dat"
    path.unlink(missing_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # the library leaves its file to the collector
        UFF(str(path)).write_sets([{**one} for one in sets], mode="add", force_double=double)
    return path


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("even", [0, 1])
@pytest.mark.parametrize("double", [True, False])
def test_it_reads_what_its_own_library_reads(binary: int, even: int, double: bool, tmp_path: Path) -> None:
    x = X if even else np.sort(RNG.uniform(0, 2, ROWS)).astype(np.float32).astype(float)
    path = written(tmp_path, one_set(binary=binary, abscissa_spacing=even, x=x), double=double)
    theirs = UFF(str(path)).read_sets()
    ours = becalm.read(path)
    np.testing.assert_array_equal(ours.samples[:, 0], theirs["data"][:ROWS])
    np.testing.assert_allclose(ours.times_s, theirs["x"][:ROWS] - theirs["x"][0], rtol=0, atol=1e-12)
    assert (ours.names, ours.units) == (("front left",), ("m/s^2",))
    assert ours.timebase.uniform == bool(even)


def test_the_real_file_is_read_as_its_own_library_does() -> None:
    path = DATA / "MPSTD_Set001.uff"
    if not path.exists():
        pytest.skip("the recordings are not beside the project (MPSTD_Set001.uff)")
    theirs = UFF(str(path)).read_sets()
    with open_source(path) as source:
        assert source.names == tuple(one["id1"] for one in theirs)
        assert set(source.units) == {"m/s^2"}
        assert source.rate_hz == 3200
        assert source._time.start == "2024-10-08T10:27:07"
        whole = source.recording().samples
        for number, one in enumerate(theirs):
            np.testing.assert_array_equal(whole[:, number], one["data"])
        for chunk in source.chunks(100_000):
            np.testing.assert_array_equal(chunk.samples, whole[chunk.first_row : chunk.first_row + len(chunk)])


def test_sets_of_several_times_stay_apart(tmp_path: Path) -> None:
    sets = [
        one_set(id1="a"),
        one_set(id1="b", binary=1),
        one_set(id1="slow", x=X * 4),
        one_set(id1="short", x=X[:50], data=SIGNAL[:50]),
        one_set(id1="late", x=X + 1),
    ]
    found = read_tables(written(tmp_path, *sets))
    assert [(table.group, table.names[1:], table.count) for table in found] == [
        ("a", ["a", "b"], ROWS),
        ("slow", ["slow"], ROWS),
        ("short", ["short"], 50),
        ("late", ["late"], ROWS),
    ]
    assert [table.time.rate_hz for table in found if table.time] == [64, 16, 64, 64]


def test_uneven_sets_of_the_same_times_are_one_group(tmp_path: Path) -> None:
    x = np.round(np.sort(RNG.uniform(0, 9, ROWS)), 3)
    sets = [one_set(id1=name, x=x, abscissa_spacing=0, binary=binary) for name, binary in (("a", 0), ("b", 1))]
    sets.append(one_set(id1="c", x=np.round(x + 0.5, 3), abscissa_spacing=0))
    found = read_tables(written(tmp_path, *sets))
    assert [table.names for table in found] == [["time_s", "a", "b"], ["time_s", "c"]]
    assert found[1].head["time_s"][0].as_py() == 0.0


NAMES = {
    "no name": (["NONE", "NONE"], ["node 3+Y", "node 3-Z"]),
    "the model's name": (["car", "car"], ["car 3+Y", "car 3-Z"]),
    "names": (["a", "b"], ["a", "b"]),
    "other letters": (["Kraft \u00e4", "b"], ["Kraft \u00e4", "b"]),
}


@pytest.mark.parametrize(("told", "names"), NAMES.values(), ids=NAMES.keys())
def test_names(told: list[str], names: list[str], tmp_path: Path) -> None:
    (table,) = read_tables(written(tmp_path, one_set(id1=told[0]), one_set(id1=told[1], rsp_dir=-3)))
    assert table.names[1:] == names


@pytest.mark.parametrize(("unit", "rate_hz"), [("NONE", 64), ("ms", 64_000), ("sec", 64)])
def test_the_unit_of_time_counts(unit: str, rate_hz: float, tmp_path: Path) -> None:
    path = written(tmp_path, one_set(abscissa_axis_units_lab=unit, ordinate_axis_units_lab="NONE"))
    with open_source(path) as source:
        assert source.rate_hz == pytest.approx(rate_hz)
        assert source.units == ("",)


def test_what_is_no_time_response_is_left_out_and_said(tmp_path: Path) -> None:
    spectrum = one_set(func_type=4, id1="frf", data=SIGNAL + 1j, ord_data_type=6, abscissa_spec_data_type=18)
    (table,) = read_tables(written(tmp_path, spectrum, one_set(), one_set(func_type=9, id1="psd")))
    assert table.names == ["time_s", "front left"]
    assert "'frf' is a function of type 4" in table.notes[0]
    assert "1 more" in table.notes[0]
    with pytest.raises(InputError, match=r"without a time response.*type 4"):
        becalm.read(written(tmp_path, spectrum))
    with pytest.raises(InputError, match="complex"):
        becalm.read(written(tmp_path, one_set(data=SIGNAL + 1j)))
    with pytest.raises(InputError, match="not a unit of time"):
        becalm.read(written(tmp_path, one_set(abscissa_axis_units_lab="deg")))


def test_other_sets_are_passed_over(tmp_path: Path) -> None:
    path = written(tmp_path, one_set())
    units = b"    -1\n   164\n         1SI units\n  1.0D+00\n    -1\n"
    path.write_bytes(units + path.read_bytes() + units)
    np.testing.assert_allclose(becalm.read(path).samples[:, 0], SIGNAL, rtol=1e-11)


def test_carriage_returns_blanks_and_fortran_exponents(tmp_path: Path) -> None:
    path = written(tmp_path, one_set())
    lines = path.read_bytes().splitlines()
    lines[14:-1] = [line.replace(b"e", b"D") for line in lines[14:-1]]
    path.write_bytes(b"".join(line.ljust(80) + b"\r\n" for line in lines))
    np.testing.assert_allclose(becalm.read(path).samples[:, 0], SIGNAL, rtol=1e-11)


def test_numbers_between_blanks(tmp_path: Path) -> None:
    path = written(tmp_path, one_set())
    lines = path.read_bytes().splitlines()
    lines[13:-1] = [b"  ".join(b"%.9f" % one for one in SIGNAL[at : at + 3]) for at in range(0, ROWS, 3)]
    path.write_bytes(b"\n".join(lines))
    np.testing.assert_allclose(becalm.read(path).samples[:, 0], SIGNAL, atol=1e-9)


def test_a_mark_within_binary_numbers_is_a_number(tmp_path: Path) -> None:
    data = np.frombuffer(b"    -1\n " * 40, "<f8").copy()
    data[::2] = 0
    path = written(tmp_path, one_set(binary=1, data=data, x=X[:40]), one_set(id1="b", data=data, x=X[:40]))
    (table,) = read_tables(path)
    np.testing.assert_array_equal(table.head["front left"].to_numpy(), data)


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("tenth", range(1, 10))
def test_a_cut_file_gives_its_whole_rows_and_says_so(binary: int, tenth: int, tmp_path: Path) -> None:
    path = written(tmp_path, one_set(binary=binary, data=np.tile(SIGNAL, 30), x=np.arange(30 * ROWS) / 64))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * tenth // 10])
    read = becalm.read(path).samples[:, 0]
    (table,) = read_tables(path)
    assert 0 < table.count < 30 * ROWS
    assert f"{table.count} rows are whole" in table.notes[-1]
    np.testing.assert_allclose(read, np.tile(SIGNAL, 30)[: table.count], rtol=1e-11)


def test_a_set_cut_within_its_head_is_said(tmp_path: Path) -> None:
    path = written(tmp_path, one_set(), one_set())
    whole = path.read_bytes()
    path.write_bytes(whole[: whole.rindex(b"front left") + 100])
    (table,) = read_tables(path)
    assert "within the head" in table.notes[0]
    path.write_bytes(whole[:200])
    with pytest.raises(InputError, match="without a complete set 58"):
        becalm.read(path)


@pytest.mark.parametrize("points", [b"999999999", b"        7"])
def test_a_head_that_promises_otherwise(points: bytes, tmp_path: Path) -> None:
    path = written(tmp_path, one_set(binary=1), one_set(id1="b"))
    path.write_bytes(path.read_bytes().replace(b"      101", points, 1))
    first = read_tables(path)[0]
    assert first.count == min(ROWS, int(points))
    np.testing.assert_array_equal(first.head["front left"].to_numpy(), SIGNAL[: first.count])


@pytest.mark.parametrize("binary", [0, 1])
def test_mutants_are_read_or_refused(binary: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(58)
    uneven = one_set(id1="b", binary=binary, data=SIGNAL[:9], x=X[:9], abscissa_spacing=0)
    path = written(tmp_path, one_set(binary=binary, data=SIGNAL[:20], x=X[:20]), uneven)
    whole = path.read_bytes()
    for _ in range(100):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 9)):
            data[at] = rng.integers(256) if rng.random() < 0.5 else rng.choice(list(b" -0123456789\n"))
        path.write_bytes(data)
        with suppress(BecalmError):
            becalm.read(path, channels=("front left",))


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize(
    ("mark", "above"), [(b"    -1", b"\r\n"), (b"    -1", b" \n\n"), (b"-1", b""), (b"  -1  ", b"\n")]
)
def test_marks_need_not_be_as_the_format_has_them(mark: bytes, above: bytes, binary: int, tmp_path: Path) -> None:
    path = written(tmp_path, one_set(binary=binary), one_set(binary=binary, id1="rear", data=-SIGNAL))
    whole = becalm.read(path)
    path.write_bytes(above + path.read_bytes().replace(b"    -1\n", mark + b"\n"))
    recording = becalm.read(path)
    assert recording.names == whole.names == ("front left", "rear")
    np.testing.assert_array_equal(recording.samples, whole.samples)
