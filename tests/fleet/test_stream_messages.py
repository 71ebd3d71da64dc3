"""Messages of a broker as the rows of a fleet: read by their numbers, and filtered as a live stream filters them."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyspark.sql.streaming.datasource import ReadAllAvailable, ReadMaxRows

from becalm.errors import InputError, UsageError
from becalm.fleet.stream import jetstream_range
from becalm.fleet.stream.blocks import SensorRows
from becalm.fleet.stream.jetstream import _Reader
from becalm.fleet.stream.plan import SensorPlan
from becalm.fleet.stream.reading import Entry
from becalm.live.address import Address
from becalm.live.brokers.nats_pull import StreamMessage
from becalm.live.messages.encoding import Encoder
from becalm.live.protocols import AwayError
from brokers import Broker, nats_server
from made import recipe_of
from pump import made, purged, sent
from streaming import CHANNELS, RECIPE, Shelf, Walker, assert_same_bits, by_stream, cut, part, rows_of
from streaming_spark import Stage, said_in, spark, stage, told_in

__all__ = ["spark", "stage"]
MESSAGES = Address.parsed("nats://127.0.0.1/PUMP")
UNITS = dict.fromkeys(CHANNELS, "m")


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Broker]:
    with nats_server(tmp_path / "nats") as running:
        made(running)
        yield running


def message(rows: SensorRows, seq: int | None = None, form: str = "arrow") -> bytes:
    columns = {"time": rows.time_s} | {name: rows.values[:, c] for c, name in enumerate(CHANNELS)}
    return Encoder(form, UNITS).message(columns, seq)


def messages(rows: SensorRows, size: int, *, numbered: bool = False, form: str = "arrow") -> list[bytes]:
    parts = cut(rows, range(size, len(rows.time_s), size))
    return [message(one, k * size if numbered else None, form) for k, one in enumerate(parts)]


def entries(payloads: Sequence[bytes], first: int = 1) -> list[Entry]:
    return [Entry(first + k, payload, 1.764e9 + k) for k, payload in enumerate(payloads)]


def walker(**plan: Any) -> Walker:
    return Walker(SensorPlan(Shelf(RECIPE), channels=CHANNELS, messages=MESSAGES, **plan))


@pytest.mark.parametrize("form", ["arrow", "json"])
@pytest.mark.parametrize("cuts", [[], [1, 2, 9], [17]])
def test_messages_are_the_rows_of_a_stream(form: str, cuts: list[int]) -> None:
    rows, one = rows_of(600), walker()
    payloads = messages(rows, 30, numbered=True, form=form)
    edges = [0, *cuts, len(payloads)]
    for a, b in pairwise(edges):
        one.take(entries(payloads[a:b], a + 1)[::-1])  # the engine has them in any order
    assert_same_bits(one.said, by_stream(rows))
    assert one.kinds() == ["gap", "gap"]


def test_missing_and_repeated_messages_are_counted_across_micro_batches() -> None:
    rows, one = rows_of(300), walker()
    payloads = messages(rows, 30, numbered=True)
    one.take(entries(payloads[:4]))
    one.take(entries([payloads[3], *payloads[6:]], 5))
    kept = part(rows, list(np.r_[0:120, 180:300]))
    assert_same_bits(one.said, by_stream(kept))
    told = [(event.kind, event.rows) for event in one.events if event.kind in ("missing", "repeated")]
    assert sorted(told) == [("missing", 60), ("repeated", 30)]


def test_garbled_messages_are_counted() -> None:
    rows, one = rows_of(90), walker()
    payloads = messages(rows, 30)
    one.take(entries([payloads[0], b"rubbish", payloads[1][:-40], payloads[2]]))
    assert ("garbled", 2) in [(event.kind, event.rows) for event in one.events]
    assert_same_bits(one.said, by_stream(part(rows, list(np.r_[0:30, 60:90]))))


def test_only_rubbish_tells_nothing() -> None:
    one = walker()
    assert [event.kind for event in one.take(entries([b"rubbish"])).events] == ["garbled"]
    assert one.take(entries([b"rubbish"], 2)).estimates is None


def test_first_rows_of_other_channels_are_left_out_and_counted() -> None:
    rows, one = rows_of(100), walker()
    one.take(entries([Encoder("json").message({"time": rows.time_s[:5], "z": rows.time_s[:5]})]))
    one.take(entries([message(part(rows, slice(5, 100)))], 2))
    assert ("garbled", 1) in [(event.kind, event.rows) for event in one.events]  # a message
    assert_same_bits(one.said, by_stream(part(rows, slice(5, 100))))


@pytest.mark.parametrize("cut", [2, 3, 4])
@pytest.mark.parametrize("odd", ['"battery": 3.7', '"a": 1, "b": 2, "units": {"a": "km"}'])
def test_an_odd_message_is_garbled_alone_wherever_a_micro_batch_begins(odd: str, cut: int) -> None:
    rows, one = rows_of(150), walker()
    payloads = messages(rows, 30)
    payloads.insert(3, f'{{"time": {float(rows.time_s[0])}, {odd}}}'.encode())
    one.take(entries(payloads[:cut]))
    one.take(entries(payloads[cut:], 1 + cut))
    assert [event.rows for event in one.events if event.kind == "garbled"] == [1]
    assert_same_bits(one.said, by_stream(rows))


def test_a_clock_that_is_set_back_is_followed_as_live_follows_it() -> None:
    rows, one = rows_of(200), walker()
    one.take(entries(messages(rows, 50)))
    one.take(entries(messages(rows, 50), 5))
    assert len(one.said.time_s) == 400 - 7


def test_a_recipe_with_a_channel_that_nobody_named_is_refused() -> None:
    one = Walker(SensorPlan(Shelf(recipe_of("z")), channels=CHANNELS, messages=MESSAGES))
    payload = Encoder("json", {"z": "m"}).message({"time": 1e9 + np.arange(30.0), "z": np.arange(30.0)})
    (event,) = one.take(entries([payload])).events
    assert (event.kind, event.rows) == ("refused", 30)
    assert "the stream has 'a', 'b'" in event.says


def reader_of(server: Broker, options: str = "", tasks: int = 1) -> _Reader:
    return _Reader(Address.parsed(f"nats://127.0.0.1:{server.port}/PUMP?{options or 'start=first'}"), tasks)


def numbers_in(reader: _Reader, start: dict[str, Any], end: dict[str, Any]) -> list[int]:
    batches = [batch for one in reader.partitions(start, end) for batch in reader.read(one)]
    return [number for batch in batches for number in batch["place"].to_pylist()]


def test_a_range_is_the_same_whenever_it_is_read(server: Broker) -> None:
    sent(server, [b"one", b"two", b"three"], "plant.a")
    sent(server, [b"four"], "plant.b")
    reader = reader_of(server)
    start = reader.initialOffset()
    end = reader.latestOffset(start, ReadAllAvailable())
    sent(server, [b"five"], "plant.a")
    (one,) = reader.partitions(start, end)
    for _ in range(2):
        batch = pa.Table.from_batches(list(reader.read(one)))
        assert batch["sensor"].to_pylist() == ["plant.a"] * 3 + ["plant.b"]
        assert batch["message"].to_pylist() == [b"one", b"two", b"three", b"four"]
        assert batch["place"].to_pylist() == [1, 2, 3, 4]
    again = reader.latestOffset(end, ReadAllAvailable())
    assert numbers_in(reader, end, again) == [5]
    assert reader.partitions(again, again) == []


def test_limits_and_starts_are_kept(server: Broker) -> None:
    sent(server, [b"x"] * 10)
    reader = reader_of(server, "most=4")
    assert reader.getDefaultReadLimit() == ReadMaxRows(4)
    start = reader.initialOffset()
    assert reader.latestOffset(start, reader.getDefaultReadLimit())["message"] == 4
    assert reader_of(server, "start=now").initialOffset()["message"] == 10
    reader.prepareForTriggerAvailableNow()
    sent(server, [b"x"] * 5)
    assert reader.latestOffset(start, ReadAllAvailable())["message"] == 10


def test_ranges_are_cut_into_tasks(server: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("becalm.fleet.stream.jetstream._FEWEST", 3)
    sent(server, [b"x"] * 11)
    reader = reader_of(server, tasks=4)
    start = reader.initialOffset()
    end = reader.latestOffset(start, ReadAllAvailable())
    assert len(reader.partitions(start, end)) == 3
    assert numbers_in(reader, start, end) == list(range(1, 12))


def test_what_is_deleted_or_of_another_subject_is_passed_over(server: Broker) -> None:
    sent(server, [b"x"] * 6, "plant.a")
    sent(server, [b"y"] * 3, "plant.b")
    purged(server, below=4)
    reader = reader_of(server, "subject=plant.a")
    start, end = {"message": 0, "created": ""}, {"message": 9, "created": ""}
    assert numbers_in(reader, start, end) == [4, 5, 6]
    assert numbers_in(reader, {"message": 6, "created": ""}, end) == []
    purged(server)
    assert numbers_in(reader, start, end) == []


def test_a_stream_that_was_made_anew_is_read_from_its_beginning(
    server: Broker, caplog: pytest.LogCaptureFixture
) -> None:
    sent(server, [b"x"] * 6)
    reader = reader_of(server)
    end = reader.latestOffset(reader.initialOffset(), ReadAllAvailable())
    made(server, description="anew")
    sent(server, [b"y"] * 2)
    again = reader.latestOffset(end, ReadAllAvailable())
    assert numbers_in(reader, end, again) == [1, 2]
    assert "created anew since message 6" in caplog.text


def test_what_a_server_lost_is_said(server: Broker, caplog: pytest.LogCaptureFixture) -> None:
    sent(server, [b"x"] * 6)
    purged(server, below=5)
    reader = reader_of(server)
    created = reader.initialOffset()["created"]
    for read in (1, 9):
        end = reader.latestOffset({"message": read, "created": created}, ReadAllAvailable())
        assert end["message"] == 6
    assert "Messages 2 to 4 were deleted before they were read." in caplog.text
    assert "lost its messages 7 to 9, which had been read" in caplog.text


def test_a_message_that_is_on_its_way_is_not_left_out(server: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    """The server has sent all, as it says, and the reader has not taken them yet."""
    sent(server, [b"x"] * 6)
    real, late = jetstream_range._RangePull.take, [2]

    def take(pull: jetstream_range._RangePull, timeout_s: float, at_once: int) -> list[StreamMessage]:
        if late[0]:
            late[0] -= 1
            time.sleep(0.3)
            return []
        return real(pull, timeout_s, at_once)

    monkeypatch.setattr(jetstream_range._RangePull, "take", take)
    reader = reader_of(server)
    start = reader.initialOffset()
    assert numbers_in(reader, start, reader.latestOffset(start, ReadAllAvailable())) == [1, 2, 3, 4, 5, 6]


def test_a_stream_that_ends_with_what_is_there_does_not_end_without_it(server: Broker) -> None:
    sent(server, [b"x"] * 6)
    reader = reader_of(server)
    start = reader.initialOffset()
    reader.prepareForTriggerAvailableNow()
    server.kill()
    with pytest.raises(AwayError):
        reader.latestOffset(start, ReadAllAvailable())


def test_a_server_that_is_away_is_waited_for(server: Broker, monkeypatch: pytest.MonkeyPatch) -> None:
    sent(server, [b"x"] * 6)
    reader = reader_of(server)
    start = reader.initialOffset()
    end = reader.latestOffset(start, ReadAllAvailable())
    server.kill()
    assert reader.latestOffset(end, ReadAllAvailable()) == end
    monkeypatch.setattr(jetstream_range, "_AGAIN_S", (0.5,) * 20)
    returning = threading.Timer(1.0, server.start)
    returning.start()
    assert numbers_in(reader, start, end) == [1, 2, 3, 4, 5, 6]
    returning.join()
    server.kill()
    monkeypatch.setattr(jetstream_range, "_AGAIN_S", (0.1,))
    with pytest.raises(AwayError):
        numbers_in(reader, start, end)


def test_streams_that_forget_are_refused(server: Broker) -> None:
    made(server, retention="workqueue")
    with pytest.raises(InputError, match="deletes messages once they are read"):
        reader_of(server).initialOffset()
    with pytest.raises(InputError, match="no stream 'NONE'"):
        _Reader(Address.parsed(f"nats://127.0.0.1:{server.port}/NONE"), 1).initialOffset()


@pytest.mark.slow
@pytest.mark.spark
def test_a_broker_s_messages_are_streamed_to_the_bit(server: Broker, stage: Stage) -> None:
    rows = {"plant.a": rows_of(600, 1), "plant.b": rows_of(600, 5)}
    source = f"nats://127.0.0.1:{server.port}/PUMP?subject=plant.*&most=30"
    for which in (slice(0, 4), slice(4, 20)):
        for subject, own in rows.items():
            sent(server, messages(own, 30, numbered=True)[which], subject)
        stage.once(source=source)
    for subject, own in rows.items():
        assert_same_bits(said_in(told_in(stage.out, subject)), by_stream(own))


@pytest.mark.slow
@pytest.mark.spark
def test_a_stream_of_messages_that_is_not_there_is_told_before_it_begins(server: Broker, stage: Stage) -> None:
    with pytest.raises(InputError, match="no stream 'NONE'"):
        stage.once(source=f"nats://127.0.0.1:{server.port}/NONE")
    with pytest.raises(UsageError, match="no option 'x'"):
        stage.once(source=f"nats://127.0.0.1:{server.port}/PUMP?x=1")
