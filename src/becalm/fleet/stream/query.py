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
from becalm.fleet.stream.sources import opened

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
    "spark.sql.caseSensitive": "true",  # so that channels may be called p and P
    "spark.sql.session.timeZone": "UTC",
    "spark.sql.parquet.outputTimestampType": "TIMESTAMP_MICROS",  # the default is the deprecated INT96 type
}
_EMPTY_BATCHES = "spark.sql.streaming.noDataMicroBatches.enabled"


def cleaned(frame: DataFrame, plan: SensorPlan) -> DataFrame:
    """Return the estimates of a stream's rows, for any sink.

    This changes the session: it sets the state store. Spark runs micro-batches without rows only if the plan reports
    silent sensors.

    Parameters
    ----------
    frame : DataFrame
        A stream of rows with a column for the sensor, one for the stamp, and one of numbers for each channel, null
        where missing. Or a stream of blocks of rows, whose stamps and channels are arrays. Or, if the plan has
        `messages`, a stream of messages: the key, `message` (binary), `place` (bigint: their order), `stored_s`
        (double: seconds since 1970).
    plan : SensorPlan
        The options of each sensor.

    Returns
    -------
    DataFrame
        Rows, or blocks, like the input: the key, `kind`, the stamp, for each channel NAME, NAME_sigma and NAME_verdict,
        and `recipe`, the first digits of its hash. Rows of kind "events" describe an event of a sensor's stream
        instead: `event`, `event_rows`, `says` and `noticed`.

    Raises
    ------
    UsageError
        If a column is missing, or has a type that cannot be used.
    BecalmError
        If the plan names no channels, and its recipes cannot be read.
    """
    plan = plan.with_channels()
    _set_all(frame.sparkSession, _STATES | {_EMPTY_BATCHES: _word(plan.silent_s is not None)})
    return _filtered(*blocks_of(frame, plan), plan)


def run(spark: SparkSession, plan: StreamPlan) -> StreamingQuery:
    """Start a stream that filters every sensor of a source and writes Parquet files. Each row is written once.

    Parameters
    ----------
    spark : SparkSession
        The Spark to use. Its settings are not changed.
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
    """Check a stream, and return a function that starts it as `run` does; nothing is written before its call.

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
    shape, blocks, sensors = opened(session, plan)
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
        If the stream failed, with the reason in a sentence.
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
