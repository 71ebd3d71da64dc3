"""A Spark source that reads the messages of a NATS JetStream stream by sequence numbers. This module needs Spark.

A micro-batch is a range of sequence numbers, so a repeated read gives the same messages. Spark stores the position in
the stream; the server does not.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pyarrow as pa
from pyspark.sql.datasource import DataSource, DataSourceStreamReader, InputPartition
from pyspark.sql.streaming.datasource import ReadLimit, ReadMaxRows, SupportsTriggerAvailableNow

from becalm.fleet.stream.columns import MESSAGE
from becalm.fleet.stream.jetstream_range import StreamRange, found_in, messages_of
from becalm.fleet.stream.plan import START, most_of
from becalm.live.address import Address
from becalm.live.protocols import AwayError

if TYPE_CHECKING:
    from pyspark.sql import DataFrame, SparkSession

_NAME = "becalm_nats"
_SCHEMA = "sensor string, place bigint, message binary, stored_s double"
_FEWEST = 2000  # fewest messages of a task if a micro-batch has several tasks
_log = logging.getLogger(__name__)


@dataclass
class _Range(InputPartition):
    """The numbers of the first and the last message that one task reads."""

    first: int
    last: int


class _Source(DataSource):
    @classmethod
    def name(cls) -> str:
        return _NAME

    def schema(self) -> str:
        return _SCHEMA

    def streamReader(self, schema: Any) -> DataSourceStreamReader:  # noqa: N802  (Spark's name)
        return _Reader(Address(**json.loads(self.options["address"])), int(self.options["tasks"]))


class _Reader(DataSourceStreamReader, SupportsTriggerAvailableNow):
    """A reader that finds the available messages and reads them.

    An offset has the sequence number of the last message that was read, and the time at which the stream was created.
    """

    def __init__(self, address: Address, tasks: int) -> None:
        self._address, self._tasks = address, tasks
        self._end: int | None = None  # sequence number of the last message to read; None if the query has no end

    def initialOffset(self) -> dict[str, Any]:  # noqa: N802
        span = found_in(self._address)
        begins = self._address.chosen(START, ("first", "now"), "first") == "first"
        return _offset(span.first - 1 if begins else span.last, span)

    def latestOffset(self, start: Mapping[str, Any], limit: ReadLimit) -> dict[str, Any]:  # noqa: N802
        try:
            span = found_in(self._address)
        except AwayError as cause:
            if self._end is not None:  # without an error, the query would end as if it had read all messages
                raise
            _log.warning("%s", cause)
            return dict(start)
        after = _after(start, span)
        end = span.last if self._end is None else min(span.last, max(self._end, after))
        if isinstance(limit, ReadMaxRows):
            end = min(end, after + limit.max_rows)
        return _offset(max(after, end), span)

    def getDefaultReadLimit(self) -> ReadLimit:  # noqa: N802
        return ReadMaxRows(most_of(self._address))

    def prepareForTriggerAvailableNow(self) -> None:  # noqa: N802
        self._end = found_in(self._address).last

    def partitions(self, start: Mapping[str, Any], end: Mapping[str, Any]) -> Sequence[InputPartition]:
        first = start["message"] + 1 if start["created"] == end["created"] else 1
        count = end["message"] + 1 - first
        tasks = max(1, min(self._tasks, count // _FEWEST))
        cuts = [first + count * task // tasks for task in range(tasks + 1)]
        return [_Range(a, b - 1) for a, b in pairwise(cuts)] if count > 0 else []

    def read(self, partition: InputPartition) -> Iterator[pa.RecordBatch]:
        assert isinstance(partition, _Range)
        for messages in messages_of(self._address, partition.first, partition.last):
            columns = [
                pa.array([message.subject for message in messages], pa.string()),
                pa.array([message.number for message in messages], pa.int64()),
                pa.array([message.payload for message in messages], pa.binary()),
                pa.array([message.stored_s for message in messages], pa.float64()),
            ]
            yield pa.RecordBatch.from_arrays(columns, names=["sensor", *MESSAGE])


def nats_messages(spark: SparkSession, address: Address, key: str) -> DataFrame:
    """Return the messages of a stream, `nats://HOST:PORT/STREAM?subject=plant.>&start=first|now&most=N`.

    The subject of a message is the name of its sensor. The other options of the address are those of `becalm live`.
    Each worker reads secrets from its own environment, or from files.

    Raises
    ------
    BecalmError
        If the stream does not exist, deletes messages after they are read, or its server cannot be reached.
    """
    found_in(address)
    spark.dataSource.register(_Source)
    reader = spark.readStream.format(_NAME).option("address", json.dumps(asdict(address)))
    frame = reader.option("tasks", str(spark.sparkContext.defaultParallelism)).load()
    return frame.withColumnRenamed("sensor", key)


def _after(start: Mapping[str, Any], span: StreamRange) -> int:
    """Return the sequence number after which to read; log a warning if it is not the last one that was read."""
    read = int(start["message"])
    if start["created"] != span.created:
        _log.warning("The stream was created anew since message %d; it is read from its beginning.", read)
        return span.first - 1
    if read > span.last:
        _log.warning("The stream lost its messages %d to %d, which had been read.", span.last + 1, read)
        return span.last
    if read < span.first - 1:
        _log.warning("Messages %d to %d were deleted before they were read.", read + 1, span.first - 1)
    return max(read, span.first - 1)


def _offset(message: int, span: StreamRange) -> dict[str, Any]:
    return {"message": message, "created": span.created}
