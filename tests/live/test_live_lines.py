"""Rows from lines: what is good comes through, however the bytes are cut and whatever stands between."""

from __future__ import annotations

import json
from contextlib import suppress
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Block, LossKind
from becalm.live.lines.columns import LineOptions
from becalm.live.lines.line_parser import LONGEST_LINE, LineParser

_CAME_S = 1_700_000_000.0


def _read(*pieces: bytes, finish: bool = True, **told: Any) -> list[Block]:
    """Feed pieces, one a second."""
    lines = LineParser(LineOptions(**told))
    blocks = [lines.feed(piece, _CAME_S + k) for k, piece in enumerate(pieces)]
    if finish:
        blocks.append(lines.finish(_CAME_S + len(pieces)))
    return [block for block in blocks if block is not None]


def _time(blocks: list[Block]) -> list[float]:
    return [float(t) for block in blocks for t in block.time_s]


def _rows(blocks: list[Block]) -> list[list[float]]:
    return [row for block in blocks for row in block.values.tolist()]


def _lost(blocks: list[Block]) -> int:
    losses = [loss for block in blocks for loss in block.losses]
    assert all(loss.kind is LossKind.GARBLED for loss in losses)
    return sum(loss.rows or 0 for loss in losses)


def test_a_header_names_columns_units_and_the_time() -> None:
    (block,) = _read(b"time (ms),ax (g),ay_mps2,state\n1,2.5,-3,ok\n2,3.5,-4,ok\n")
    assert (block.names, block.units) == (("ax (g)", "ay_mps2"), ("g", "m/s^2"))
    assert block.time_s.tolist() == [0.001, 0.002]
    assert block.values.tolist() == [[2.5, -3.0], [3.5, -4.0]]
    assert not block.losses


def test_units_may_have_a_line_of_their_own() -> None:
    (block,) = _read(b"t;a;b\ns;m/s2;g\n1,5;1;2\n2,5;2;3\n")
    assert (block.names, block.units) == (("a", "b"), ("m/s^2", "g"))
    assert block.time_s.tolist() == [1.5, 2.5]


@pytest.mark.parametrize("separator", [",", ";", "\t", "|", " "])
def test_any_usual_separator(separator: str) -> None:
    text = "\n".join(separator.join(row) for row in (["time", "a", "b"], ["1", "2.5", "3"], ["2", "3.5", "4"], [""]))
    (block,) = _read(text.encode())
    assert block.names == ("a", "b")
    assert block.values.tolist() == [[2.5, 3.0], [3.5, 4.0]]


def test_json_lines() -> None:
    told = [{"t": 1.7e12, "ax": 1, "on": True, "id": "x"}, {"t": 1.7e12 + 5, "ax": None}, {"t": 1.7e12 + 10, "ax": 3.5}]
    (block,) = _read("".join(json.dumps(one) + "\r\n" for one in told).encode())
    assert block.names == ("ax",)
    np.testing.assert_allclose(block.time_s, [1.7e9, 1.7e9 + 0.005, 1.7e9 + 0.01])
    np.testing.assert_array_equal(block.values, [[1.0], [np.nan], [3.5]])
    assert not block.losses


@pytest.mark.parametrize(
    ("header", "cell", "seconds"),
    [
        ("time", "1.25", 1.25),
        ("time_us", "1250000", 1.25),
        ("millis", "1250", 1.25),
        ("t (min)", "2", 120.0),
        ("timestamp", "1700000000.5", 1700000000.5),
        ("timestamp", "1700000000500", 1700000000.5),
        ("timestamp", "1700000000500000", 1700000000.5),
        ("timestamp", "1700000000500000000", 1700000000.5),
        ("time", "2023-11-14T22:13:20.5Z", 1700000000.5),
        ("time", "2023-11-14 23:13:20.500+01:00", 1700000000.5),
        ("time", "2023/11/14 22:13:20.5", 1700000000.5),
        ("time", "1970-01-01T00:00:01Z", 1.0),
    ],
)
def test_a_stamp_may_be_written_in_many_ways(header: str, cell: str, seconds: float) -> None:
    blocks = _read(f"{header},a\n{cell},1\n{cell},2\n".encode())
    assert _time(blocks) == [seconds, seconds]


