"""Writing: bit for bit, whole or not at all, and the file's own columns as they were."""

from __future__ import annotations

import errno
import gzip
import os
from pathlib import Path
from typing import IO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from becalm.core.recording import Recording
from becalm.errors import OutputError, RecordingError
from becalm.files import ReadOptions, output_table, read, read_source, write, write_table
from becalm.files.atomic_file import abandon, refuse_unwritable, replacing
from becalm.files.outputs.writing import refuse_columns

ENDINGS = ["csv", "csv.gz", "h5", "mat", "npz", "parquet"]
LOG = 'time_s,note,force (kN),n\n0.000000,a,1.5,7\n0.009583,,2.5,8\n0.019196,NA,NA,7\n0.028809,"b, c",-1e-05,9\n'


def left_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def save(folder: Path, text: str) -> Path:
    path = folder / "in.csv"
    path.write_text(text)
    return path


def cleaned(path: Path, options: ReadOptions | None = None) -> pa.Table:
    source = read_source(path, options)
    signal = source.recording.with_samples(np.full(source.recording.samples.shape, 0.1))
    return output_table(source, signal, signal.with_samples(signal.samples / 3))


@pytest.mark.parametrize("ending", ENDINGS)
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    values=st.lists(
        st.tuples(*[st.floats(allow_nan=True, allow_infinity=True, width=64)] * 2), min_size=3, max_size=12
    ),
    name=st.text(
        st.characters(exclude_categories=["Cs", "Cc"], exclude_characters="\u2028\u2029"), min_size=1, max_size=12
    ),
)
def test_what_is_written_reads_back_to_the_bit(
    ending: str, values: list[tuple[float, float]], name: str, tmp_path: Path
) -> None:
    path = tmp_path / f"out.{ending}"
    name = "x" + name.strip() + "x"
    recording = Recording(values, names=[name, "other"], rate_hz=100.0)
    write(path, recording, recording)
    again = read(path, channels=[name, "other"])
    np.testing.assert_array_equal(again.samples, recording.samples)
    np.testing.assert_allclose(again.times_s, recording.times_s, rtol=1e-12)


@pytest.mark.parametrize("ending", ENDINGS)
def test_write_has_time_channels_and_sigmas(ending: str, tmp_path: Path) -> None:
    recording = Recording([[1.5, 2.0], [np.nan, 3.0], [2.5, 4.5]], names=["a", "b"], units=["V", ""], rate_hz=4.0)
    write(tmp_path / f"o.{ending}", recording, recording.with_samples(recording.samples * 0.1))
    source = read_source(tmp_path / f"o.{ending}")
    assert source.table.column_names == ["time_s", "a", "a_sigma", "b", "b_sigma"]
    assert source.recording.names == ("a", "b")
    assert source.recording.rate_hz == 4.0
    np.testing.assert_array_equal(source.recording.samples, recording.samples)
    if ending == "parquet":
        assert source.recording.units == ("V", "")
        assert source.table.schema.field("a_sigma").metadata == {b"unit": b"V"}


def test_output_has_the_rows_columns_and_text_of_the_file(tmp_path: Path) -> None:
    write_table(tmp_path / "out.csv", cleaned(save(tmp_path, LOG), ReadOptions(channels=("force",))))
    lines = (tmp_path / "out.csv").read_text().splitlines()
    assert lines[0] == "time_s,note,force (kN),force (kN)_sigma,n"
    assert [line.split(",")[0] for line in lines[1:]] == ["0", "0.009583", "0.019196", "0.028809"]
    assert [line.rsplit(",", 1)[1] for line in lines[1:]] == ["7", "8", "7", "9"]
    again = read_source(tmp_path / "out.csv", ReadOptions(channels=("force",)))
    assert again.table["note"].to_pylist() == ["a", "", "NA", "b, c"]


