"""Define the processor that Spark calls for each sensor in each micro-batch. This module needs Spark."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from pyspark.sql import Row
from pyspark.sql.streaming.stateful_processor import (
    ExpiredTimerInfo,
    StatefulProcessor,
    StatefulProcessorHandle,
    TimerValues,
)

from becalm.fleet.stream.blocks import Event
from becalm.fleet.stream.reading import Entry
from becalm.fleet.stream.sensor import SensorStep, SensorStreamProcessor
from becalm.fleet.stream.state import SensorState

_SHOWN = 12  # digits of a recipe's hash in the output


class SensorProcessor(StatefulProcessor):
    """A Spark processor whose state for each sensor is in Spark's state store.

    Parameters
    ----------
    sensor_stream : SensorStreamProcessor
        The processor of one sensor's rows.
    """

    def __init__(self, sensor_stream: SensorStreamProcessor) -> None:
        self._sensor_stream = sensor_stream

    def init(self, handle: StatefulProcessorHandle) -> None:
        """Open the state store at the start of a micro-batch."""
        self._handle = handle
        self._state = handle.getValueState("sensor", "state binary")

    def handleInputRows(  # noqa: N802  (Spark's names)
        self,
        key: Any,
        rows: Iterator[Any],
        timerValues: TimerValues,  # noqa: N803
    ) -> Iterator[Row]:
        """Process the new rows of a sensor."""
        now_ms = timerValues.getCurrentProcessingTimeInMs()
        entries = [Entry(row.place, row.batch, row.stored_s) for row in rows]
        return self._store_step(
            key[0], self._sensor_stream.process_rows(key[0], self._stored(), entries, now_ms), now_ms
        )

    def handleExpiredTimer(  # noqa: N802
        self,
        key: Any,
        timerValues: TimerValues,  # noqa: N803
        expiredTimerInfo: ExpiredTimerInfo,  # noqa: N803
    ) -> Iterator[Row]:
        """Check whether a sensor is silent; Spark calls this when its timer expires."""
        now_ms, before = timerValues.getCurrentProcessingTimeInMs(), self._stored()
        if before is None:
            return iter(())
        return self._store_step(key[0], self._sensor_stream.check_silence(before, now_ms), now_ms)

    def close(self) -> None:
        """Do nothing; Spark requires this method."""

    def _stored(self) -> SensorState | None:
        held = self._state.get()
        return None if held is None else SensorState.unpacked(bytes(held[0]))

    def _store_step(self, sensor: str, step: SensorStep, now_ms: int) -> Iterator[Row]:
        if step.state is None:
            self._state.clear()
        else:
            self._state.update((step.state.packed(),))
        if step.timer_ms is not None:
            self._handle.registerTimer(step.timer_ms)
        return iter(_answers(self._sensor_stream.output_name(sensor), step, now_ms))


def _answers(sensor: str, step: SensorStep, now_ms: int) -> Sequence[Row]:
    shared = {"sensor": sensor, "recipe": step.recipe[:_SHOWN], "noticed_ms": now_ms}
    rows = [Row(**shared, **_of(event)) for event in step.events]
    if step.estimates is not None:
        rows.append(Row(**shared, estimates=step.estimates.packed()))
    return rows


def _of(event: Event) -> dict[str, Any]:
    return {"event": event.kind, "event_rows": event.rows, "says": event.says}