def test_no_header_and_no_names_are_numbered_columns() -> None:
    (block,) = _read(b"1,2\n3,4\n5,6\n")
    assert block.names == ("column_1", "column_2")
    assert block.values.tolist() == [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]


def test_columns_may_be_told() -> None:
    (block,) = _read(b"1 2 3\n4 5 6\n", columns=("time", "a", "b"))
    assert block.names == ("a", "b")
    assert block.time_s.tolist() == [1.0, 4.0]


def test_rows_without_stamps_are_stamped_when_they_come() -> None:
    blocks = _read(b"a\n1\n2\n", b"3\n4\n5\n6\n")
    times = _time(blocks)
    assert all(later > earlier for earlier, later in pairwise(times))
    assert times[1] == _CAME_S
    assert times[5] == _CAME_S + 1
    assert times[2] >= _CAME_S + 0.9


def test_rows_may_be_counted_and_lost_ones_are_counted_too() -> None:
    blocks = _read(b"time,a\n7,1\n", b"7,2\nnoise\n7,4\n", b"7,5\n", rate_hz=10.0)
    assert [block.names for block in blocks] == [("a",)] * 3
    np.testing.assert_allclose(np.array(_time(blocks)) - _CAME_S, [0.0, 0.1, 0.3, 0.4], atol=1e-6)


def test_time_may_be_arrival_though_a_column_tells_one() -> None:
    blocks = _read(b"time,a\n7,1\n7,2\n", time="arrival")
    assert blocks[0].names == ("a",)
    assert _time(blocks)[-1] == _CAME_S


_GARBAGE = [
    b"\x00\xfe\x80\x01",
    b"word",
    b"1,2",
    b"1,2,3,4",
    b"time,a,b",
    b",5,6",
    b"nan,5,6",
    b"yesterday,5,6",
    b"9,x,y",
    b'{"time": 1}',
    b'"9,5,6',
    b"9;5;6",
    b"[" * 100_000,
]


@pytest.mark.parametrize("garbage", _GARBAGE)
def test_garbage_is_counted_and_told(garbage: bytes) -> None:
    blocks = _read(b"time,a,b\n1,2,3\n", garbage + b"\n2,4,5\n")
    assert _rows(blocks) == [[2.0, 3.0], [4.0, 5.0]]
    assert _lost(blocks) == 1
    told = blocks[1].losses[0].says
    assert "could not be read" in told
    assert len(told) < 400


def test_a_bad_cell_is_a_missing_reading() -> None:
    blocks = _read(b"time,a,b\n1,2,3\n2,x1,5\n3,,NaN\n4,1e300,inf\n5,1_0,7\n")
    np.testing.assert_array_equal(
        _rows(blocks), [[2.0, 3.0], [np.nan, 5.0], [np.nan] * 2, [1e300, np.inf], [np.nan, 7.0]]
    )
    assert _lost(blocks) == 2
    assert "'2,x1,5': 'a' is not a number" in blocks[0].losses[0].says


def test_a_first_row_with_a_bad_cell_hides_no_channel() -> None:
    blocks = _read(b"time,a,b\n1,ERR,3\n2,4,5\n")
    assert blocks[0].names == ("a", "b")
    np.testing.assert_array_equal(_rows(blocks), [[np.nan, 3.0], [4.0, 5.0]])
    assert _lost(blocks) == 1


def test_columns_of_words_only_pass() -> None:
    blocks = _read(b"1;ok;2\n2;bad;3\n", columns=("time", "state", "a"))
    assert blocks[0].names == ("a",)
    assert _rows(blocks) == [[2.0], [3.0]]