def test_the_unit_of_a_time_from_a_row_of_units_stays(tmp_path: Path) -> None:
    path = save(tmp_path, "t,x\nms,m\n" + "".join(f"{i / 10:.1f},{i * i % 7}\n" for i in range(20)))
    write_table(tmp_path / "out.csv", cleaned(path))
    write_table(tmp_path / "out.parquet", cleaned(path))
    assert (tmp_path / "out.csv").read_text().startswith("t (ms),x,x_sigma\n0,")
    assert read_source(tmp_path / "out.csv").recording.rate_hz == pytest.approx(1e4)
    assert read_source(tmp_path / "out.parquet").recording.rate_hz == pytest.approx(1e4)


def test_plain_text_is_written_without_quotes(tmp_path: Path) -> None:
    text = "Zeit;Wert;Notiz\n" + "".join(f"07.03.2022 16:35:15,60{i};{i % 3},5;ok\n" for i in range(9))
    write_table(tmp_path / "out.csv", cleaned(save(tmp_path, text)))
    assert (tmp_path / "out.csv").read_text().splitlines()[0] == "Zeit,Wert,Wert_sigma,Notiz"
    plain = save(tmp_path, "time,a\n" + "".join(f"2022-03-07 16:35:15.60{i},{i % 3}.5\n" for i in range(9)))
    write_table(tmp_path / "plain.csv", cleaned(plain))
    assert (tmp_path / "plain.csv").read_text().splitlines()[1].startswith("2022-03-07 16:35:15.600,0.1,0.0333")


def test_missing_numbers_are_empty_cells_and_decimal_commas_become_points(tmp_path: Path) -> None:
    text = "time_s;a;b\n" + "".join(
        f"0,{i};1,{i};{'NaN' if i == 2 else i % 2 + 0.25}\n".replace(".", ",") for i in range(1, 8)
    )
    write_table(tmp_path / "out.csv", cleaned(save(tmp_path, text), ReadOptions(channels=("a",))))
    lines = (tmp_path / "out.csv").read_text().splitlines()
    assert lines[1].endswith(",1.25")
    assert lines[2].endswith(",")


def test_cleaning_twice_replaces_the_old_uncertainty(tmp_path: Path) -> None:
    text = "time_s,a,a_sigma\n" + "".join(f"0.{i},{i % 3}.5,0.7\n" for i in range(1, 9))
    table = cleaned(save(tmp_path, text))
    assert table.column_names == ["time_s", "a", "a_sigma"]
    assert table["a_sigma"][0].as_py() == pytest.approx(0.1 / 3)


def test_parquet_keeps_types_units_and_what_it_is_told(tmp_path: Path) -> None:
    table = pa.table(
        {"t": pa.array(range(5), pa.timestamp("ms")), "a": [1.5, 2, 3, 1, 2], "l": [[1], [2], [], None, [3]]}
    )
    pq.write_table(table, tmp_path / "in.parquet")
    write_table(tmp_path / "out.parquet", cleaned(tmp_path / "in.parquet"), {"recipe": "abc"})
    schema = pq.read_schema(tmp_path / "out.parquet")
    assert schema.names == ["t", "a", "a_sigma", "l"]
    assert schema.field("t").type == pa.timestamp("ms")
    assert schema.metadata[b"recipe"] == b"abc"
    with pytest.raises(OutputError, match=r"write \.parquet"):
        write_table(tmp_path / "out.csv", cleaned(tmp_path / "in.parquet"))
    assert left_in(tmp_path) == ["in.parquet", "out.parquet"]


def test_every_plain_type_can_be_written_as_csv(tmp_path: Path) -> None:
    from decimal import Decimal

    table = pa.table(
        {
            "half": pa.array(np.array([1, np.nan], np.float16)),
            "single": pa.array([0.1, float("nan")], pa.float32()),
            "decimal": pa.array([Decimal("1.25"), None]),
            "flag": pa.array([True, None]),
            "large": pa.array(["a", ""], pa.large_string()),
            "view": pa.array(["a", None], pa.string_view()),
            "words": pa.array(["a", "b"]).dictionary_encode(),
            "when": pa.array([1, 2], pa.timestamp("ms")),
            "zoned": pa.array([1, 2], pa.timestamp("ms", "UTC")),
            "long": pa.array([1, 2], pa.duration("ms")),
            "null": pa.array([None, None]),
        }
    )
    write_table(tmp_path / "out.csv", table)
    assert (
        (tmp_path / "out.csv").read_text().splitlines()[1].startswith("1,0.1,1.25,true,a,a,a,1970-01-01 00:00:00.001,")
    )


