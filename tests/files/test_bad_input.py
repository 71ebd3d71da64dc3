"""Bad input gives a sentence with a way out, never a traceback."""

from __future__ import annotations

import gzip
import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.errors import BecalmError, InputError, TimeError, UsageError
from becalm.files import ReadOptions, read, read_source

GOOD = "time_s,a,b\n" + "".join(f"{i / 10},{i * i % 7}.5,{i % 5}.25\n" for i in range(400))


def parquet_bytes() -> bytes:
    buffer = io.BytesIO()
    pq.write_table(pa.table({"time_s": np.arange(9) / 10, "a": np.arange(9) * 1.5}), buffer)
    return buffer.getvalue()


BAD: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "empty"),
    "only blank lines": (b"\n\n  \n", "no table"),
    "only a header": (b"time_s,a,b\n", "no column of numbers"),
    "only text": (b"once upon a time\nthere was a file\nwithout numbers\n", "no column of numbers"),
    "text table": (b"name,town\nada,london\nemmy,erlangen\n", "no column of numbers"),
    "one row": (b"time_s,a,b\n0.1,2.5,3.5\n", "One row"),
    "gzip that ends in its head": (gzip.compress(GOOD.encode())[:15], "ends too early"),
    "gzip of another checksum": (gzip.compress(GOOD.encode())[:-8] + bytes(8), "damaged gzip"),
    "gzip of nothing": (gzip.compress(b""), "nothing in it"),
    "damaged gzip": (gzip.compress(GOOD.encode())[:40] + b"\xff" * 40, "gzip"),
    "random bytes": (np.random.default_rng(1).integers(0, 256, 5000, np.uint8).tobytes(), "not text|UTF-16"),
    "unprintable bytes": (bytes(range(1, 9)) * 50, "not text"),
    "NUL in the middle": (GOOD.encode()[:200] + b"\0" + GOOD.encode()[200:], "NUL byte in line"),
    "utf-16 without a mark": (GOOD.encode("utf-16-le"), "UTF-16"),
    "half a pair in utf-16": (("\ufeff" + GOOD).encode("utf-16-le") + b"\x00\xdc\n\x00", "damaged"),
    "hdf5": (b"\x89HDF\r\n\x1a\n" + bytes(100), "HDF5"),
    "mf4": (b"MDF     4.10" + bytes(100), "MDF"),
    "excel": (b"PK\x03\x04" + bytes(100), "Excel"),
    "truncated parquet": (parquet_bytes()[:-50], "is cut short"),
    "rubbish called parquet": (b"PAR1" + bytes(range(256)), "is cut short"),
    "short row": (GOOD.encode().replace(b"20.0,2.5,0.25", b"20.0,2.5"), r"Row 201 \(line 202\).*2 cells"),
    "long row": (GOOD.encode().replace(b"20.0,2.5,0.25", b"20.0,2.5,0.25,9,9"), r"Row 201 \(line 202\).*5 cells"),
    "unclosed quote": (GOOD.encode().replace(b"20.0,2.5", b'20.0,"2.5'), "Row|table"),
    "no time": (b"a,b\n1.5,2\n1.25,3\n1.75,1\n", "--rate HZ"),
    "only flags": (b"time_s,on\n" + b"".join(b"0.%d,%d\n" % (i, i % 2) for i in range(1, 9)), "no column of numbers"),
    "only time": (b"time_s,note\n0.1,x\n0.2,y\n0.3,z\n", "no column of numbers"),
    "a short preamble": (b"Logger X\n", "no column of numbers"),
    "a zero": (b"0", "--rate HZ"),
}


