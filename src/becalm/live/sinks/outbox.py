"""Make messages for a broker from outputs, and keep them in order until they are acknowledged."""

from __future__ import annotations

import hashlib
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from becalm.errors import OutputError
from becalm.live.block import Head, Output
from becalm.live.messages.encoding import Encoder

LARGEST = 250_000
"""Most bytes of a message, even if the broker takes larger ones, because brokers copy and queue whole messages."""


@dataclass(frozen=True)
class OutgoingMessage:
    """A message for a broker.

    Attributes
    ----------
    first_row : int
        Number of its first row.
    payload : bytes
        Encoded rows.
    """

    first_row: int
    payload: bytes

    @property
    def name(self) -> str:
        """Return a unique name, which is the same if the message is sent again."""
        return f"{self.first_row}-{hashlib.blake2b(self.payload, digest_size=12).hexdigest()}"


class Outbox:
    """The rows that were written and are not acknowledged yet, in order; an outbox outlives its connections.

    Parameters
    ----------
    form : str
        Format, "arrow" or "json".
    gather_s : float
        Time for which outputs are collected into one message, in seconds; fewer messages cost less.

    Attributes
    ----------
    dropped : int
        Number of messages that were delivered, and dropped.
    """

    def __init__(self, form: str, gather_s: float) -> None:
        self._form = form
        self._gather_s = gather_s
        self._gathered: list[Output] = []
        self._since_s = 0.0
        self._head: Head | None = None
        self._encoder = Encoder(form)
        self._waiting: deque[OutgoingMessage] = deque()
        self._in_flight: deque[tuple[int, OutgoingMessage]] = deque()
        self.dropped = 0

    def begin(self, head: Head) -> None:
        """Prepare for a stream or a new connection; messages that were sent and not acknowledged are sent again."""
        if self._head != head:
            self.seal(LARGEST)
            self._head, self._encoder = head, Encoder.of(head, self._form)
        self._waiting.extendleft(message for _, message in reversed(self._in_flight))
        self._in_flight.clear()

    def put(self, output: Output, largest: int) -> None:
        """Add rows; make messages of at most `largest` bytes once rows are collected for `gather_s`.

        Raises
        ------
        OutputError
            If the message of a single row is larger than `largest` or LARGEST.
        """
        if not len(output):
            return
        last = self._gathered[-1] if self._gathered else None
        if last is not None and last.first_row + len(last) != output.first_row:
            self.seal(largest)
        if not self._gathered:
            self._since_s = time.monotonic()
        self._gathered.append(output)
        size = sum(out.signal.nbytes for out in self._gathered) * 3  # estimate, in bytes of a message
        if size >= LARGEST or time.monotonic() - self._since_s >= self._gather_s:
            self.seal(largest)

    def seal(self, largest: int) -> None:
        """Make messages of all collected rows; raises the errors of `put`."""
        gathered, self._gathered = self._gathered, []
        if self._head is not None and gathered:
            self._waiting.extend(self._make_messages(self._head, _joined(gathered), min(largest, LARGEST)))

    def next(self) -> OutgoingMessage | None:
        """Return the next message to send; None if there is none."""
        return self._waiting[0] if self._waiting else None

    def sent(self, number: int) -> None:
        """Record that the next message was sent; its acknowledgement will have `number`."""
        self._in_flight.append((number, self._waiting.popleft()))

    def drop_acknowledged(self, numbers: set[int]) -> None:
        """Drop the acknowledged messages before the first unacknowledged one; remove their numbers from the set."""
        while self._in_flight and self._in_flight[0][0] in numbers:
            numbers.remove(self._in_flight.popleft()[0])
            self.dropped += 1

    def drop_through(self, name: str) -> None:
        """Drop the messages up to the one called `name`, which the broker has stored; ignore an unknown name."""
        names = [message.name for message in self._waiting]
        if name in names:
            for _ in range(names.index(name) + 1):
                self._waiting.popleft()
                self.dropped += 1

    @property
    def in_flight(self) -> int:
        """Return the number of messages that were sent and not acknowledged."""
        return len(self._in_flight)

    def __len__(self) -> int:
        """Return the number of messages that are not acknowledged, sent or not."""
        return len(self._waiting) + len(self._in_flight)

    def _make_messages(self, head: Head, output: Output, largest: int) -> Iterator[OutgoingMessage]:
        payload = self._encoder.output(output, head)
        if len(payload) <= largest:
            yield OutgoingMessage(output.first_row, payload)
        elif len(output) > 1:
            half = len(output) // 2
            yield from self._make_messages(head, _rows(output, 0, half), largest)
            yield from self._make_messages(head, _rows(output, half, len(output)), largest)
        else:
            raise OutputError(
                f"A row of {len(head.names)} channels has {len(payload)} bytes, but the broker's largest message has "
                f"{largest}; raise its limit, or clean fewer channels."
            )


def _joined(outputs: list[Output]) -> Output:
    """Return consecutive outputs as one."""
    if len(outputs) == 1:
        return outputs[0]
    return replace(
        outputs[0],
        time_s=np.concatenate([output.time_s for output in outputs]),
        values=np.concatenate([output.values for output in outputs]),
        signal=np.concatenate([output.signal for output in outputs]),
        sigma=np.concatenate([output.sigma for output in outputs]),
        verdicts=np.concatenate([output.verdicts for output in outputs]),
    )


def _rows(output: Output, start: int, stop: int) -> Output:
    """Return the rows from `start` to `stop` of an output."""
    return replace(
        output,
        first_row=output.first_row + start,
        time_s=output.time_s[start:stop],
        values=output.values[start:stop],
        signal=output.signal[start:stop],
        sigma=output.sigma[start:stop],
        verdicts=output.verdicts[start:stop],
    )
