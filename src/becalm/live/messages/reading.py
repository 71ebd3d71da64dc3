"""What a message holds: a batch of rows as Arrow, JSON or lines of CSV, told apart by its first bytes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from becalm.core.arrays import Floats
from becalm.live.block import Loss, LossKind
from becalm.live.lines.columns import LineOptions
from becalm.live.messages.columns import EXACT_INTEGERS, ParsedMessage, RoleFinder, UnreadableMessageError

if TYPE_CHECKING:
    from becalm.live.messages.arrow import ArrowMessages

MAXIMUM_BYTES = 16_000_000
"""A longer message is garbled: nobody batches so, and memory stays bounded."""

_ARROW = b"\xff\xff\xff\xff"
_UNREADABLE = (ValueError, TypeError, LookupError, ArithmeticError, RuntimeError, MemoryError, OSError, EOFError)


@dataclass(frozen=True, slots=True)
class MessageRows:
    """The rows of one message.

    Attributes
    ----------
    seq : int or None
        The number of the first row. Rows are numbered, and not messages, so that what is missing is known in rows
        even where messages differ in length, and a sender may cut its rows into other messages when it sends again.
    time_s : (B,) float array or None
        Stamps in seconds as the sender told them; None where it told none.
    values : (B, m) float array
        Readings, C-contiguous, NaN where missing.
    arrived_s : float
        When the message came, in seconds since 1970.
    """

    seq: int | None
    time_s: Floats | None
    values: Floats
    arrived_s: float

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.values)

    def after(self, rows: int) -> MessageRows:
        """Return what stands behind the first `rows` rows."""
        return MessageRows(
            None if self.seq is None else self.seq + rows,
            None if self.time_s is None else self.time_s[rows:],
            self.values[rows:],
            self.arrived_s,
        )


class MessageReader:
    """Reads messages of one stream; whatever cannot be read is counted and never raises.

    The first good message tells the channels, and whether there are stamps and sequence numbers; one that differs in
    these is garbled. Their order may differ: channels are found by name.

    Arrow is an IPC stream of numeric columns, `unit` in a field's metadata its unit. JSON is an object of numbers (a
    row) or of lists (columns), or a list of row objects; `units` may be an object in it. CSV needs `columns`. What is
    text and no time is passed over. Column `seq` numbers the rows: in JSON a single number, of the first row;
    elsewhere every row's own, one more each. Stamps are read as those of lines are.

    Parameters
    ----------
    options : LineOptions
        What was said of columns.
    """

    def __init__(self, options: LineOptions) -> None:
        self._finder = RoleFinder(options)
        self._arrow: ArrowMessages | None = None
        self._garbled = 0
        self._first = ""
        self.names: tuple[str, ...] = ()
        self.units: tuple[str, ...] = ()
        self._shape: tuple[bool, bool] | None = None

    def read(self, payload: bytes, arrived_s: float) -> MessageRows | None:
        """Return the rows of a message; None where it cannot be read, which `losses` tells.

        Parameters
        ----------
        payload : bytes
            The message.
        arrived_s : float
            When it came, in seconds since 1970.
        """
        try:
            return self._batch(self._told(payload), arrived_s)
        except _UNREADABLE as cause:
            self._garbled += 1
            self._first = self._first or f"{_short(cause)}: {payload[:40]!r}{'...' if len(payload) > 40 else ''}"
            return None

    def read_many(self, messages: list[tuple[bytes, float]]) -> list[MessageRows]:
        """Return the rows of messages, each with its arrival, in their order; joined where that is faster.

        Parameters
        ----------
        messages : list of (bytes, float)
            Each message, and when it came, in seconds since 1970.
        """
        if len(messages) > 1 and self._shape and self._shape[1]:  # without stamps, each has its own arrival
            payloads = [payload for payload, _ in messages]
            if payloads[0].startswith(_ARROW) and sum(map(len, payloads)) <= MAXIMUM_BYTES:
                try:
                    return [self._batch(told, messages[-1][1]) for told in self._arrow_reader().read_many(payloads)]
                except _UNREADABLE:
                    pass  # one by one tells which
        return [batch for batch in (self.read(*message) for message in messages) if batch is not None]

    def losses(self) -> tuple[Loss, ...]:
        """Return what could not be read since this was asked last."""
        if not self._garbled:
            return ()
        count, first = self._garbled, self._first
        self._garbled, self._first = 0, ""
        said = "1 message" if count == 1 else f"{count} messages"
        return (Loss(LossKind.GARBLED, count, f"{said} could not be read; the first, {first}"),)

    def _told(self, payload: bytes) -> ParsedMessage:
        if len(payload) > MAXIMUM_BYTES:
            raise UnreadableMessageError(f"of {len(payload)} bytes (more than {MAXIMUM_BYTES})")
        if payload.startswith(_ARROW):
            return self._arrow_reader().read(payload)
        from becalm.live.messages import text

        if payload[:64].lstrip()[:1] in (b"{", b"["):
            return text.from_json(payload, self._finder)
        return text.from_csv(payload, self._finder)

    def _arrow_reader(self) -> ArrowMessages:
        from becalm.live.messages.arrow import ArrowMessages

        if self._arrow is None:
            self._arrow = ArrowMessages(self._finder)
        return self._arrow

    def _batch(self, told: ParsedMessage, arrived_s: float) -> MessageRows:
        """Return a message's rows in the stream's order of channels, once they are those of the stream."""
        _check(told)
        if told.time_s is None and len(told.values) > 1 and not self._finder.options.rate_hz:
            raise UnreadableMessageError("which has several rows and no stamps (where that is so, say ?rate=HZ)")
        shape = (told.seq is not None, told.time_s is not None)
        if self._shape is None:
            self.names, self.units, self._shape = told.names, told.units, shape
        if shape != self._shape:
            raise UnreadableMessageError("which differs from the first message in having stamps or sequence numbers")
        if told.names == self.names:
            return MessageRows(told.seq, told.time_s, told.values, arrived_s)
        if sorted(told.names) != sorted(self.names):
            raise UnreadableMessageError(
                f"whose channels are {', '.join(told.names)[:80]}, not {', '.join(self.names)[:80]}"
            )
        values = np.ascontiguousarray(told.values[:, [told.names.index(name) for name in self.names]])
        return MessageRows(told.seq, told.time_s, values, arrived_s)


def _check(told: ParsedMessage) -> None:
    """Refuse numbers that cannot be a sequence, and stamps that are none."""
    if told.seq is not None and not 0 <= told.seq <= EXACT_INTEGERS - len(told.values):
        raise UnreadableMessageError(f"whose seq is {told.seq}")
    if told.time_s is not None and not np.isfinite(told.time_s).all():
        raise UnreadableMessageError("which has a row without a stamp")


def _short(cause: BaseException) -> str:
    """Return a reason in one short line."""
    if isinstance(cause, UnreadableMessageError):
        return str(cause)
    return f"which is broken ({' '.join(str(cause).split())[:80]})"