def test_blank_lines_and_remarks_are_no_losses() -> None:
    blocks = _read(b"# made by a logger\n\ntime,a\n\r\n1,2\r\n\r\n# status ok\r2,3\r")
    assert _rows(blocks) == [[2.0], [3.0]]
    assert _lost(blocks) == 0


def test_noise_above_the_header_hides_nothing() -> None:
    blocks = _read(b"\xff\xfe\x00\nbooting, please wait\ntime,a,b\n1,2,3\n")
    assert blocks[-1].names == ("a", "b")
    assert _rows(blocks) == [[2.0, 3.0]]
    assert _lost(blocks) == 2


def test_a_last_line_without_its_end_is_not_trusted() -> None:
    blocks = _read(b"time,a\n1,2.25\n2,2.2")
    assert _rows(blocks) == [[2.25]]
    assert _lost(blocks) == 1
    assert _rows(_read(b'{"a":1}\n{"a":2}')) == [[1.0], [2.0]]


def test_lines_without_end_are_not_held() -> None:
    lines = LineParser(LineOptions())
    lines.feed(b"time,a\n1,2\n", _CAME_S)
    blocks = [lines.feed(b"9" * 300_000, _CAME_S) for _ in range(50)]
    blocks += [lines.feed(b"\n3,4\n", _CAME_S)]
    found = [block for block in blocks if block is not None]
    assert _rows(found) == [[4.0]]
    assert _lost(found) == 1
    assert len(lines._half) <= LONGEST_LINE


def test_what_says_nothing_at_all_is_counted() -> None:
    blocks = _read(b"hello\n" * 250)
    assert _lost(blocks) == 250
    assert all(block.names == () for block in blocks)


def test_after_a_break_a_half_line_is_left_out() -> None:
    lines = LineParser(LineOptions())
    first = lines.feed(b"time,a\n1,2\n2,3", _CAME_S)
    lines.expect_partial_line()
    second = lines.feed(b"5,44\n4,5\n", _CAME_S + 1)
    assert first is not None
    assert second is not None
    assert _rows([first, second]) == [[2.0], [5.0]]
    assert not second.losses