def test_a_missing_last_sample_is_kept_where_rows_are_counted(tmp_path: Path) -> None:
    source = read_source(save(tmp_path, "a,b\n1.5,2\n0.5,7\n1,1\n,\n"), ReadOptions(rate_hz=5.0))
    assert len(source.recording) == 4


def test_a_name_that_looks_like_a_comment_is_still_a_name(tmp_path: Path) -> None:
    write_table(tmp_path / "out.csv", pa.table({"#a": [1.5, 2.5, 0.5], "b": [1.5, 2.0, 7.0]}))
    assert read(tmp_path / "out.csv", rate_hz=1.0).names == ("#a", "b")


def test_gzip_output_is_the_same_every_time(tmp_path: Path) -> None:
    recording = Recording([1.0, 2.0, 3.0], rate_hz=2.0)
    write(tmp_path / "a.csv.gz", recording)
    write(tmp_path / "b.csv.gz", recording)
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()
    assert gzip.decompress((tmp_path / "a.csv.gz").read_bytes()).startswith(b"time_s,channel_0\n0,1\n0.5,2\n")


@pytest.mark.parametrize("name", ["out.xlsx", "out", "out.gz"])
def test_unknown_endings_are_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"\.parquet or \.tdms"):
        write(tmp_path / name, Recording([1.0, 2.0], rate_hz=1.0))


def test_a_directory_and_a_missing_folder_are_refused(tmp_path: Path) -> None:
    recording = Recording([1.0, 2.0], rate_hz=1.0)
    (tmp_path / "out.csv").mkdir()
    with pytest.raises(OutputError, match="directory"):
        write(tmp_path / "out.csv", recording)
    with pytest.raises(OutputError, match="mkdir -p"):
        write(tmp_path / "none" / "out.csv", recording)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="not a folder"):
        write(tmp_path / "file" / "out.csv", recording)


FAULTS = {"full": errno.ENOSPC, "may not": errno.EACCES, "read-only": errno.EROFS, "cannot be written": errno.EIO}


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize(("says", "number"), FAULTS.items(), ids=FAULTS.keys())
def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    says: str, number: int, ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"out.{ending}"
    path.write_text("old")

    def fail(handle: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OutputError, match=says):
        write(path, Recording([1.0, 2.0], rate_hz=1.0))
    assert path.read_text() == "old"
    assert left_in(tmp_path) == [path.name]


