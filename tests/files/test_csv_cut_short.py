"""CSV that ends in the middle of a row: the rows before it are read, nothing is made up, and a loss is said."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from becalm.cli.main import app
from becalm.errors import BecalmError, InputError
from becalm.files import read_source, rows
from becalm.files.csv import blocks as csv_blocks
from becalm.files.registry import read_tables

ROWS = 60
ENOUGH_ROWS = 12
"""Of fewer rows, a refusal is honest as well, and nobody can tell how many digits a last cell should have."""


def _table(head: str, line: str, end: str = "\n") -> str:
    drawn = np.random.default_rng(5).normal(0, 40, (ROWS, 2)).round(3)
    return (
        head
        + end
        + "".join(
            line.format(t=i / 8, s=i % 60, m=i // 60, v=v, w=w, n="idle" if w < 0 else "running") + end
            for i, (v, w) in enumerate(drawn)
        )
    )


WRITTEN: dict[str, str] = {
    "fixed decimals": _table("time_s,a (m/s²),b", "{t:.3f},{v:.3f},{w:.4f}"),
    "Windows": _table("time_s,a,b", "{t:.3f},{v:.3f},{w:.4f}", "\r\n"),
    "old Mac": _table("time_s,a,b", "{t:.3f},{v:.3f},{w:.4f}", "\r"),
    "exponents": _table("time_s;a;b", "{t:.3f};{v:.6e};{w:.6e}"),
    "decimal commas": _table("time_s;a;b", "{t:.3f};{v:.3f};{w:.4f}").replace(".", ","),
    "spaces": _table("time_s  a  b", "  {t:.3f}  {v:.3f}   {w:.4f}"),
    "tabs": _table("time_s\ta\tb", "{t:.3f}\t{v:.3f}\t{w:.4f}"),
    "trailing separators": _table("time_s,a,b,", "{t:.3f},{v:.3f},{w:.4f},"),
    "padded quotes": _table('"time_s","a","b"', '"{t:.3f}","{v:.3f}","{w:.4f}"'),
    "words last": _table("time_s,a,state", "{t:.3f},{v:.3f},{n}"),
    "quoted words last": _table("time_s,a,state", '{t:.3f},{v:.3f},"{n}, at {m}"'),
    "time last": _table("a,b,time", "{v:.3f},{w:.4f},2024-03-01 12:{m:02d}:{s:02d}"),
    "no header": _table("0.000,0.000,0.0000", "{t:.3f},{v:.3f},{w:.4f}").partition("\n")[2],
}


def _read(path: Path) -> tuple[pa.Table, str]:
    (table,) = read_tables(path)
    try:
        return pa.concat_tables(list(table.blocks(table.names))), " ".join(table.notes)
    finally:
        table.rows.close()


@pytest.fixture(params=["whole", "spooled"])
def road(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "spooled":
        monkeypatch.setattr(rows, "BLOCK_ROWS", 7)
        monkeypatch.setattr(rows, "MOST_MEMORY_ROWS", 0)
        monkeypatch.setattr(csv_blocks, "WHOLE_BYTES", 0)
        monkeypatch.setattr(csv_blocks, "BLOCK_BYTES", 300)
    return str(request.param)


def _ended(data: bytes, header: int) -> int:
    """Count the rows that have a line end, in another way than the reader does."""
    return sum(line.endswith((b"\n", b"\r")) for line in data.splitlines(keepends=True)) - header


def _expect_the_beginning(path: Path, whole: pa.Table, ended: int, known: bool | None = None) -> None:
    """Expect the rows that have ended, and one more only if it is all there; `known`: whether a loss must be said."""
    try:
        part, said = _read(path)
    except BecalmError:
        assert ended < ENOUGH_ROWS
        return
    assert part.num_rows in (ended, ended + 1)
    sure = ended >= ENOUGH_ROWS
    for name in part.column_names:
        cells = part[name].to_pylist()
        assert cells[: None if sure else ended] == whole[name].to_pylist()[: part.num_rows if sure else ended]
        assert None not in cells
        assert "" not in cells
    assert ("incomplete" in said) == (part.num_rows == ended if known is None else known)


@pytest.mark.parametrize("name", WRITTEN)
def test_a_text_cut_anywhere(name: str, road: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    data = WRITTEN[name].encode()
    path.write_bytes(data)
    whole, said = _read(path)
    assert (whole.num_rows, said) == (ROWS, "")
    within_last_row = range(len(data) - 30, len(data))
    for cut in (*np.random.default_rng(len(data)).integers(40, len(data), 15), *within_last_row):
        path.write_bytes(data[:cut])
        begun = data[:cut].splitlines(keepends=True)[-1]
        nothing_lost = begun.endswith((b"\n", b"\r")) or not begun.strip()
        ended = _ended(data[:cut], name != "no header")
        _expect_the_beginning(path, whole, ended, known=False if nothing_lost else None)


@pytest.mark.parametrize("name", WRITTEN)
def test_a_gzip_cut_anywhere(name: str, road: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv.gz"
    data = WRITTEN[name].encode()
    packed = gzip.compress(data)
    path.write_bytes(packed)
    whole, said = _read(path)
    assert (whole.num_rows, said) == (ROWS, "")
    for cut in np.random.default_rng(len(data)).integers(1, len(packed), 15):
        path.write_bytes(packed[:cut])
        plain = zlib.decompressobj(wbits=31).decompress(packed[:cut])
        _expect_the_beginning(path, whole, _ended(plain, name != "no header"), known=True)


@pytest.mark.parametrize("codec", ["utf-8-sig", "utf-16", "utf-8"])
def test_a_text_cut_within_a_character(codec: str, road: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    data = "".join(f"{line},é\n" for line in WRITTEN["fixed decimals"].splitlines()).encode(codec)
    path.write_bytes(data)
    whole, _ = _read(path)
    half = data.rindex("é".encode("utf-16-le" if codec == "utf-16" else "utf-8")) + 1
    path.write_bytes(data[:half])
    part, said = _read(path)
    assert part.equals(whole.slice(0, ROWS - 1))
    assert "within a character" in said


def test_one_letter_of_before_unicode_is_no_cut_character(road: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(
        b"time_s,a,note\n" + b"".join(b"%d,2.5,cafe\n" % i for i in range(40)) + "40,2.5,é".encode("cp1252")
    )
    part, said = _read(path)
    assert (part["note"][-1].as_py(), said) == ("é", "")


LEGAL: dict[str, str] = {
    "shortest decimals": "t,a\n" + "\n".join(f"{i / 8},{i / 8}" for i in range(200)),
    "a whole number at the end": "t,a\n" + "\n".join(f"{i / 8:.3f},{i * 7 % 1000}" for i in range(200)),
    "sparse last column": "t,a,b\n" + "\n".join(f"{i / 8:.3f},{i}.5,{'' if i % 7 else 2.5}" for i in range(200)),
    "a few rows": "t,a\n0,1.25\n1,2.25\n2,3.5",
    "another word at the end": "t,a,n\n" + "\n".join(f"{i},{i}.5,{'stop' if i == 99 else 'going'}" for i in range(100)),
    "end of a DOS file": "t,a\n" + "\n".join(f"{i},{i}.25" for i in range(100)) + "\n\x1a",
    "a cell of two lines": "t,n,a\n"
    + "\n".join(f'{i},"x{"" if i % 9 or not i else chr(10)}y",{i}.5' for i in range(100)),
    "two lines at the end": "t,a,n\n"
    + "\n".join(f'{i},{i}.5,"x{"" if i % 9 or not i else chr(10)}y"' for i in range(100)),
}


@pytest.mark.parametrize("text", LEGAL.values(), ids=LEGAL)
def test_a_file_may_end_without_a_line_end(text: str, road: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text + "\n")
    ended, _ = _read(path)
    path.write_text(text)
    open_ended, said = _read(path)
    assert open_ended.equals(ended)
    assert said == ""


@pytest.mark.parametrize("last", ["# end of the log", "Sum,300"])
def test_a_remark_below_the_table_is_no_row_cut_short(last: str, road: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(WRITTEN["fixed decimals"] + last)
    with pytest.raises(InputError, match=rf"Row {ROWS + 1} .* cells? where 3 are needed"):
        _read(path)


def test_a_short_row_with_a_line_end_is_refused(road: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(WRITTEN["fixed decimals"] + "7.500,1.000\n")
    with pytest.raises(InputError, match=rf"Row {ROWS + 1} .*2 cells"):
        _read(path)


def test_a_wide_row_cut_short(road: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    row = ",".join(f"{column}.{25:0<24}" for column in range(2500))  # longer than the text that tells the layout
    path.write_text("\n".join(f"{second},{row}" for second in range(20)) + f"\n20,{row[:40_000]}")
    part, said = _read(path)
    assert part.num_rows == 20
    assert "of 2501 cells" in said


def test_people_are_told(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(WRITTEN["fixed decimals"] + "7.500,1.0")
    assert read_source(path).layout.notes == (
        "The last line, row 61 (line 62), is cut short (it has 2 of 3 cells) and left out; the file is incomplete.",
    )
    seen = CliRunner().invoke(app, ["inspect", str(path)])
    assert seen.exit_code == 0
    assert "file is incomplete" in " ".join((seen.stdout + seen.stderr).split())
    done = CliRunner().invoke(app, ["clean", str(path), "-o", str(tmp_path / "calm.csv")])
    assert "file is incomplete" in " ".join(done.stderr.split())
    assert len((tmp_path / "calm.csv").read_text().splitlines()) == ROWS + 1