@pytest.mark.parametrize(
    ("told", "text", "said"),
    [
        ({"time": "when"}, b"time,a\n1,2\n", "names 'when', which is not a column"),
        ({"channels": ("z",)}, b"time,a\n1,2\n", "names 'z', which is not a column"),
        ({}, b"time,utc,a\n1,2,3\n", "2 columns could be the time"),
        ({}, b"time,a\n12:00:01,2\n", "have no ISO date"),
        ({"time": "time"}, b"time (ticks),a\n1,2\n", "the unit .ticks., which is not one of time"),
    ],
)
def test_what_was_said_must_fit(told: dict[str, Any], text: bytes, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        _read(text, **told)


def test_a_garbled_line_takes_its_time_however_lines_come() -> None:
    pieces = [b"a\n0\n", b"1\n", b"\xff?\n", b"3\n", b"?,?\n?\n", b"6\n"]
    for cuts in (pieces, [b"".join(pieces)]):
        lines = LineParser(LineOptions.of(Address.parsed("stdin:?format=csv&rate=10")))
        found = [block for cut in cuts if (block := lines.feed(cut, 100.0)) is not None]
        stamps = np.concatenate([block.time_s for block in found])
        np.testing.assert_allclose(stamps - stamps[0], [0.0, 0.1, 0.3, 0.6])


def test_lines_above_the_first_row_take_no_time() -> None:
    for pieces in ((b"a\n", b"\xff?\n?\n", b"1\n2\n"), (b"a\n1\n2\n",)):
        (block,) = [one for one in _read(*pieces, rate_hz=10.0, columns=("a",)) if len(one)]
        np.testing.assert_allclose(block.time_s - _CAME_S - len(pieces) + 1, [0.0, 0.1], atol=1e-6)


@pytest.mark.parametrize("pieces", [1, 2])
@pytest.mark.parametrize("mark", ["", "# "])
def test_a_header_in_another_order_moves_the_channels(pieces: int, mark: str) -> None:
    first, second = f"{mark}time,ax,ay\n1,2,3\n".encode(), f"{mark}time,ay,ax\n2,30,20\n".encode()
    third = first.replace(b"1,", b"3,")
    blocks = _read(*((first + second + third,) if pieces == 1 else (first, second, third)))
    assert _rows(blocks) == [[2.0, 3.0], [20.0, 30.0], [2.0, 3.0]]
    assert _lost(blocks) == (0 if mark else 2)


@pytest.mark.parametrize("header", [b"time,ax (g),ay", b"time,ax (m/s^2),az"])
def test_a_header_with_other_names_or_units_is_refused(header: bytes) -> None:
    lines = LineParser(LineOptions())
    block = lines.feed(b"time,ax (m/s^2),ay\n1,2,3\n" + header + b"\n2,1,3\n", _CAME_S)
    assert block is not None
    assert block.values.tolist() == [[2.0, 3.0]]
    with pytest.raises(InputError, match=r"other names or units: time, ax .*; the first was time, ax"):
        lines.finish(_CAME_S)


def test_a_repeated_header_is_garbled_however_it_is_written() -> None:
    blocks = _read(b"%time\ta\ta\t\n1\t2\t3\t4\n%time\ta\ta\t\n2\t3\t4\t5\n")
    assert _rows(blocks) == [[1.0, 2.0, 3.0, 4.0], [2.0, 3.0, 4.0, 5.0]]
    assert _lost(blocks) == 1


@pytest.mark.parametrize("rows", [b"0.999\t999\n1.000\t1,000\n1.001\t998\n", b"0\t0,5\n1\t0.5\n2\t1,5\n"])
@pytest.mark.parametrize("pieces", [1, 2])
def test_a_comma_beside_a_point_is_no_decimal_sign(rows: bytes, pieces: int) -> None:
    lines = rows.splitlines(keepends=True)
    blocks = _read(b"time\ta\n", *((rows,) if pieces == 1 else lines))
    assert _rows(blocks) == ([[999.0], [998.0]] if b"999" in rows else [[0.5], [1.5]])
    assert _lost(blocks) == 1


def test_a_decimal_comma_stands_beside_dates_with_points() -> None:
    blocks = _read(b"time;a\n2023-11-14 22:13:20.5;1,5\n2023-11-14 22:13:20.6;2\n2023-11-14 22:13:20.7;3,5\n")
    assert _rows(blocks) == [[1.5], [2.0], [3.5]]
    assert not _lost(blocks)


@pytest.mark.parametrize("pieces", [(b"\xef\xbb\xbftime,a\n1,2\n",), (b"\xef", b"\xbb", b"\xbftime,a\n1,2\n")])
def test_a_byte_order_mark_is_no_text(pieces: tuple[bytes, ...]) -> None:
    (block,) = _read(*pieces)
    assert (block.names, block.time_s.tolist(), block.losses) == (("a",), [1.0], ())


@pytest.mark.parametrize(
    "text",
    [
        b"time,a,b\n1,2,off\n2,3,off\n3,4,5\n4,5,6\n",
        b'{"time": 1, "a": 2}\n{"time": 2, "a": 3, "b": 4}\n{"time": 3, "a": 4, "b": 5}\n',
        b'{"time": 1, "a": 2, "b": "off"}\n{"time": 2, "a": 3, "b": 4}\n{"time": 3, "a": 4, "b": 5}\n',
    ],
)
def test_a_column_that_has_numbers_too_late_is_reported_once(text: bytes) -> None:
    blocks = _read(*text.splitlines(keepends=True))
    assert blocks[-1].names == ("a",)
    (loss,) = [loss for block in blocks for loss in block.losses]
    assert "'b' has a number but had none at first" in loss.says
    assert not _lost(_read(*text.splitlines(keepends=True), channels=("a",)))


@pytest.mark.parametrize("login", ["u:p@ss", "u:pa/ss", "u", "u:p:q@/"])
def test_an_address_is_shown_without_its_login(login: str) -> None:
    assert str(Address.parsed(f"mqtt://{login}@host:1883/topic?qos=1")) == "mqtt://host:1883/topic?qos=1"


@pytest.mark.parametrize("number", ["inf", "nan", "-inf"])
def test_an_option_is_a_finite_number(number: str) -> None:
    with pytest.raises(UsageError, match=f"rows={number} is not a number"):
        Address.parsed(f"parquet:out?rows={number}").number("rows", 0.0, least=1)


def test_options_of_an_address() -> None:
    told = LineOptions.of(Address.parsed("stdin:?format=csv&columns=time,a&channels=a&time=time"))
    assert told == LineOptions("csv", ("time", "a"), "time", None, ("a",))
    for wrong in ("format=xml", "rate=0", "rate=fast", "rate=10&time=t"):
        with pytest.raises(UsageError):
            LineOptions.of(Address.parsed(f"stdin:?{wrong}"))


_good = st.tuples(st.floats(allow_nan=False, allow_infinity=False), st.floats(allow_nan=False)).map(
    lambda pair: f"{pair[0]!r},{pair[1]!r}".encode()
)
_noise = st.binary(max_size=12).map(lambda some: b"\xff" + some.replace(b"\n", b"").replace(b"\r", b""))
_ends = st.sampled_from([b"\n", b"\r\n", b"\r"])


@given(st.lists(st.tuples(st.one_of(_good, _noise, st.just(b"")), _ends)), st.data())
def test_the_same_rows_however_cut(lines: list[tuple[bytes, bytes]], data: st.DataObject) -> None:
    stream = b"time,a\n0,0\n" + b"".join(line + end for line, end in lines)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    pieces = [stream[start:stop] for start, stop in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    whole, cut = _read(stream), _read(*pieces)
    good = [line.split(b",") for line, _ in lines if line and line[:1] != b"\xff"]
    assert _rows(whole) == [[0.0], *([float(value)] for _, value in good)]
    assert _time(whole) == [0.0, *(float(stamp) for stamp, _ in good)]
    assert (_rows(cut), _time(cut), _lost(cut)) == (_rows(whole), _time(whole), _lost(whole))
    assert _lost(whole) == sum(line[:1] == b"\xff" for line, _ in lines)


@given(st.lists(st.binary(max_size=200)), st.sampled_from(["auto", "csv", "json"]))
def test_no_bytes_raise(pieces: list[bytes], how: str) -> None:
    for block in _read(*pieces, format=how, time="arrival"):
        assert block.values.shape == (len(block), len(block.names))


_cells = st.sampled_from(
    [b"1", b"-2.5", b"nan", b"", b"x", b"t", b"1e999", b"2020-01-01", b'"', b'{"a":1}', b"{", b"1,5"]
)
_ragged = st.lists(st.lists(_cells, max_size=4).map(b",".join), max_size=12).map(b"\n".join)


def _read_until_refused(*pieces: bytes) -> list[Block]:
    """Feed pieces up to a header with other names."""
    lines, blocks = LineParser(LineOptions(rate_hz=0.125)), list[Block | None]()
    with suppress(InputError):
        blocks.extend(lines.feed(piece, _CAME_S) for piece in pieces)
        blocks.append(lines.finish(_CAME_S))
    return [block for block in blocks if block is not None]


@given(_ragged, st.integers(0, 100))
def test_ragged_tables_are_read_alike_however_cut(text: bytes, at: int) -> None:
    whole, cut = (_read_until_refused(*pieces) for pieces in ((text,), (text[:at], text[at:])))
    np.testing.assert_array_equal(np.diff(_time(whole)), np.diff(_time(cut)))
    np.testing.assert_array_equal(_rows(whole), _rows(cut))
    assert _lost(whole) == _lost(cut)
