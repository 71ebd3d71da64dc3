from __future__ import annotations

import json
from collections.abc import Iterator
from io import BytesIO

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from becalm.core.arrays import Codes, Floats
from becalm.live.address import Address
from becalm.live.block import Head, LossKind, Output
from becalm.live.encoding import FORMATS, Encoder
from becalm.live.message_stream import MessageStream
from becalm.live.messages import MAXIMUM_BYTES, Batch, MessageReader

UNITS = {"ax": "m/s^2"}


def reader(options: str = "") -> MessageReader:
    return MessageReader(Address.parsed(f"udp:9000{options}"))


def columns(rows: int, began_s: float = 0.0) -> dict[str, Floats | Codes]:
    numbers = np.arange(rows, dtype=np.float64)
    return {"time": began_s + numbers / 100, "ax": numbers, "ay": -numbers}


def good(held: MessageReader, payload: bytes) -> Batch:
    batch = held.read(payload, 1000.0)
    assert batch is not None, held.losses()
    return batch


def whole(batches: list[Batch]) -> Iterator[tuple[int | None, float | None, tuple[float, ...]]]:
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


def test_lines_of_csv_have_the_columns_that_the_address_names() -> None:
    held = reader("?columns=seq,t,ax (m/s^2),ay&time=t")
    batch = good(held, b"5,0.1,1,2\r\n6,0.2,,nan\n")
    assert (held.names, held.units, batch.seq) == (("ax", "ay"), ("m/s^2", ""), 5)
    np.testing.assert_array_equal(batch.values, [[1, 2], [np.nan, np.nan]])
    assert held.read(b"7,0.3,1\n", 0.0) is None
    assert held.read(b"5,0.1,1,2\n7,0.2,1,2\n", 0.0) is None


def test_columns_choose_among_those_of_other_messages() -> None:
    held = reader("?columns=ay")
    np.testing.assert_array_equal(good(held, Encoder().message(columns(3), 0)).values, [[0], [-1], [-2]])
    np.testing.assert_array_equal(good(held, Encoder("json").message(columns(3), 3)).values, [[0], [-1], [-2]])


def test_channels_are_found_by_name() -> None:
    held = reader()
    good(held, b'{"ax": 1, "ay": 2}')
    np.testing.assert_array_equal(good(held, b'{"ay": 20, "ax": 10}').values, [[10, 20]])
    swapped = {name: column for name, column in reversed(columns(1).items()) if name != "time"}
    np.testing.assert_array_equal(good(held, Encoder().message({**swapped, "ay": np.array([5.0])})).values, [[0, 5]])


def arrow(batch: pa.RecordBatch, *more: pa.RecordBatch) -> bytes:
    file = BytesIO()
    with pa.ipc.new_stream(file, batch.schema) as stream:
        for part in (batch, *more):
            stream.write_batch(part)
    return file.getvalue()


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


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (b"", "neither Arrow nor JSON"),
        (b"{}", "no channels"),
        (b'{"seq": 1, "time": 2}', "no channels"),
        (b'{"ax": "1"}', "no numbers in 'ax'"),
        (b'{"ax": true}', "no numbers in 'ax'"),
        (b'{"ax": [1, 2], "ay": [1]}', "not the same number"),
        (b'{"time": [1], "ax": [1, 2]}', "1 stamps of 2 rows"),
        (b'{"ax": [1, 2]}', "?rate=HZ"),
        (b'{"seq": -1, "ax": 1}', "seq is -1"),
        (b'{"seq": 1.5, "ax": 1}', "one by one"),
        (b'{"time": null, "ax": 1}', "without a stamp"),
        (b'{"ax": 1' + b"0" * 400 + b"}", "broken"),
        (b"[" * 100_000, "broken"),
        (b" " * (MAXIMUM_BYTES + 1), "more than 16000000"),
        (Encoder().message({"time": np.empty(0), "ax": np.empty(0)}, 0), "no rows"),
        (arrow(pa.record_batch({"ax": ["a"]})), "'ax' has string"),
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
