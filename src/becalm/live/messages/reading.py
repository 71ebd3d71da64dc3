"""Read a message, a batch of rows as Arrow, JSON or CSV; its first bytes show the format."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from becalm.core.arrays import Floats
from becalm.live.block import Loss, LossKind
from becalm.live.lines.columns import LineOptions
from becalm.live.messages.columns import EXACT_INTEGERS, ParsedMessage, RoleFinder, UnreadableMessageError

if TYPE_CHECKING:
    from becalm.live.messages.arrow import ArrowMessages

MAXIMUM_BYTES = 16_000_000
"""Most bytes of a message; a longer one is counted as garbled, so that memory is bounded."""

_ARROW = b"\xff\xff\xff\xff"  # first bytes of an Arrow message
_UNREADABLE = (ValueError, TypeError, LookupError, ArithmeticError, RuntimeError, MemoryError, OSError, EOFError)


@dataclass(frozen=True, slots=True)
class MessageRows:
    """The rows of a message, or of several consecutive messages.

    Attributes
    ----------
    seq : int or None
        Number of the first row; None without numbers. Rows are numbered instead of messages, so that missing rows can
        be counted even if messages differ in length, and a sender may split its rows differently when it sends again.
    time_s : (B,) float array or None
        Stamps of the sender in seconds; None if it sends none.
    values : (B, m) float array
        Readings, C-contiguous, NaN where missing.
    arrived_s : float
        Time when the last of the messages arrived, in seconds since 1970.
    """

    seq: int | None
    time_s: Floats | None
    values: Floats
    arrived_s: float

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.values)

    def after(self, rows: int) -> MessageRows:
        """Return the rows after the first `rows` rows."""
        return MessageRows(
            None if self.seq is None else self.seq + rows,
            None if self.time_s is None else self.time_s[rows:],
            self.values[rows:],
            self.arrived_s,
        )


class MessageReader:
    """A reader of the messages of one stream; unreadable messages are counted and raise no error.

    The first readable message determines the channels and their units, and whether there are stamps and row numbers; a
    message that differs in these is garbled. The order of the columns may differ, because channels are found by name,
    and a message may leave units out.

    Arrow is an IPC stream of numeric columns, with the unit as `unit` in a field's metadata. JSON is an object of
    numbers (a row) or of lists (columns), or a list of row objects; it may contain an object `units`. CSV needs the
    option `columns`. A text column that is not a time is ignored. Column `seq` has the numbers of all rows, increasing
    by one; in JSON it may be the number of the first row alone. Stamps are parsed as in `becalm.live.lines`.

    Parameters
    ----------
    options : LineOptions
        Columns, time, rate and channels from the address.
    units : iterable of str
        Units of the channels in `options`, if they are known.
    """

    def __init__(self, options: LineOptions, units: Iterable[str] = ()) -> None:
        self._known_units = tuple(units)
        self._finder = RoleFinder(options)
        self._arrow: ArrowMessages | None = None
        self._garbled = 0
        self._first = ""
        self.names: tuple[str, ...] = ()
        self.units: tuple[str, ...] = ()
        self._shape: tuple[bool, bool] | None = None  # whether messages have row numbers, and stamps

    def read(self, payload: bytes, arrived_s: float) -> MessageRows | None:
        """Return the rows of a message; None if it cannot be read: `losses` then counts it.

        Parameters
        ----------
        payload : bytes
            The message.
        arrived_s : float
            Time of its arrival, in seconds since 1970.
        """
        try:
            return self._batch(self._parse(payload), arrived_s)
        except _UNREADABLE as cause:
            self._garbled += 1
            self._first = self._first or f"{_short(cause)}: {payload[:40]!r}{'...' if len(payload) > 40 else ''}"
            return None

    def read_many(self, messages: list[tuple[bytes, float]]) -> list[MessageRows]:
        """Return the rows of messages in order; several messages may be joined, which is faster.

        Parameters
        ----------
        messages : list of (bytes, float)
            Each message, and the time of its arrival, in seconds since 1970.
        """
        if len(messages) > 1 and self._shape and self._shape[1]:  # without stamps each needs its own arrival time
            payloads = [payload for payload, _ in messages]
            if payloads[0].startswith(_ARROW) and sum(map(len, payloads)) <= MAXIMUM_BYTES:
                try:
                    parsed = self._arrow_reader().read_many(payloads)
                    return [self._batch(message, messages[-1][1]) for message in parsed]
                except _UNREADABLE:
                    pass  # read them one by one to find the unreadable ones
        return [batch for batch in (self.read(*message) for message in messages) if batch is not None]

    def losses(self) -> tuple[Loss, ...]:
        """Return a loss for the unreadable messages since the last call."""
        if not self._garbled:
            return ()
        count, first = self._garbled, self._first
        self._garbled, self._first = 0, ""
        messages = "1 message" if count == 1 else f"{count} messages"
        return (Loss(LossKind.GARBLED, count, f"{messages} could not be read; the first, {first}"),)

    def _parse(self, payload: bytes) -> ParsedMessage:
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

    def _batch(self, message: ParsedMessage, arrived_s: float) -> MessageRows:
        """Return a message's rows with the channels in the stream's order, after checking that they fit the stream."""
        _check(message)
        if message.time_s is None and len(message.values) > 1 and not self._finder.options.rate_hz:
            raise UnreadableMessageError("which has several rows and no stamps (give the rate: ?rate=HZ)")
        shape = (message.seq is not None, message.time_s is not None)
        if self._shape is None:
            if self._known_units:
                _check_units(message.units, self._known_units, message.names)
            self.names, self.units, self._shape = message.names, message.units, shape
        if shape != self._shape:
            raise UnreadableMessageError("which differs from the first message in having stamps or row numbers")
        if sorted(message.names) != sorted(self.names):
            raise UnreadableMessageError(
                f"whose channels are {', '.join(message.names)[:80]}, not {', '.join(self.names)[:80]}"
            )
        values = message.values
        if message.names != self.names:
            order = [message.names.index(name) for name in self.names]
            message = replace(message, units=tuple(message.units[place] for place in order))
            values = np.ascontiguousarray(values[:, order])
        if message.units != self.units:
            _check_units(message.units, self.units, self.names)
        return MessageRows(message.seq, message.time_s, values, arrived_s)


def _check_units(units: Sequence[str], known_units: Sequence[str], names: Sequence[str]) -> None:
    """Raise UnreadableMessageError for a unit that differs from the known one; "" is no statement."""
    for unit, known, name in zip(units, known_units, names, strict=True):
        if unit not in ("", known):
            raise UnreadableMessageError(f"whose {name[:40]!r} is in {unit[:20]!r}, not in {known[:20] or 'no unit'!r}")


def _check(message: ParsedMessage) -> None:
    """Raise UnreadableMessageError for row numbers out of range, and for stamps that are not finite."""
    if message.seq is not None and not 0 <= message.seq <= EXACT_INTEGERS - len(message.values):
        raise UnreadableMessageError(f"whose seq is {message.seq}")
    if message.time_s is not None and not np.isfinite(message.time_s).all():
        raise UnreadableMessageError("which has a row without a stamp")


def _short(cause: BaseException) -> str:
    """Return the reason of an error in one short line."""
    if isinstance(cause, UnreadableMessageError):
        return str(cause)
    return f"which is broken ({' '.join(str(cause).split())[:80]})"
