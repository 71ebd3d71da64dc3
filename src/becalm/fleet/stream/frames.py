"""Convert a Spark frame of rows or messages to blocks of one sensor each. This module needs Spark."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from pyspark.sql import functions as sql

from becalm.errors import UsageError
from becalm.fleet.stream.columns import BATCH, MESSAGE, StreamSchema, quoted, shape_of
from becalm.fleet.stream.gathering import gathered
from becalm.fleet.stream.plan import SensorPlan
from becalm.live.messages.encoding import TIME

if TYPE_CHECKING:
    from pyspark.sql import Column, DataFrame


def blocks_of(frame: DataFrame, plan: SensorPlan) -> tuple[StreamSchema, DataFrame]:
    """Return the columns of a frame of rows or messages, and a frame with blocks of one sensor each.

    The plan must name its channels.

    Raises
    ------
    UsageError
        If a column is missing, or has a type that cannot be used.
    """
    key = sql.coalesce(_column(plan.key).cast("string"), sql.lit("")).alias("sensor")
    if plan.messages is not None:
        missing = [name for name in (plan.key, *MESSAGE) if name not in frame.columns]
        if missing:
            raise UsageError(f"Messages need the columns {', '.join((plan.key, *MESSAGE))}; {missing[0]!r} is missing.")
        named = [_column(name).alias(own) for name, own in MESSAGE.items()]
        return StreamSchema(plan.key, TIME, plan.channels), frame.select(key, *named).where("batch IS NOT NULL")
    shape = shape_of(frame.dtypes, plan.key, plan.time, plan.channels)
    kind = "array<double>" if shape.in_blocks else "double"
    channels = [
        (_column(name) if name in frame.columns else sql.lit(None)).cast(kind).alias(name) for name in shape.channels
    ]
    return shape, frame.select(key, _column(shape.time), *channels).mapInArrow(partial(gathered, len(channels)), BATCH)


def _column(name: str) -> Column:
    return sql.col(quoted(name))