@pytest.mark.parametrize(("data", "says"), BAD.values(), ids=BAD.keys())
@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
def test_bad_bytes_are_refused_whatever_they_are_called(data: bytes, says: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(InputError, match=says) as refusal:
        read(path)
    assert refusal.value.exit_code == 3
    assert str(refusal.value).endswith((".", "?"))


def test_missing_files_and_directories_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        read(tmp_path / "nowhere.csv")
    with pytest.raises(InputError, match="directory"):
        read(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path / "a.csv" / "\0")


def test_a_forbidden_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbid(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "read_bytes", forbid)
    with pytest.raises(InputError, match="may not be read"):
        read(tmp_path / "log.csv")


def test_content_decides_and_not_the_ending(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes(parquet_bytes())
    (tmp_path / "log.parquet").write_text(GOOD)
    assert read_source(tmp_path / "log.csv").layout.format == "parquet"
    assert read_source(tmp_path / "log.parquet").layout.format == "csv"


def bad_cell(row: int, cell: str) -> str:
    lines = GOOD.splitlines()
    lines[row] = lines[row].rsplit(",", 1)[0] + "," + cell
    return "\n".join(lines)


@pytest.mark.parametrize("row", [1, 2, 50, 399])
@pytest.mark.parametrize("cell", ["err", "1.2.3", "12:30", "0x1F", "n.a."])
def test_a_bad_cell_is_named_with_the_way_out(row: int, cell: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(bad_cell(row, cell))
    with pytest.raises(InputError) as refusal:
        read(path)
    message = str(refusal.value)
    assert f"row {row} (line {row + 1})" in message
    assert repr(cell) in message
    assert "'b'" in message
    assert "--channels" in message
    assert read(path, channels=["a"]).names == ("a",)
    with pytest.raises(InputError, match="not a number"):
        read(path, channels=["b"])


@pytest.mark.parametrize(
    ("others", "advice"), [(4, "naming the others: --channels c0,c1,c2,c3"), (9, "name all others")]
)
def test_leaving_a_column_out_leaves_out_no_other(others: int, advice: str, tmp_path: Path) -> None:
    names = [f"c{k}" for k in range(others)]
    rows = [
        [f"{k / 100:.2f}", "err" if k == 50 else f"{k}.5", *(f"{k + j}.25" for j in range(others))] for k in range(90)
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(map(",".join, [["time_s", "bad", *names], *rows])))
    with pytest.raises(InputError, match=advice):
        read(path)


@pytest.mark.parametrize("column", [1, 2])
def test_leaving_a_bad_cell_out_never_names_the_time(column: int, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    cells = [line.split(",") for line in GOOD.splitlines()]
    cells[300][column] = "err"
    path.write_text("\n".join(map(",".join, cells)))
    with pytest.raises(InputError, match=f"naming the others: --channels {'ba'[column - 1]}"):
        read(path)
    path.write_text(
        "\n".join(",".join(line[: column + 1]) if column == 1 else line[0] + "," + line[2] for line in cells)
    )
    with pytest.raises(InputError, match=r"which is not a number\. Correct the cell\."):
        read(path)


@pytest.mark.parametrize("row", [1, 300])
@pytest.mark.parametrize("time", [None, "time_s"])
def test_a_bad_cell_in_the_time_is_named(row: int, time: str | None, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    lines = GOOD.splitlines()
    lines[row] = "ERR," + lines[row].partition(",")[2]
    path.write_text("\n".join(lines))
    says = rf"'time_s' holds 'ERR' in row {row} \(line {row + 1}\), which is not a number\. .*--rate HZ"
    with pytest.raises(InputError, match=says):
        read(path, time=time)
    counted = read_source(path, ReadOptions(rate_hz=10.0))
    assert counted.recording.names == ("a", "b")
    assert counted.table["time_s"][row - 1].as_py() == "ERR"


def test_options_that_do_not_fit_are_refused_with_what_there_is(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(GOOD)
    with pytest.raises(UsageError, match="the columns are 'time_s', 'a', 'b'"):
        read(path, channels=["c"])
    with pytest.raises(UsageError, match="--time names 'clock'"):
        read(path, time="clock")
    with pytest.raises(UsageError, match="which is the time column"):
        read(path, channels=["time"])
    with pytest.raises(UsageError, match="--channels is empty"):
        read(path, channels=[])
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(UsageError, match="--rate"):
            read(path, rate_hz=rate)


def test_a_name_without_unit_that_fits_two_columns_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,a (g),a (V)\n" + "".join(f"0.{i},1.5,2.5\n" for i in range(1, 9)))
    with pytest.raises(UsageError, match="matches"):
        read(path, channels=["a"])


@pytest.mark.parametrize(
    ("column", "says"),
    [
        ("0.1 0.2 0.15 0.3", "backwards"),
        ("0.1 0.2 NA 0.4", "missing"),
        ("0.1 inf inf 0.4", "missing or not finite"),
        ("5 5 5 5", "repeat|unit"),
        ("x y z w", "times"),
    ],
)
def test_a_time_that_cannot_be_is_refused(column: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,a\n" + "".join(f"{stamp},{i}.5\n" for i, stamp in enumerate(column.split())))
    with pytest.raises(TimeError, match=says):
        read_source(path, ReadOptions(time="time_s"))


def test_thousands_of_random_cuts_never_give_a_traceback(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    path = tmp_path / "log.csv"
    alphabet = np.frombuffer(b'0123456789.,;:\t "#-+eEna\n\r\xb5', np.uint8)
    for _ in range(300):
        data = bytearray(GOOD.encode()[: rng.integers(1, 400)])
        for at in rng.integers(0, len(data), 5):
            data[at] = rng.choice(alphabet)
        path.write_bytes(bytes(data))
        try:
            read(path)
        except BecalmError:
            continue
