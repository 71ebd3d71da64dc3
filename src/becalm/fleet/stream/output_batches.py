"""Convert the filters' packed output to rows, or blocks of rows, with the output columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from becalm.files.outputs.tables import VERDICT, verdict_words
from becalm.files.roles import SIGMA
from becalm.fleet.stream.blocks import EstimatedBlock
from becalm.fleet.stream.columns import EVENTS, KIND, READINGS, StreamSchema

_ROWS = 1 << 15  # fewest rows of an output batch, except the last batch
_MICRO = 1e6  # microseconds per second
_TYPES = {
    "string": pa.string(),
    "double": pa.float64(),
    "bigint": pa.int64(),
    "timestamp": pa.timestamp("us", "UTC"),
    "timestamp_ntz": pa.timestamp("us"),
}


class _Answer(NamedTuple):
    """A row of the filters' output, with the columns of `columns.ANSWER`."""

    sensor: str
    estimates: bytes | None
    recipe: str
    event: str | None
    event_rows: int | None
    says: str | None
    noticed_ms: int


def to_output_batches(shape: StreamSchema, batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
    """Convert batches with the columns of `columns.ANSWER` to batches with `StreamSchema.output_columns`."""
    writer = _OutputBatches(shape)
    for batch in batches:
        answers = [_Answer(*row) for row in zip(*(column.to_pylist() for column in batch.columns), strict=True)]
        events = [answer for answer in answers if answer.estimates is None]
        if events:
            yield writer.events(events)
        yield from writer.readings([answer for answer in answers if answer.estimates is not None])


class _OutputBatches:
    def __init__(self, shape: StreamSchema) -> None:
        self._shape = shape
        self._schema = pa.schema([pa.field(name, _type(kind)) for name, kind in shape.output_columns])

    def events(self, answers: Sequence[_Answer]) -> pa.RecordBatch:
        """Return events, one row each."""
        noticed_us = [answer.noticed_ms * 1000 for answer in answers]
        own = {
            self._shape.key: pa.array([answer.sensor for answer in answers], pa.string()),
            KIND: pa.repeat(EVENTS, len(answers)),
            "event": pa.array([answer.event for answer in answers], pa.string()),
            "event_rows": pa.array([answer.event_rows for answer in answers], pa.int64()),
            "says": pa.array([answer.says for answer in answers], pa.string()),
            "noticed": pa.array(noticed_us, pa.int64()).cast(_TYPES["timestamp"]),
        }
        return self._batch(own, len(answers))

    def readings(self, answers: Sequence[_Answer]) -> Iterator[pa.RecordBatch]:
        """Yield estimates as rows; each batch joins the rows of several answers."""
        held: list[pa.RecordBatch] = []
        rows = 0
        for answer in answers:
            estimates = EstimatedBlock.unpacked(answer.estimates or b"")
            held.append(self._rows_of(answer, estimates))
            rows += len(estimates.time_s)
            if rows >= _ROWS:
                yield pa.concat_batches(held)
                held, rows = [], 0
        if held:
            yield pa.concat_batches(held)

    def _rows_of(self, answer: _Answer, estimates: EstimatedBlock) -> pa.RecordBatch:
        shape, many = self._shape, self._readings(estimates)
        rows = 1 if shape.in_blocks else len(estimates.time_s)
        if shape.in_blocks:
            many = {name: pa.ListArray.from_arrays([0, len(column)], column) for name, column in many.items()}
        one = {shape.key: answer.sensor, KIND: READINGS, "recipe": answer.recipe}
        return self._batch(many | {name: pa.repeat(word, rows) for name, word in one.items()}, rows)

    def _readings(self, estimates: EstimatedBlock) -> dict[str, pa.Array]:
        stamps = pa.array(estimates.time_s)
        if self._shape.stamps != "double":
            stamps = pa.array(np.round(estimates.time_s * _MICRO).astype(np.int64)).cast(_TYPES[self._shape.stamps])
        columns = {self._shape.time: stamps}
        signal, sigma, verdicts = (np.ascontiguousarray(part.T) for part in estimates[2:])
        for k, place in enumerate(estimates.places):
            name = self._shape.channels[place]
            columns[name] = pa.array(signal[k])
            columns[name + SIGMA] = pa.array(sigma[k])
            columns[name + VERDICT] = verdict_words(verdicts[k]).dictionary_decode()
        return columns

    def _batch(self, own: dict[str, Any], rows: int) -> pa.RecordBatch:
        columns = [
            own[one.name].cast(one.type) if one.name in own else pa.nulls(rows, one.type) for one in self._schema
        ]
        return pa.RecordBatch.from_arrays(columns, schema=self._schema)


def _type(kind: str) -> pa.DataType:
    """Return the Arrow type of a Spark type in `StreamSchema.output_columns`."""
    if kind.startswith("array<"):
        return pa.list_(pa.field("element", _TYPES[kind.removeprefix("array<").removesuffix(">")]))
    return _TYPES[kind]
