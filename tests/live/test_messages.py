from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from becalm.core.arrays import Codes, Floats
from becalm.errors import UsageError
from becalm.live.address import Address
from becalm.live.block import Head, Output
from becalm.live.messages.encoding import FORMATS, Encoder
from becalm.live.messages.reading import MessageRows
from becalm.live.messages.stream import MessageStream
from message_makers import arrow, columns, good, reader


def whole(batches: list[MessageRows]) -> Iterator[tuple[int | None, float | None, tuple[float, ...]]]:
    """Tell batches row by row, so that those cut in other places compare."""
    for batch in batches:
        for row in range(len(batch)):
            stamp = None if batch.time_s is None else float(batch.time_s[row])
            yield (
                None if batch.seq is None else batch.seq + row,
                stamp,
                tuple(np.nan_to_num(batch.values[row], nan=1e9)),
            )


@pytest.mark.parametrize("form", FORMATS)
@given(
    values=arrays(np.float64, st.tuples(st.integers(1, 20), st.integers(1, 4)), elements=st.floats(width=64)),
    seq=st.none() | st.integers(0, 2**52),
    began_s=st.floats(-1e10, 1e10),
)
def test_what_is_encoded_is_read(form: str, values: Floats, seq: int | None, began_s: float) -> None:
    if form == "json":
        values = np.where(np.isfinite(values), values, np.nan)  # it has no word for infinity
    names = [f"channel {k}" for k in range(values.shape[1])]
    told: dict[str, Floats | Codes] = {"time": began_s + np.arange(len(values)) / 7}
    told |= {name: values[:, k] for k, name in enumerate(names)}
    held = reader()
    batch = good(held, Encoder(form, {names[0]: "m/s^2"}).message(told, seq))
    assert batch.seq == seq
    assert batch.time_s is not None
    np.testing.assert_array_equal(batch.time_s, told["time"])
    np.testing.assert_array_equal(batch.values, values)
    assert held.names == tuple(names)
    assert held.units == ("m/s^2", *[""] * (len(names) - 1))
    assert batch.values.flags.c_contiguous


@pytest.mark.parametrize("form", FORMATS)
def test_an_output_is_read_as_it_was_told(form: str) -> None:
    head = Head(("ax",), ("m/s^2",), 100.0, "")
    column = np.array([[1.0], [np.nan], [3.0]])
    verdicts = np.array([[0], [1], [2]], dtype=np.int8)
    output = Output(40, np.arange(3) / 100, column, column + 1, column + 2, verdicts)
    held = reader()
    batch = good(held, Encoder.of(head, form).output(output, head))
    assert held.names == ("ax", "ax_sigma", "ax_verdict")
    assert held.units == ("m/s^2", "m/s^2", "")
    assert batch.seq == 40
    np.testing.assert_array_equal(batch.values, np.hstack([column + 1, column + 2, verdicts]))


@pytest.mark.parametrize("names", [("time",), ("seq", "b"), ("a", "a_sigma"), ("a_verdict", "a")])
def test_columns_that_would_have_one_name_are_refused(names: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match="Two columns"):
        Encoder.of(Head(names, ("",) * len(names), 100.0, ""), "arrow")


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_counted(payload: bytes) -> None:
    for options in ("", "?columns=time,ax"):
        held = reader(options)
        batch = held.read(payload, 0.0)
        assert (batch is None) == (len(held.losses()) == 1)


@given(st.data(), st.sampled_from(FORMATS))
def test_a_broken_message_is_read_or_counted(data: st.DataObject, form: str) -> None:
    payload = bytearray(Encoder(form).message(columns(4), 8))
    for _ in range(data.draw(st.integers(1, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    broken = bytes(payload[: data.draw(st.integers(0, len(payload)))])
    held = reader()
    for batch in (held.read(broken, 0.0), *held.read_many([(broken, 0.0)] * 3)):
        assert batch is None or np.isfinite(batch.values).size


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(["seq", "time", "ax", "units"]), inner),
    )
)
def test_any_json_is_read_or_counted(held: object) -> None:
    payload = json.dumps(held).encode()
    told = reader()
    assert (told.read(payload, 0.0) is None) == bool(told.losses())


@given(st.lists(st.sampled_from(["next", "again", "gap", "unlike", "broken", "text", "uncounted"]), max_size=12))
def test_many_at_once_are_the_same_as_one_by_one(kinds: list[str]) -> None:
    encoder, seq, messages = Encoder(), 0, [Encoder().message(columns(3), 0)]
    for kind in kinds:
        seq += {"again": 0, "gap": 20}.get(kind, 3)
        payload = encoder.message(columns(3, seq), None if kind == "uncounted" else seq)
        if kind == "unlike":
            payload = encoder.message({"time": columns(3)["time"], "b": np.zeros(3)}, seq)
        messages.append({"broken": payload[:-30], "text": b"1,2,3"}.get(kind, payload))
    at_once, singly = reader(), reader()
    pairs = [(payload, 0.0) for payload in messages]
    got = at_once.read_many(pairs[:1]) + at_once.read_many(pairs[1:])
    expected = [batch for payload in messages if (batch := singly.read(payload, 0.0)) is not None]
    assert list(whole(got)) == list(whole(expected))
    assert [loss.rows for loss in at_once.losses()] == [loss.rows for loss in singly.losses()]


