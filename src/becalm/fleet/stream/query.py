"""Run a stream over a fleet as a Spark query. This module needs Spark."""

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
from becalm.fleet.stream.columns import ANSWER, KIND, StreamSchema
from becalm.fleet.stream.frames import blocks_of
from becalm.fleet.stream.output_batches import to_output_batches
from becalm.fleet.stream.plan import SensorPlan, StreamPlan
from becalm.fleet.stream.processor import SensorProcessor
from becalm.fleet.stream.sensor import SensorStreamProcessor
from becalm.fleet.stream.sources import open_source

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
    "spark.sql.caseSensitive": "true",  # so that two channels may have the names p and P
    "spark.sql.session.timeZone": "UTC",
    "spark.sql.parquet.outputTimestampType": "TIMESTAMP_MICROS",  # the default is the deprecated INT96 type
}
_EMPTY_BATCHES = "spark.sql.streaming.noDataMicroBatches.enabled"


def cleaned(frame: DataFrame, plan: SensorPlan) -> DataFrame:
    """Return a stream of estimates from a stream of rows, for any sink.

    This function changes settings of the Spark session: the state store, and whether Spark runs micro-batches without
    rows, which is needed only to report silent sensors.

    Parameters
    ----------
    frame : DataFrame
        A stream of one of three kinds. Rows: a column for the sensor, one for the stamp, and one of numbers for each
        channel, null where missing. Blocks: the same with arrays of stamps and readings. Messages, if the plan has
        `messages`: the key, `message` (binary), `place` (bigint, the order of messages), and `stored_s` (double,
        seconds since 1970).
    plan : SensorPlan
        The options of each sensor.

    Returns
    -------
    DataFrame
        Rows, or blocks if the input has blocks. Their columns are the key, `kind`, the stamp, for each channel NAME,
        NAME_sigma and NAME_verdict, and `recipe`, the first digits of the recipe's hash. Rows of kind "events" instead
        describe an event of a sensor's stream, in `event`, `event_rows`, `says` and `noticed`.

    Raises
    ------
    UsageError
        If a column is missing, or has a type that cannot be used.
    BecalmError
        If the plan names no channels and a recipe cannot be read.
    """
    plan = plan.with_channels()
    _set_all(frame.sparkSession, _STATES | {_EMPTY_BATCHES: _word(plan.silent_s is not None)})
    return _filtered(*blocks_of(frame, plan), plan)


def run(spark: SparkSession, plan: StreamPlan) -> StreamingQuery:
    """Start a stream that filters every sensor of a source and writes Parquet files. Each row is written once.

    Parameters
    ----------
    spark : SparkSession
        The Spark to use. Its settings do not change.
    plan : StreamPlan
        The source, the output and the options.

    Returns
    -------
    StreamingQuery
        The running query; `awaitTermination()` waits for its end.

    Raises
    ------
    BecalmError
        If the source does not exist, its columns do not fit, or the output belongs to another stream.
    """
    return prepared(spark, plan)()


def prepared(spark: SparkSession, plan: StreamPlan) -> Callable[[], StreamingQuery]:
    """Check a stream, and return a function that starts the stream; nothing is written before its call.

    Raises
    ------
    BecalmError
        As `run`.
    """
    session = spark.newSession()
    checks_silence = plan.sensors.silent_s is not None and not plan.once
    of_plan = {_EMPTY_BATCHES: _word(checks_silence), "spark.sql.shuffle.partitions": str(plan.partitions)}
    _set_all(session, _STATES | _FILES | of_plan)
    refuse_other(session, plan)
    shape, blocks, sensors = open_source(session, plan)
    estimates = _filtered(shape, blocks, sensors)
    writer = (
        estimates.writeStream.format("parquet")
        .outputMode("append")
        .partitionBy(KIND, sensors.key)
        .option("path", plan.output)
        .option("checkpointLocation", plan.checkpoint_folder)
        .options(**_plain_encoding(estimates))
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
        The query that `run` returned.

    Raises
    ------
    InputError
        If the stream failed; the message has the reason.
    """
    try:
        query.awaitTermination()
    except (Py4JError, ConnectionError) as cause:
        raise InputError(
            f"The stream ended ({reason_of(cause)}). Estimates that were written stay; start the stream again."
        ) from cause
    except StreamingQueryException as cause:
        raised = [match for match in _RAISED.finditer(str(cause)) if not match["kind"].startswith(("java.", "org."))]
        says = _NUMBERED.sub("", raised[-1]["says"] if raised else str(cause).strip().splitlines()[0])
        raise InputError(
            f"The stream ended: {says.rstrip('.')}. Estimates that were written stay; start the stream again."
        ) from cause


def _set_all(spark: SparkSession, settings: Mapping[str, str]) -> None:
    for name, value in settings.items():
        spark.conf.set(name, value)


def _word(is_so: bool) -> str:
    return str(is_so).lower()


def _filtered(shape: StreamSchema, blocks: DataFrame, plan: SensorPlan) -> DataFrame:
    processor = SensorProcessor(SensorStreamProcessor(plan, shape.channels))
    answers = blocks.groupBy("sensor").transformWithState(
        processor, outputStructType=ANSWER, outputMode="Append", timeMode="ProcessingTime"
    )
    return answers.mapInArrow(partial(to_output_batches, shape), shape.output_ddl)


def _plain_encoding(estimates: DataFrame) -> dict[str, str]:
    """Return Parquet options that disable the dictionary for columns whose numbers hardly repeat."""
    names = [name for name, kind in estimates.dtypes if kind in ("double", "timestamp") and not name.endswith(SIGMA)]
    return {f"parquet.enable.dictionary#{name}": "false" for name in names}