def test_an_interrupted_write_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import becalm.files.csv.writer as csv_writer

    def interrupt(table: pa.Table, file: IO[bytes]) -> None:
        file.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(csv_writer, "_write_block", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "out.csv", Recording([1.0, 2.0], rate_hz=1.0))
    assert left_in(tmp_path) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_disk_that_fills_up_while_writing(ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = Path.open
    monkeypatch.setattr(
        Path, "open", lambda self, mode: real(Path("/dev/full"), "wb") if mode == "x+b" else real(self, mode)
    )
    with pytest.raises(OutputError, match="full"):
        write(tmp_path / f"out.{ending}", Recording(np.arange(100_000.0) / 7, rate_hz=1.0))
    assert left_in(tmp_path) == []


def test_looking_whether_a_file_can_be_written_touches_no_other(tmp_path: Path) -> None:
    own = tmp_path / ".out.csv.probe"
    own.write_text("mine")
    for _ in range(2):
        refuse_unwritable(tmp_path / "out.csv")
    assert own.read_text() == "mine"
    assert left_in(tmp_path) == [own.name]


def test_what_is_refused_is_the_output_and_no_name_of_our_own(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"mkdir -p .*none`\)\. out\.csv was not written\.$"):
        refuse_unwritable(tmp_path / "none" / "out.csv", tmp_path / "none" / "out.csv.recipe.toml")
    assert left_in(tmp_path) == []


def test_looking_twice_at_once_is_no_trouble(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = Path.touch

    def touch_and_look_again(path: Path, exist_ok: bool) -> None:
        monkeypatch.undo()
        real(path, exist_ok=exist_ok)
        refuse_unwritable(tmp_path / "out.csv")

    monkeypatch.setattr(Path, "touch", touch_and_look_again)
    refuse_unwritable(tmp_path / "out.csv")
    assert left_in(tmp_path) == []


@pytest.mark.parametrize("kind", [pa.large_binary(), pa.binary(2), pa.binary_view()], ids=str)
@pytest.mark.parametrize("name", ["out.csv", "out.h5", "out.npz"])
def test_bytes_are_no_text(name: str, kind: pa.DataType, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="'raw' holds"):
        refuse_columns(tmp_path / name, pa.schema([("x", pa.float64()), ("raw", kind)]))


@pytest.mark.parametrize("name", ["out.csv", "out.csv.gz", "out.parquet"])
def test_columns_are_refused_before_a_row_is_there(name: str, tmp_path: Path) -> None:
    plain_ones = pa.schema({"time": pa.timestamp("ns"), "a": pa.float64(), "n": pa.null(), "words": pa.string()})
    refuse_columns(tmp_path / name, plain_ones)
    odd = [pa.binary(), pa.list_(pa.int8())] if "csv" in name else [pa.month_day_nano_interval()]
    for kind in odd:
        with pytest.raises(OutputError):
            refuse_columns(tmp_path / name, plain_ones.append(pa.field("odd", kind)))
    assert left_in(tmp_path) == []


def test_names_and_rows_must_agree(tmp_path: Path) -> None:
    source = read_source(save(tmp_path, LOG))
    signal = source.recording
    with pytest.raises(RecordingError, match="rows"):
        output_table(source, Recording([1.0, 2.0], rate_hz=1.0), signal)
    with pytest.raises(RecordingError, match="the same"):
        output_table(source, signal, Recording([1.0, 2.0, 3.0, 4.0], rate_hz=1.0))
    stranger = Recording([1.0, 2.0, 3.0, 4.0], names=["z"], rate_hz=1.0)
    with pytest.raises(RecordingError, match="no column 'z'"):
        output_table(source, stranger, stranger)
    with pytest.raises(RecordingError, match="time_s"):
        write(tmp_path / "o.csv", Recording([1.0, 2.0], names=["time_s"], rate_hz=1.0))
    with pytest.raises(RecordingError, match="sigma"):
        write(tmp_path / "o.csv", signal, stranger)


def test_an_epoch_in_milliseconds_keeps_its_digits(tmp_path: Path) -> None:
    lines = [f"{1_700_000_000_000 + 10 * k},{np.sin(k):.6f}" for k in range(50)]
    (tmp_path / "in.csv").write_text("time,a\n" + "\n".join(lines) + "\n", encoding="utf-8")
    source = read_source(tmp_path / "in.csv")
    write_table(tmp_path / "out.csv", output_table(source, source.recording, source.recording))
    written = (tmp_path / "out.csv").read_text(encoding="utf-8").splitlines()[1:]
    assert [line.split(",")[0] for line in written] == [line.split(",")[0] for line in lines]


def test_an_end_without_unwinding_closes_a_file_and_removes_it(tmp_path: Path) -> None:
    """Windows removes no open file."""

    def write_and_end() -> None:
        with replacing(tmp_path / "out.csv") as file:
            file.write(b"half")
            abandon()
            with pytest.raises(OSError, match="Bad file descriptor"):
                os.fstat(file.fileno())
            assert list(tmp_path.iterdir()) == []

    with pytest.raises(OutputError):
        write_and_end()


def test_an_output_that_another_program_holds_open_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "out.csv").write_text("old", encoding="utf-8")
    refusal = PermissionError(errno.EACCES, "in use")
    refusal.winerror = 32  # type: ignore[attr-defined]  # as Windows has it

    def refuse(path: Path, target: Path) -> Path:
        raise refusal

    monkeypatch.setattr(Path, "replace", refuse)
    with (
        pytest.raises(OutputError, match=r"out\.csv is open in another program; close it there"),
        replacing(tmp_path / "out.csv") as file,
    ):
        file.write(b"new")
    assert [path.name for path in tmp_path.iterdir()] == ["out.csv"]
