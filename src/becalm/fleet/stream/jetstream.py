"""The messages of a NATS JetStream stream as a source of Spark's, each read by its number. Loaded only where Spark is.

A micro-batch is a range of numbers, so that it is the same whenever it is read; the server keeps no account of it.
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

from becalm.fleet.stream.jetstream_range import StreamRange, found_in, messages_of
from becalm.fleet.stream.plan import START, most_of
from becalm.fleet.stream.shape import MESSAGE
from becalm.live.address import Address
from becalm.live.protocols import AwayError

if TYPE_CHECKING:
    from pyspark.sql import DataFrame, SparkSession

_NAME = "becalm_nats"
_SCHEMA = "sensor string, place bigint, message binary, stored_s double"
_FEWEST = 2000  # messages for which another task is worth its start
_log = logging.getLogger(__name__)


@dataclass
class _Range(InputPartition):
    """Messages that one task reads."""

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
    """Tells which messages are there, and reads them.

    An offset is the number of the last message that was read, and when its stream was made.
    """

    def __init__(self, address: Address, tasks: int) -> None:
        self._address, self._tasks = address, tasks
        self._end: int | None = None  # beyond which nothing is read, where the stream ends with what is there

    def initialOffset(self) -> dict[str, Any]:  # noqa: N802
        found = found_in(self._address)
        begins = self._address.chosen(START, ("first", "now"), "first") == "first"
        return _offset(found.first - 1 if begins else found.last, found)

    def latestOffset(self, start: Mapping[str, Any], limit: ReadLimit) -> dict[str, Any]:  # noqa: N802
        try:
            found = found_in(self._address)
        except AwayError as cause:
            if self._end is not None:  # it would end with what is read, and seem to have read all
                raise
            _log.warning("%s", cause)
            return dict(start)
        after = _after(start, found)
        end = found.last if self._end is None else min(found.last, max(self._end, after))
        if isinstance(limit, ReadMaxRows):
            end = min(end, after + limit.max_rows)
        return _offset(max(after, end), found)

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
        for told in messages_of(self._address, partition.first, partition.last):
            columns = [
                pa.array([message.subject for message in told], pa.string()),
                pa.array([message.number for message in told], pa.int64()),
                pa.array([message.payload for message in told], pa.binary()),
                pa.array([message.stored_s for message in told], pa.float64()),
            ]
            yield pa.RecordBatch.from_arrays(columns, names=["sensor", *MESSAGE])


def nats_messages(spark: SparkSession, address: Address, key: str) -> DataFrame:
    """Return the messages of a stream, `nats://HOST:PORT/STREAM?subject=plant.>&start=first|now&most=N`.

    A sensor is named by its messages' subject. Other options are those of `becalm live`; workers find secrets in
    their own environment, or in files.

    Raises
    ------
    BecalmError
        If the stream is not there, its server cannot be reached, or it forgets what was read.
    """
    found_in(address)
    spark.dataSource.register(_Source)
    reader = spark.readStream.format(_NAME).option("address", json.dumps(asdict(address)))
    told = reader.option("tasks", str(spark.sparkContext.defaultParallelism)).load()
    return told.withColumnRenamed("sensor", key)


def _after(start: Mapping[str, Any], found: StreamRange) -> int:
    """Return the message after which to read; say where that is not the last one that was read."""
    read = int(start["message"])
    if start["created"] != found.created:
        _log.warning("The stream was made anew since message %d; it is read from its beginning.", read)
        return found.first - 1
    if read > found.last:
        _log.warning("The stream lost its messages %d to %d, which had been read.", found.last + 1, read)
        return found.last
    if read < found.first - 1:
        _log.warning("Messages %d to %d were deleted before they were read.", read + 1, found.first - 1)
    return max(read, found.first - 1)


def _offset(message: int, found: StreamRange) -> dict[str, Any]:
    return {"message": message, "created": found.created}
