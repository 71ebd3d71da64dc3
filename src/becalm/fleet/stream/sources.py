"""Open the source of a stream's rows: files, Kafka or NATS. This module needs Spark."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING

from pyspark.errors import AnalysisException
from pyspark.sql import functions as sql

from becalm.errors import OutputError, UsageError
from becalm.files.parquet import PARQUET_ENDINGS
from becalm.fleet.stream.columns import BATCH, MESSAGE, StreamSchema
from becalm.fleet.stream.frames import blocks_of
from becalm.fleet.stream.lake import lake_shape, read_files
from becalm.fleet.stream.plan import MOST, START, SensorPlan, StreamPlan, most_of
from becalm.live.address import Address
from becalm.live.messages.stream import MessageStream

if TYPE_CHECKING:
    from pyspark.sql import DataFrame, SparkSession

_EVER = "36500d"  # age of the oldest file to read; by default, Spark skips files a week older than the newest
_LAKE_BYTES = 256 << 20  # largest input of a micro-batch in bytes; its rows are sorted in memory
_FILE = "path string, modificationTime timestamp, length bigint, content binary"  # becalm uses only the path
_PATTERN = re.compile(r"[][*?{}\\]")  # characters that Spark would read as a pattern in a folder's name
_KAFKA_START = {"first": "earliest", "now": "latest"}
_KAFKA = "org.apache.spark:spark-sql-kafka-0-10_2.13"


def open_source(spark: SparkSession, plan: StreamPlan) -> tuple[StreamSchema, DataFrame, SensorPlan]:
    """Return the columns of a source, its blocks, and the sensors' plan, with `messages` if the rows are messages.

    Raises
    ------
    BecalmError
        If the source does not exist, or its address is not valid.
    """
    sensors = plan.sensors.with_channels()
    if "://" not in plan.source:
        _refuse_circle(plan)
        shape = lake_shape(plan.source, sensors)
        return shape, _paths(spark, plan.source).mapInArrow(partial(read_files, plan.source, shape), BATCH), sensors
    address = Address.parsed(plan.source)
    if address.kind not in ("kafka", "nats"):
        raise UsageError(
            f"{address} is not a source of a fleet; name a folder, kafka://HOST:PORT/TOPIC or nats://HOST/STREAM."
        )
    address.refuse_unknown(_options(address.kind))
    sensors = replace(sensors, messages=address)
    return *blocks_of(_messages(spark, address, sensors.key), sensors), sensors


def _refuse_circle(plan: StreamPlan) -> None:
    if Path(plan.output).resolve().is_relative_to(Path(plan.source).resolve()):
        raise OutputError(
            f"The output {plan.output} is in the source {plan.source}, and would be read again; name a folder outside"
            " of it."
        )


def _messages(spark: SparkSession, address: Address, key: str) -> DataFrame:
    if address.kind == "kafka":
        return kafka_messages(spark, address, key)
    from becalm.fleet.stream.jetstream import nats_messages

    return nats_messages(spark, address, key)


def _paths(spark: SparkSession, lake: str) -> DataFrame:
    """Return a stream of the paths of all present and future Parquet files in a folder and its subfolders.

    Files are read in the order of their modification times. A new file must be complete when it appears, by a rename.
    """
    reader = spark.readStream.format("binaryFile").schema(_FILE).option("maxBytesPerTrigger", str(_LAKE_BYTES))
    reader = reader.option("maxFileAge", _EVER)
    either = {letter: f"[{letter}{letter.upper()}]" for letter in ascii_lowercase}  # globs are case-sensitive
    endings = ",".join("".join(either.get(sign, sign) for sign in ending) for ending in PARQUET_ENDINGS)
    reader = reader.option("pathGlobFilter", f"*{{{endings}}}").option("recursiveFileLookup", "true")
    return reader.load(_PATTERN.sub(r"\\\g<0>", lake)).select("path")


def kafka_messages(spark: SparkSession, address: Address, key: str) -> DataFrame:
    """Return the messages of a topic, `kafka://HOST:PORT/TOPIC?start=first|now&most=N`; a message's key is its sensor.

    Raises
    ------
    UsageError
        If the address names no topic, or Spark has no source for Kafka.
    """
    servers, _, topic = address.rest.removeprefix("//").partition("/")
    if "@" in servers:
        raise UsageError(
            "A Kafka address cannot contain name and password; set them with --conf, as Kafka's security needs."
        )
    if not servers or not topic:
        raise UsageError(f"{address} names no servers and topic; write kafka://HOST:9092/TOPIC.")
    start = _KAFKA_START[address.chosen(START, tuple(_KAFKA_START), "first")]
    reader = spark.readStream.format("kafka").option("kafka.bootstrap.servers", servers).option("subscribe", topic)
    try:
        frame = reader.option("startingOffsets", start).option("maxOffsetsPerTrigger", str(most_of(address))).load()
    except AnalysisException as cause:
        if cause.getCondition() != "KAFKA_DATA_SOURCE_NOT_ENABLED":
            raise
        raise UsageError(
            "Spark needs an additional library for Kafka; add --conf spark.jars.packages="
            f"{_KAFKA}:{spark.version}, or, without a network, --conf spark.jars=FILE,FILE with its files."
        ) from cause
    columns = {"message": "value", "place": "offset", "stored_s": "timestamp"}
    kinds = {"message": "binary", "place": "bigint", "stored_s": "double"}
    messages = [sql.col(columns[name]).cast(kinds[name]).alias(name) for name in MESSAGE]
    return frame.select(sql.col("key").cast("string").alias(key), *messages)


def _options(kind: str) -> Sequence[str]:
    from becalm.live.brokers.remote import OPTIONS

    of_nats = ("subject", "creds", *OPTIONS) if kind == "nats" else ()
    return (START, MOST, *MessageStream.OPTIONS, *of_nats)
