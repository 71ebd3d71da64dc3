"""Filter a fleet of sensors live: Spark's structured streaming stores a state for each sensor.

`run(spark, StreamPlan(...))` starts a stream from files, Kafka or NATS into Parquet files.
`cleaned(frame, SensorPlan(...))` filters rows of any other source for any other sink. Spark is loaded when one of
these functions is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from becalm.fleet.stream.live_book import LiveBook
from becalm.fleet.stream.plan import Book, SensorPlan, StreamPlan

if TYPE_CHECKING:
    from becalm.fleet.stream.query import cleaned, prepared, run, wait

__all__ = ["Book", "LiveBook", "SensorPlan", "StreamPlan", "cleaned", "prepared", "run", "wait"]


def __getattr__(name: str) -> Any:
    """Load the functions that need Spark at their first use."""
    if name not in ("cleaned", "prepared", "run", "wait"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from becalm.fleet.stream import query

    return getattr(query, name)
