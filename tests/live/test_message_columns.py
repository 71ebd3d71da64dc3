from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from becalm.live.block import LossKind
from becalm.live.messages.encoding import Encoder
from becalm.live.messages.reading import MAXIMUM_BYTES
from message_makers import arrow, columns, good, reader


@pytest.mark.parametrize(
    ("options", "payload", "stamp"),
    [
        ("", b'{"timestamp": 1700000000250, "ax": 1}', 1_700_000_000.25),  # a browser's
        ("", b'{"time": "2023-11-14T22:13:20.250Z", "ax": 1}', 1_700_000_000.25),
        ("", b'{"millis": 1500, "ax": 1}', 1.5),
        ("?time=t", b'{"t": 2, "time": 1, "ax": 1}', 2.0),
        ("?columns=t,ax", b"1700000000250,1", 1_700_000_000.25),
        ("?time=arrival", b'{"time": 1, "ax": 1}', None),
        ("?rate=10", b'{"time": 1, "ax": 1}', None),
        ("", Encoder().message({"t": np.array([1.7e12 + 250]), "ax": np.ones(1)}), 1_700_000_000.25),
        ("", Encoder().message({"millis": np.array([1500.0]), "ax": np.ones(1)}), 1.5),
        ("", Encoder(units={"time": "ms"}).message({"time": np.array([1500.0]), "ax": np.ones(1)}), 1.5),
    ],
)
def test_stamps_are_read_as_those_of_lines(options: str, payload: bytes, stamp: float | None) -> None:
    held = reader(options)
    batch = good(held, payload)
    assert held.names == ("ax",)
    assert (None if batch.time_s is None else batch.time_s.tolist()) == (None if stamp is None else [stamp])


def test_text_is_passed_over_and_units_of_headers_are_heard() -> None:
    held = reader()
    good(held, b'{"device": "north", "ax (m/s^2)": 1, "place": {"x": 1}}')
    assert (held.names, held.units) == (("ax",), ("m/s^2",))
    arrowed = reader()
    good(arrowed, arrow(pa.record_batch({"device": ["north"], "ax [m/s^2]": [1]})))
    assert (arrowed.names, arrowed.units) == (("ax",), ("m/s^2",))
    asked = reader("?channels=device")
    assert asked.read(b'{"device": "north", "ax": 1}', 0.0) is None


def test_lines_of_csv_have_the_columns_that_the_address_names() -> None:
    held = reader("?columns=seq,t,ax (m/s^2),ay&time=t")
    batch = good(held, b"5,0.1,1,2\r\n6,0.2,,nan\n")
    assert (held.names, held.units, batch.seq) == (("ax", "ay"), ("m/s^2", ""), 5)
    np.testing.assert_array_equal(batch.values, [[1, 2], [np.nan, np.nan]])
    assert held.read(b"7,0.3,1\n", 0.0) is None
    assert held.read(b"5,0.1,1,2\n7,0.2,1,2\n", 0.0) is None


def test_channels_choose_among_those_that_are_there() -> None:
    held = reader("?channels=ay")
    np.testing.assert_array_equal(good(held, Encoder().message(columns(3), 0)).values, [[0], [-1], [-2]])
    np.testing.assert_array_equal(good(held, Encoder("json").message(columns(3), 3)).values, [[0], [-1], [-2]])


def test_channels_are_found_by_name() -> None:
    held = reader()
    good(held, b'{"ax": 1, "ay": 2}')
    np.testing.assert_array_equal(good(held, b'{"ay": 20, "ax": 10}').values, [[10, 20]])
    swapped = {name: column for name, column in reversed(columns(1).items()) if name != "time"}
    np.testing.assert_array_equal(good(held, Encoder().message({**swapped, "ay": np.array([5.0])})).values, [[0, 5]])


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (b"", "neither Arrow nor JSON"),
        (b"{}", "no channels"),
        (b'{"seq": 1, "time": 2}', "no channels"),
        (b'{"ax": "1"}', "no channels"),
        (b'{"ax": [1, "1"]}', "no numbers in 'ax'"),
        (b'{"ax": {"x": 1}}', "no channels"),
        (b'{"t": 1, "time": 1, "ax": 1}', "t and time could be the time (write ?time=NAME)"),
        (b'{"time": "noon", "ax": 1}', "without a stamp"),
        (b'{"time": "12:00:00", "ax": 1}', "without a stamp"),
        (b'{"time": [], "ax": []}', "no rows"),
        (b'{"ax": true}', "no numbers in 'ax'"),
        (b'{"ax": [1, 2], "ay": [1]}', "not the same number"),
        (b'{"time": [1], "ax": [1, 2]}', "1 stamps for 2 rows"),
        (b'{"ax": [1, 2]}', "?rate=HZ"),
        (b'{"seq": -1, "ax": 1}', "seq is -1"),
        (b'{"seq": 1.5, "ax": 1}', "one by one"),
        (b'{"time": null, "ax": 1}', "without a stamp"),
        (b'{"ax": 1' + b"0" * 400 + b"}", "broken"),
        (b"[" * 100_000, "broken"),
        (b" " * (MAXIMUM_BYTES + 1), "more than 16000000"),
        (Encoder().message({"time": np.empty(0), "ax": np.empty(0)}, 0), "no rows"),
        (arrow(pa.record_batch({"ax": ["a"]})), "no channels"),
        (arrow(pa.record_batch([[1], [2]], names=["ax", "ax"])), "or two"),
        (arrow(pa.record_batch({"seq": [1, 3], "time": [1, 2], "ax": [1, 2]})), "one by one"),
        (arrow(pa.record_batch({"seq": [None, 3], "time": [1, 2], "ax": [1, 2]})), "one by one"),
        (arrow(pa.record_batch({"time": pa.array([1, None], pa.timestamp("s")), "ax": [1, 2]})), "without a stamp"),
    ],
)
def test_what_cannot_be_read_is_garbled(payload: bytes, says: str) -> None:
    held = reader()
    assert held.read(payload, 0.0) is None
    (loss,) = held.losses()
    assert (loss.kind, loss.rows) == (LossKind.GARBLED, 1)
    assert says in loss.says
    assert len(loss.says) < 300
    assert held.losses() == ()


@pytest.mark.parametrize(
    "payload",
    [b'{"time": 1, "b": 2}', b'{"ax": 2}', b'{"seq": 2, "time": 1, "ax": 2}', b'{"time": 1, "ax": 2, "b": 3}'],
)
def test_a_message_that_differs_from_the_first_is_garbled(payload: bytes) -> None:
    held = reader()
    good(held, b'{"time": 0, "ax": 1}')
    assert held.read(payload, 0.0) is None
    assert held.losses()[0].kind is LossKind.GARBLED
