"""A sink that two threads use: one writes rows, another waits until the broker has them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

from becalm.live.address import Address
from becalm.live.brokers.remote import Remote
from becalm.live.sinks.broker import BrokerConnection, BrokerSink
from becalm.live.sinks.outbox import OutgoingMessage
from brokered import HEAD, output


class Broker:
    """A broker that acknowledges each message once `on_post` has returned."""

    largest, ended, acknowledges = 10**6, False, True

    def __init__(self, sink: Sink) -> None:
        self.sink, self.changed, self.window = sink, threading.Condition(), 0
        self.rows: list[int] = []
        self.on_post: Callable[[], object] = lambda: None

    def post(self, message: OutgoingMessage) -> int:
        self.rows.append(message.first_row)
        number = len(self.rows)
        self.on_post()
        if self.acknowledges:
            self.sink._on_result(number, None)
        return number

    def check(self) -> None:
        return

    def close(self) -> None:
        return


class Sink(BrokerSink):
    """A sink that publishes to this broker."""

    def __init__(self) -> None:
        super().__init__(Remote.parsed(Address.parsed("mqtt://here/topic?gather=0s"), 1, 2))
        self.broker = Broker(self)
        self.open(HEAD)

    def _connect(self) -> BrokerConnection:
        return self.broker


def test_a_row_written_during_a_flush_is_published_once_and_after_the_others() -> None:
    sink = Sink()
    for row in range(3):  # they wait, as the window is full
        sink.write(output(row, 1))
    writer = threading.Thread(target=lambda: sink.write(output(3, 1)))
    begin: Iterator[Callable[[], None]] = iter([writer.start, lambda: writer.join(0.02)])
    sink.broker.on_post = lambda: next(begin, lambda: None)()
    sink.broker.window = 100
    sink.flush()
    writer.join()
    sink.flush()
    assert sink.broker.rows == [0, 1, 2, 3]


def test_a_flush_sees_an_acknowledgement_that_the_writer_saw_first() -> None:
    sink = Sink()
    sink.write(output(0, 1))
    sink.broker.window, sink.broker.acknowledges = 1, False
    waits: list[float | None] = []

    def wait(timeout: float | None = None) -> bool:
        waits.append(timeout)
        sink._on_result(len(waits), None)
        sink.write(output(len(waits), 1))
        return True

    sink.broker.changed.wait = wait  # type: ignore[method-assign]
    sink.flush()
    assert len(waits) == 1
