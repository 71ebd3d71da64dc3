"""A stray quote in a CSV is refused with its row and line; cells of several lines are read."""

from __future__ import annotations

import csv
import gzip
import io
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from becalm.errors import InputError
from becalm.files import open_source, read
from becalm.files.csv import blocks as csv_blocks
from becalm.files.csv import broken_rows

ROWS = [[f"{i / 100:.2f}", f"{i % 7}.25", f"ok {i}"] for i in range(3000)]
HEADS = ("t", "a", "note")


def written(rows: list[list[str]], heads: tuple[str, ...] = HEADS, separator: str = ",", end: str = "\n") -> str:
    return "".join(separator.join(row) + end for row in [list(heads), *rows])


def with_cells(cells: dict[int, str], column: int = 2) -> list[list[str]]:
    """The rows with other cells; rows are counted from 1."""
    rows = [list(row) for row in ROWS]
    for number, cell in cells.items():
        rows[number - 1][column] = cell
    return rows


WAYS = ["whole", "blocks of 16 MB", "blocks of 1000 bytes", "blocks of 61 bytes"]


@pytest.fixture(params=WAYS)
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Read whole, and in blocks of several sizes."""
    name = str(request.param)
    if name != "whole":
        monkeypatch.setattr(csv_blocks, "WHOLE_BYTES", 0)
    if name.endswith("bytes"):
        monkeypatch.setattr(csv_blocks, "BLOCK_BYTES", int(name.split()[2]))
    return name


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as refused:
        read(path)
    return str(refused.value)


def cells_of(path: Path, name: str) -> list[str]:
    with open_source(path) as source:
        return [cell.as_py() for cell in source.table().column(name)]


STRAYS: dict[str, tuple[str, str]] = {
    "unclosed": (written(with_cells({2001: '"hello'})), "includes lines"),
    "two unclosed": (written(with_cells({2001: '"hello', 2501: '"bye'})), "includes lines"),
    "two unclosed in rows that touch": (written(with_cells({2001: '"hello', 2002: '"bye'})), "includes lines"),
    "unclosed, doubled at its end": (written(with_cells({2001: '"hello""'})), "includes lines"),
    "before a quoted cell": (written(with_cells({2001: '"hello', 2005: '"a, b"'})), "includes lines"),
    "two opened, one closed": (written(with_cells({2001: '"hello', 2002: 'bye"'})), "includes lines"),
    "below notes of several lines": (
        written(with_cells({7: '"one\ntwo"', 2000: "x", 2001: '"hello'})).replace("ok 8\n", "ok 8\n\n"),
        "includes lines",
    ),
    "in a number": (written(with_cells({2001: '"2.25'}, column=1)), "includes lines"),
    "in two numbers": (written(with_cells({2001: '"2.25', 2002: '"3.25'}, column=1)), "includes lines"),
    "in the first column": (
        written([row[::-1] for row in with_cells({2001: '"hello', 2002: '"bye'})], HEADS[::-1]),
        "includes lines",
    ),
    "semicolon, decimal comma": (
        written(with_cells({2001: '"hello', 2002: '"bye'}), separator=";").replace(".", ","),
        "includes lines",
    ),
    "tab": (written(with_cells({2001: '"hello'}), separator="\t").replace("ok ", "ok"), "includes lines"),
    "pipe": (written(with_cells({2001: '"hello', 2501: '"bye'}), separator="|"), "includes lines"),
    "spaces": (
        written(with_cells({2001: '"hello', 2501: '"bye'}), separator="  ").replace("ok ", "ok"),
        "includes lines",
    ),
    "crlf": (written(with_cells({2001: '"hello', 2501: '"bye'}), end="\r\n"), "includes lines"),
    "old mac": (written(with_cells({2001: '"hello', 2501: '"bye'}), end="\r"), "includes lines"),
    "of a huge cell": (written(with_cells({2001: '"' + "hello " * 30_000})), "includes lines"),
    "closed inside another cell": (
        written(with_cells({2001: '"hello\nworld', 2002: '"bye"'})).replace("20.01,6.25", "x"),
        "before 'bye\"'",
    ),
}


@pytest.mark.parametrize(
    ("name", "way"),
    [(name, way) for k, name in enumerate(STRAYS) for way in (WAYS[0], WAYS[1 + k % 3])],
    indirect=["way"],
)
def test_a_stray_quote_is_refused_with_its_row_and_line(name: str, way: str, tmp_path: Path) -> None:
    path, (text, says) = tmp_path / "log.csv", STRAYS[name]
    path.write_bytes(text.encode())
    line = len(re.findall(r"\r\n|\n|\r", text[: re.search(r'"(?:hello|2[.,]25)', text).start()])) + 1  # type: ignore[union-attr]
    message = refusal(path)
    assert f"Row 2001 (line {line}) of {path} opens a quoted cell" in message
    assert says in message
    assert "Remove that quote" in message


@pytest.mark.parametrize("level", [1, 9])
def test_a_stray_quote_in_an_archive_is_refused(level: int, way: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(STRAYS["two unclosed"][0].encode(), level))
    assert "Row 2001 (line 2002)" in refusal(path)


@pytest.mark.parametrize("last", ['"hello', '"', '"one\ntwo', '"hello""', '"\n\n'])
def test_a_last_cell_that_is_never_closed_is_refused(last: str, way: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(written(with_cells({3000: last})))
    assert f"Row 3000 (line 3001) of {path} opens a quoted cell that is never closed" in refusal(path)


def test_a_cell_without_end_is_not_held_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond a length a cell counts as never closed, even if a quote comes at last."""
    monkeypatch.setattr(csv_blocks, "WHOLE_BYTES", 0)
    monkeypatch.setattr(csv_blocks, "BLOCK_BYTES", 1000)
    path = tmp_path / "log.csv"
    path.write_text(written(with_cells({2001: '"hello' + ("\n" + "x" * 500) * 12 + '"'})))
    assert len(cells_of(path, "note")) == 3000
    monkeypatch.setattr(broken_rows, "_LONGEST_CELL", 5000)
    assert f"Row 2001 (line 2002) of {path} opens a quoted cell that is never closed" in refusal(path)


