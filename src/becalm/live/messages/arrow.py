"""Read messages in Arrow IPC format; the schema is parsed once for all messages that begin with the same bytes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats, Integers
from becalm.live.lines.cells import NumberStamps, StampReader
from becalm.live.messages.columns import ParsedMessage, RoleFinder, UnreadableMessageError, first_of, stamps_reader

_END = b"\xff\xff\xff\xff\x00\x00\x00\x00"  # end of an IPC stream
_SCHEMAS = 16  # cached schemas; bounded, in case a sender changes its schema with each message
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass
class _Plan:
    """A plan to read the columns of a schema: numbers as one matrix (seq, stamps, channels), timestamps separately."""

    schema: pa.Schema
    names: tuple[str, ...]
    units: tuple[str, ...]
    columns: list[int]  # of the matrix: [seq,] [time,] channels
    leading: int  # number of columns of the matrix before the channels
    has_seq: bool
    has_time: bool
    timestamp_column: int  # index of the column of Arrow timestamps, -1 if there is none
    tick_s: float  # resolution of these timestamps
    stamp: tuple[str, str]  # the column of stamps and its unit
    stamps: NumberStamps | None = None  # parser of the stamps, chosen from the first one


class ArrowMessages:
    """A reader of Arrow messages.

    Parameters
    ----------
    finder : RoleFinder
        Finds stamps, row numbers and channels among the columns.
    """

    def __init__(self, finder: RoleFinder) -> None:
        self._finder = finder
        self._plans: dict[bytes, _Plan] = {}

    def read(self, payload: bytes) -> ParsedMessage:
        """Return the rows of a message.

        Raises
        ------
        UnreadableMessageError
            If the message is broken or has other columns. Broken bytes may also raise Python's own errors.
        """
        try:
            return self._read(payload)
        except pa.ArrowException as cause:  # not all of Arrow's errors derive from Python's
            raise UnreadableMessageError(f"which is broken ({' '.join(str(cause).split())[:80]})") from cause

    def _read(self, payload: bytes) -> ParsedMessage:
        size = 8 + int.from_bytes(payload[4:8], "little")
        plan = self._plans.get(payload[:size]) or self._make_plan(payload[:size])
        file = pa.BufferReader(payload)
        file.seek(size)
        parts = []
        while (rest := payload[file.tell() : file.tell() + 8]) and rest != _END:
            batch = pa.ipc.read_record_batch(pa.ipc.read_message(file), plan.schema)
            batch.validate()  # otherwise a broken message could be read beyond its end
            parts.append(batch)
        if not any(map(len, parts)):
            raise UnreadableMessageError("which has no rows")
        matrices = [_matrix(part, plan) for part in parts]
        matrix = matrices[0] if len(matrices) == 1 else np.concatenate(matrices)
        seq = first_of(matrix[:, 0]) if plan.has_seq else None
        return _parsed(
            matrix, [_timestamps(part, plan) for part in parts] if plan.timestamp_column >= 0 else [], seq, plan
        )

    def read_many(self, payloads: list[bytes]) -> list[ParsedMessage]:
        """Return the rows of messages with the same schema; messages with consecutive row numbers are joined.

        The messages are read as one stream, which takes a third of the time.

        Raises
        ------
        UnreadableMessageError
            If a message is not one whole record batch, or its rows are not numbered one by one; also raised
            for the reasons given in `read`.
        """
        try:
            return self._read_many(payloads)
        except pa.ArrowException as cause:
            raise UnreadableMessageError("one of which is broken") from cause

    def _read_many(self, payloads: list[bytes]) -> list[ParsedMessage]:
        first = payloads[0]
        size = 8 + int.from_bytes(first[4:8], "little")
        head = first[:size]
        plan = self._plans.get(head) or self._make_plan(head)
        bodies = [payload[size : -8 if payload.endswith(_END) else None] for payload in payloads]
        stream = pa.py_buffer(b"".join([head, *bodies]))
        batches = list(pa.ipc.open_stream(stream))
        ends = np.cumsum([len(head), *map(len, bodies)]) + stream.address
        begins = [batch.column(0).buffers()[1].address for batch in batches]
        same = len(begins) == len(bodies) and all(payload.startswith(head) for payload in payloads)
        if not same or not (ends[:-1] < begins).all() or not (begins < ends[1:]).all():
            raise UnreadableMessageError("one of which is not one whole record batch")
        table = pa.Table.from_batches(batches)
        table.validate()
        combined = table.combine_chunks().to_batches()[0]
        matrix = _matrix(combined, plan)
        timestamps = _timestamps(combined, plan) if plan.timestamp_column >= 0 else None
        cuts = _cuts(matrix[:, 0], np.cumsum([len(batch) for batch in batches])) if plan.has_seq else [0, len(matrix)]
        return [
            _parsed(
                matrix[cut:end],
                [] if timestamps is None else [timestamps[cut:end]],
                int(matrix[cut, 0]) if plan.has_seq else None,
                plan,
            )
            for cut, end in pairwise(cuts)
        ]

    def _make_plan(self, head: bytes) -> _Plan:
        schema = pa.ipc.read_schema(pa.py_buffer(head))
        roles = self._finder.roles(tuple(schema.names))
        selected = self._finder.options.channels
        channels = [one for one in roles.channels if selected or _is_number(schema.field(_index(schema, one[0])).type)]
        if not channels:
            raise UnreadableMessageError("which has no channels")
        stamp = -1 if roles.stamp is None else _index(schema, roles.stamp)
        tick_s = None if stamp < 0 else _tick(schema.field(stamp).type)
        leading = [] if roles.seq is None else [_index(schema, roles.seq)]
        leading += [stamp] if stamp >= 0 and tick_s is None else []
        columns = leading + [_index(schema, column) for column, _, _ in channels]
        for field in map(schema.field, columns):
            if not _is_number(field.type):
                raise UnreadableMessageError(f"whose column {field.name[:40]!r} has {field.type}, and not numbers")
        plan = _Plan(
            schema,
            tuple(name for _, name, _ in channels),
            tuple(_unit(schema.field(_index(schema, column))) or unit for column, _, unit in channels),
            columns,
            len(leading),
            roles.seq is not None,
            stamp >= 0 and tick_s is None,
            -1 if tick_s is None else stamp,
            tick_s or 1.0,
            (roles.stamp or "", "" if stamp < 0 else _unit(schema.field(stamp))),
        )
        if len(self._plans) >= _SCHEMAS:
            self._plans.clear()
        self._plans[head] = plan
        return plan


def _index(schema: pa.Schema, name: str) -> int:
    column = schema.get_field_index(name)
    if column < 0:
        raise UnreadableMessageError(f"which has no column {name[:40]!r}, or two")
    return int(column)


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def _unit(field: pa.Field) -> str:
    unit: bytes = (field.metadata or {}).get(b"unit", b"")
    return unit.decode("utf-8", "replace")


def _tick(kind: pa.DataType) -> float | None:
    """Return the resolution of a timestamp or duration in seconds; None for other types."""
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        return _SECONDS[kind.unit]
    return None


def _matrix(batch: pa.RecordBatch, plan: _Plan) -> Floats:
    numbers = batch.select(plan.columns).to_tensor(null_to_nan=True, row_major=True).to_numpy()
    return np.asarray(numbers, dtype=np.float64)


def _timestamps(batch: pa.RecordBatch, plan: _Plan) -> Floats:
    column = batch.column(plan.timestamp_column)
    if column.null_count:
        raise UnreadableMessageError("which has a row without a stamp")
    return np.asarray(column.view(pa.int64()).to_numpy(), dtype=np.float64) * plan.tick_s


def _cuts(numbers: Floats, ends: Integers) -> list[int]:
    """Return the starts of the runs of consecutive row numbers, and the end; a run must start with a message."""
    breaks = np.flatnonzero(np.diff(numbers) != 1) + 1
    if not np.isin(breaks, ends).all():
        raise UnreadableMessageError("one of which does not number its rows one by one")
    for cut in (0, *breaks):
        first_of(numbers[cut : cut + 1])
    return [0, *breaks.tolist(), len(numbers)]


def _parsed(matrix: Floats, timestamps: list[Floats], seq: int | None, plan: _Plan) -> ParsedMessage:
    time_s = np.concatenate(timestamps) if timestamps else None
    if plan.has_time:
        time_s = _seconds(matrix[:, plan.leading - 1], plan)
    return ParsedMessage(plan.names, plan.units, seq, time_s, np.ascontiguousarray(matrix[:, plan.leading :]))


def _seconds(numbers: Floats, plan: _Plan) -> Floats:
    if plan.stamps is None:
        reader: StampReader = stamps_reader(*plan.stamp, float(numbers[0]))
        if not isinstance(reader, NumberStamps):
            raise UnreadableMessageError("which has a row without a stamp")
        plan.stamps = reader
    return numbers * (plan.stamps.factor / plan.stamps.per_second)
