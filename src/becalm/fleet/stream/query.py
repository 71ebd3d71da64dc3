"""A stream over a fleet as a query of Spark. Loaded only where Spark is."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

from py4j.protocol import Py4JError
from pyspark.errors import StreamingQueryException

from becalm.errors import InputError
from becalm.files.roles import SIGMA
from becalm.fleet.session import reason_of
from becalm.fleet.stream.claim import claim, refuse_other
from becalm.fleet.stream.frames import blocks_of
from becalm.fleet.stream.plan import SensorPlan, StreamPlan
from becalm.fleet.stream.processor import SensorProcessor
from becalm.fleet.stream.sensor import SensorWalk
from becalm.fleet.stream.shape import ANSWER, KIND, StreamSchema
from becalm.fleet.stream.sources import opened
from becalm.fleet.stream.telling import told_as

if TYPE_CHECKING:
    from pyspark.sql import DataFrame, SparkSession
    from pyspark.sql.streaming.query import StreamingQuery

_RAISED = re.compile(r"^(?P<kind>[A-Za-z_][\w.]*(?:Error|Exception)): (?P<says>.+)$", re.MULTILINE)  # in a worker
_NUMBERED = re.compile(
    r"^(?:\[[A-Z_.]+\] )?Query \[id = [^]]*\] terminated with exception: |^\[[A-Z_.]+\] | SQLSTATE: \w+"
)
_STATES = {
    "spark.sql.streaming.stateStore.providerClass": (
        "org.apache.spark.sql.execution.streaming.state.RocksDBStateStoreProvider"
    ),
    "spark.sql.streaming.stateStore.rocksdb.changelogCheckpointing.enabled": "true",
}
_FILES = {
    "spark.sql.caseSensitive": "true",  # channels may be called p and P
    "spark.sql.session.timeZone": "UTC",
    "spark.sql.parquet.outputTimestampType": "TIMESTAMP_MICROS",  # else nanoseconds, in a type that is given up
}
_EMPTY_BATCHES = "spark.sql.streaming.noDataMicroBatches.enabled"


def cleaned(frame: DataFrame, plan: SensorPlan) -> DataFrame:
    """Return what is told of a stream's rows, for any sink.

    The session gets the store of states that this needs; and, where the plan says when a sensor is silent, it goes on
    with micro-batches while no row comes, else not.

    Parameters
    ----------
    frame : DataFrame
        A stream of rows: a column tells whose, one when, and each channel has one of numbers, null where missing. Or
        of blocks of rows, whose stamps and channels are arrays. Or of messages, where the plan says so: the key,
        `message` (binary), `place` (bigint: their order), `stored_s` (double: seconds since 1970).
    plan : SensorPlan
        What is done with each sensor.

    Returns
    -------
    DataFrame
        In the shape that came: the key, `kind`, the stamp, of each channel NAME, NAME_sigma and NAME_verdict, and
        `recipe`, the first digits of its hash. Rows of kind "events" tell what befell a sensor's stream instead:
        `event`, `event_rows`, `says` and `noticed`.

    Raises
    ------
    UsageError
        If a column is not there, or of a type that it cannot have.
    BecalmError
        If the plan names no channels, and its recipes cannot be read.
    """
    plan = plan.with_channels()
    _settle(frame.sparkSession, _STATES | {_EMPTY_BATCHES: _word(plan.silent_s is not None)})
    return _filtered(*blocks_of(frame, plan), plan)


def run(spark: SparkSession, plan: StreamPlan) -> StreamingQuery:
    """Start a stream: from a source through every sensor's filters into Parquet files, each row once.

    Parameters
    ----------
    spark : SparkSession
        Where. Its settings stay as they are.
    plan : StreamPlan
        From where, where to, and how.

    Returns
    -------
    StreamingQuery
        Which runs; `awaitTermination()` waits for its end.

    Raises
    ------
    BecalmError
        If the source is not there or its columns do not fit, or the output belongs to another stream.
    """
    return prepared(spark, plan)()


def prepared(spark: SparkSession, plan: StreamPlan) -> Callable[[], StreamingQuery]:
    """Return what starts a stream, as `run` does; nothing is written before that.

    Raises
    ------
    BecalmError
        As `run`.
    """
    session = spark.newSession()
    looks = plan.sensors.silent_s is not None and not plan.once
    beside = {_EMPTY_BATCHES: _word(looks), "spark.sql.shuffle.partitions": str(plan.partitions)}
    _settle(session, _STATES | _FILES | beside)
    refuse_other(session, plan)
    shape, blocks, sensors = opened(session, plan)
    told = _filtered(shape, blocks, sensors)
    writer = (
        told.writeStream.format("parquet")
        .outputMode("append")
        .partitionBy(KIND, sensors.key)
        .option("path", plan.output)
        .option("checkpointLocation", plan.checkpoint_folder)
        .options(**_plainly(told))
    )
    if plan.once:
        writer = writer.trigger(availableNow=True)
    else:
        writer = writer.trigger(processingTime=f"{round(plan.every_s * 1000)} milliseconds")

    def begin() -> StreamingQuery:
        claim(session, plan)
        return writer.start()

    return begin


def wait(query: StreamingQuery) -> None:
    """Wait until a stream has ended.

    Parameters
    ----------
    query : StreamingQuery
        What `run` returned.

    Raises
    ------
    InputError
        If the stream failed; it says why in a sentence.
    """
    try:
        query.awaitTermination()
    except (Py4JError, ConnectionError) as cause:
        raise InputError(f"The stream ended ({reason_of(cause)}). What was told stays; begin it again.") from cause
    except StreamingQueryException as cause:
        raised = [found for found in _RAISED.finditer(str(cause)) if not found["kind"].startswith(("java.", "org."))]
        says = _NUMBERED.sub("", raised[-1]["says"] if raised else str(cause).strip().splitlines()[0])
        raise InputError(f"The stream ended: {says.rstrip('.')}. What was told stays; begin it again.") from cause


def _settle(spark: SparkSession, settings: Mapping[str, str]) -> None:
    for name, value in settings.items():
        spark.conf.set(name, value)


def _word(is_so: bool) -> str:
    return str(is_so).lower()


def _filtered(shape: StreamSchema, blocks: DataFrame, plan: SensorPlan) -> DataFrame:
    processor = SensorProcessor(SensorWalk(plan, shape.channels))
    answers = blocks.groupBy("sensor").transformWithState(
        processor, outputStructType=ANSWER, outputMode="Append", timeMode="ProcessingTime"
    )
    return answers.mapInArrow(partial(told_as, shape), shape.told_ddl)


def _plainly(told: DataFrame) -> dict[str, str]:
    """Return options by which numbers that hardly repeat are written as they are: no dictionary is tried for them."""
    names = [name for name, kind in told.dtypes if kind in ("double", "timestamp") and not name.endswith(SIGMA)]
    return {f"parquet.enable.dictionary#{name}": "false" for name in names}