def test_a_stray_quote_in_a_single_column_is_refused(way: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("force\n" + "".join(f"{i % 9}.5\n" for i in range(200)) + '"7.5\n8.5\n')
    assert "Row 201 (line 202)" in refusal(path)


def test_a_row_is_named_by_its_first_line(way: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(written(with_cells({5: '"one\ntwo"', 9: '"one\ntwo\nthree",7'})))
    assert f"Row 9 (line 11) of {path} has 4 cells where 3 are needed" in refusal(path)


def test_a_ragged_row_beside_a_huge_cell_is_named(way: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(written(with_cells({50: "x" * 140_000, 900: "x,y"})))
    assert f"Row 900 (line 901) of {path} has 4 cells" in refusal(path)


@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("cells", [{1: '"hello'}, {1: '"hello', 2: '"bye'}])
def test_a_stray_quote_in_the_first_rows_is_refused(
    cells: dict[int, str], column: int, way: str, tmp_path: Path
) -> None:
    path = tmp_path / "log.csv"
    order = [[2, 0, 1], [0, 2, 1], [0, 1, 2]][column]
    path.write_text(written([[row[i] for i in order] for row in with_cells(cells)], tuple(HEADS[i] for i in order)))
    message = refusal(path)
    assert "ine 2" in message
    assert "opens a quoted cell" in message


@pytest.mark.parametrize("names", ['t,a,"note', '"t,a,note', 't,"a,note'])
def test_a_stray_quote_in_the_names_is_refused(names: str, way: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(names + "\n" + written(ROWS).partition("\n")[2])
    assert "Line 1 of" in refusal(path)


def test_a_note_above_the_table_may_have_several_lines(way: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text('"Made in March\nby logger 7"\n' + written(ROWS))
    assert cells_of(path, "note")[:2] == ["ok 0", "ok 1"]


NOTES = {
    "two lines": "one\ntwo",
    "blank lines": "\n\none\n\n",
    "crlf": "one\r\ntwo",
    "separators": "valve checked, pump, too\nall fine, see list, page 9\nend",
    "numbers": "readings:\n1.5\n2.5\n",
    "quotes": 'he said "go"\n"no", said she\n"',
    "long": "a line, of a long note\n" * 100,
    "inches": 'pipe of 5"\nand 6" more',
}


@pytest.mark.parametrize(("number", "name"), list(enumerate(NOTES)))
def test_notes_of_several_lines_are_read(number: int, name: str, way: str, tmp_path: Path) -> None:
    path, note, column = tmp_path / "log.csv", NOTES[name], (number + WAYS.index(way)) % 3
    quoted = '"' + note.replace('"', '""') + '"'
    order = [[2, 0, 1], [0, 2, 1], [0, 1, 2]][column]
    rows = [[row[i] for i in order] for row in with_cells({100: quoted, 101: quoted, 1800: quoted})]
    path.write_bytes(written(rows, tuple(HEADS[i] for i in order)).encode())
    cells = cells_of(path, "note")
    assert len(cells) == 3000
    assert cells[99] == cells[100] == cells[1799] == note


def test_a_quote_inside_a_cell_opens_nothing(way: str, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(written(with_cells({100: '5" pipe', 200: '"a"b', 300: '"a ""b"" c"', 301: '""'})))
    cells = cells_of(path, "note")
    assert [cells[i - 1] for i in (100, 200, 300, 301)] == ['5" pipe', "ab", 'a "b" c', ""]
    assert len(cells) == 3000


def as_csv(rows: list[list[str]], order: list[int], separator: str, end: str) -> str:
    text = io.StringIO()
    writer = csv.writer(text, delimiter=separator, lineterminator=end, quoting=csv.QUOTE_NONNUMERIC)
    writer.writerow([HEADS[i] for i in order])
    writer.writerows([[row[i] if i == 2 else float(row[i]) for i in order] for row in rows])
    return text.getvalue()


WORDS = st.text('ab ,;"\n', max_size=6) | st.sampled_from(["", "ok", "a, b", 'say "go"', "one\ntwo"])


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    notes=st.lists(WORDS, min_size=1, max_size=12),
    style=st.tuples(st.permutations([0, 1, 2]), st.sampled_from(",;|"), st.sampled_from(["\n", "\r\n"])),
    where=st.tuples(st.integers(1, 40), st.sampled_from([0, 1, 50, 100_000])),
    data=st.data(),
)
def test_without_some_quotes_a_file_is_refused_or_no_row_is_lost(
    notes: list[str], style: tuple[list[int], str, str], where: tuple[int, int], data: st.DataObject, tmp_path: Path
) -> None:
    """Rows with plain notes stand around, so that the file is known for a table."""
    before, block = where
    all_notes = ["ok"] * before + notes + ["ok"] * (50 - before)
    rows = [[f"{i / 4}", f"{i % 3}.5", note] for i, note in enumerate(all_notes)]
    text = as_csv(rows, *style)
    quotes = [found.start() for found in re.finditer('"', text) if found.start() > text.index("0.0")]
    gone = set(data.draw(st.lists(st.sampled_from(quotes), max_size=5)))
    path = tmp_path / "log.csv"
    path.write_bytes("".join(sign for at, sign in enumerate(text) if at not in gone).encode())
    with pytest.MonkeyPatch.context() as patched:
        if block:
            patched.setattr(csv_blocks, "WHOLE_BYTES", 0)
            patched.setattr(csv_blocks, "BLOCK_BYTES", block)
        try:
            stamps = cells_of(path, "t")
        except InputError:
            return
    assert {float(row[0]) for row in rows} <= set(np.asarray(stamps, float))