def test_what_follows_is_joined_and_what_does_not_is_cut() -> None:
    held, encoder = reader(), Encoder()
    messages = [(encoder.message(columns(10, seq), seq), 0.0) for seq in (0, 10, 20, 40, 50)]
    held.read(*messages[0])
    assert [(batch.seq, len(batch)) for batch in held.read_many(messages)] == [(0, 30), (40, 20)]


@pytest.mark.parametrize(
    ("payload", "seq", "time_s", "values"),
    [
        (b'{"seq": 17, "time": 1.5, "ax": 0.1}', 17, [1.5], [[0.1]]),
        (b'{"seq": 17, "time": [1, 2], "ax": [3, null], "ay": [5, 6]}', 17, [1, 2], [[3, 5], [np.nan, 6]]),
        (b'[{"seq": 4, "time": 1, "ax": 2}, {"seq": 5, "time": 2, "ax": 3}]', 4, [1, 2], [[2], [3]]),
        (b' {"ax": 7}', None, None, [[7]]),
    ],
)
def test_json_in_all_its_forms(
    payload: bytes, seq: int | None, time_s: list[float] | None, values: list[Floats]
) -> None:
    batch = good(reader(), payload)
    assert batch.seq == seq
    assert (None if batch.time_s is None else batch.time_s.tolist()) == time_s
    np.testing.assert_array_equal(batch.values, values)


def test_units_are_heard_in_json() -> None:
    held = reader()
    good(held, b'{"ax": 1, "ay": 2, "units": {"ay": "g"}}')
    assert (held.names, held.units) == (("ax", "ay"), ("", "g"))


@pytest.mark.parametrize("form", FORMATS)
def test_a_message_in_another_unit_is_garbled(form: str) -> None:
    held = reader()
    for unit in ("m/s^2", "g", "", "m/s^2"):
        held.read(Encoder(form, {"ax": unit}).message({"time": np.zeros(1), "ax": np.ones(1)}, 0), 0.0)
    (loss,) = held.losses()
    assert (loss.rows, held.units) == (1, ("m/s^2",))
    assert "whose 'ax' is in 'g', not in 'm/s^2'" in loss.says


def test_a_unit_follows_its_channel_in_another_order() -> None:
    held = reader()
    good(held, b'{"ax": 1, "ay": 2, "units": {"ax": "m/s^2", "ay": "g"}}')
    good(held, b'{"ay": 2, "ax": 1, "units": {"ax": "m/s^2", "ay": "g"}}')
    assert held.read(b'{"ay": 2, "ax": 1, "units": {"ax": "g", "ay": "m/s^2"}}', 0.0) is None


def test_no_unit_is_not_the_word_none() -> None:
    held = reader()
    good(held, b'{"ax": 1, "units": {"ax": null}}')
    assert held.units == ("",)


def test_columns_of_one_name_are_refused() -> None:
    with pytest.raises(UsageError, match="columns= has 'ax' twice; give each of them another name"):
        reader("?columns=time,ax,ax")


def test_arrow_of_other_writers_is_read() -> None:
    stamps = pa.array([1_700_000_000_000, 1_700_000_000_010], pa.timestamp("ms", tz="UTC"))
    small = pa.array([1, None], pa.int16())
    batch = pa.record_batch(
        {"time": stamps, "seq": pa.array([3, 4], pa.uint32()), "ax": small, "ay": pa.array([1, 2], pa.float32())}
    )
    held = reader()
    one = good(held, arrow(batch))
    assert one.time_s is not None
    np.testing.assert_allclose(one.time_s, [1.7e9, 1.7e9 + 0.01], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(one.values, [[1, 1], [np.nan, 2]])
    assert one.seq == 3
    following = batch.set_column(1, "seq", pa.array([5, 6], pa.uint32()))
    assert good(held, arrow(batch, following)).seq == 3
    assert len(held.read_many([(arrow(batch), 0.0), (arrow(following), 0.0)])[0]) == 4


def test_rows_without_stamps_are_spread_back_from_their_arrival() -> None:
    stream = MessageStream(Address.parsed("udp:9000?rate=10"))
    stream.take(b'{"ax": [1, 2, 3]}', 1000.0)
    block = stream.block()
    assert block is not None
    np.testing.assert_allclose(block.time_s, [999.8, 999.9, 1000.0])
    assert stream.rate_hz == 10


def test_a_stream_that_tells_only_garbage_tells_its_losses() -> None:
    stream = MessageStream(Address.parsed("udp:9000"))
    assert stream.block() is None
    stream.take(b"\x00", 0.0)
    block = stream.block()
    assert block is not None
    assert (len(block), block.values.shape, len(block.losses)) == (0, (0, 0), 1)
