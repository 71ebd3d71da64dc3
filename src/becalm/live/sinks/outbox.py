"""Messages on their way to a broker: made of outputs, in order, and held until they are acknowledged."""

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
"""Bytes of the largest message that is made where a broker takes larger ones: brokers copy and queue them whole."""


@dataclass(frozen=True)
class Letter:
    """A message.

    Attributes
    ----------
    first_row : int
        The number of its first row.
    payload : bytes
        What it holds.
    """

    first_row: int
    payload: bytes

    @property
    def name(self) -> str:
        """What no other message has, and the same one sent again has too."""
        return f"{self.first_row}-{hashlib.blake2b(self.payload, digest_size=12).hexdigest()}"


class Outbox:
    """What was written and is not acknowledged, in order; it outlives connections.

    Parameters
    ----------
    form : str
        "arrow" or "json".
    gather_s : float
        For how long outputs are gathered into one message: a message costs more than its rows.
    """

    def __init__(self, form: str, gather_s: float) -> None:
        self._form = form
        self._gather_s = gather_s
        self._gathered: list[Output] = []
        self._since_s = 0.0
        self._head: Head | None = None
        self._encoder = Encoder(form)
        self._waiting: deque[Letter] = deque()
        self._flying: deque[tuple[int, Letter]] = deque()

    def begin(self, head: Head) -> None:
        """Make ready for a stream, or for a new connection: what was sent and not acknowledged is sent again."""
        if self._head != head:
            self.seal(LARGEST)
            self._head, self._encoder = head, Encoder.of(head, self._form)
        self._waiting.extendleft(letter for _, letter in reversed(self._flying))
        self._flying.clear()

    def put(self, output: Output, largest: int) -> None:
        """Take rows, and make messages of at most `largest` bytes of those that were gathered for long enough.

        Raises
        ------
        OutputError
            If a single row is larger.
        """
        if not len(output):
            return
        last = self._gathered[-1] if self._gathered else None
        if last is not None and last.first_row + len(last) != output.first_row:
            self.seal(largest)
        if not self._gathered:
            self._since_s = time.monotonic()
        self._gathered.append(output)
        held = sum(out.signal.nbytes for out in self._gathered) * 3
        if held >= LARGEST or time.monotonic() - self._since_s >= self._gather_s:
            self.seal(largest)

    def seal(self, largest: int) -> None:
        """Make messages of all that was gathered; raises as `put` does."""
        gathered, self._gathered = self._gathered, []
        if self._head is not None and gathered:
            self._waiting.extend(self._letters(self._head, _joined(gathered), min(largest, LARGEST)))

    def next(self) -> Letter | None:
        """Return the message that is to be sent next; None where none waits."""
        return self._waiting[0] if self._waiting else None

    def sent(self, number: int) -> None:
        """Hear that this message was sent, by the number that its acknowledgement will have."""
        self._flying.append((number, self._waiting.popleft()))

    def acknowledged(self, numbers: set[int]) -> None:
        """Forget messages that are acknowledged, up to the first that is not; take their numbers out of the set."""
        while self._flying and self._flying[0][0] in numbers:
            numbers.remove(self._flying.popleft()[0])

    def arrived(self, name: str) -> None:
        """Hear that a message came before its connection ended, and so did all before it; unknown ones are others'."""
        names = [letter.name for letter in self._waiting]
        if name in names:
            for _ in range(names.index(name) + 1):
                self._waiting.popleft()

    @property
    def flying(self) -> int:
        """How many messages were sent and not acknowledged."""
        return len(self._flying)

    def __len__(self) -> int:
        """Return how many messages are not acknowledged."""
        return len(self._waiting) + len(self._flying)

    def _letters(self, head: Head, output: Output, largest: int) -> Iterator[Letter]:
        payload = self._encoder.output(output, head)
        if len(payload) <= largest:
            yield Letter(output.first_row, payload)
        elif len(output) > 1:
            half = len(output) // 2
            yield from self._letters(head, _rows(output, 0, half), largest)
            yield from self._letters(head, _rows(output, half, len(output)), largest)
        else:
            raise OutputError(
                f"A row of {len(head.names)} channels takes {len(payload)} bytes, and the broker takes messages of "
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
    """Return some rows of an output."""
    return replace(
        output,
        first_row=output.first_row + start,
        time_s=output.time_s[start:stop],
        values=output.values[start:stop],
        signal=output.signal[start:stop],
        sigma=output.sigma[start:stop],
        verdicts=output.verdicts[start:stop],
    )
