"""Group rows of many sensors into blocks of one sensor each, before Spark moves them between workers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Booleans, Floats, Integers
from becalm.fleet.stream.blocks import SensorRows, UnreadableInput

_HELD_ROWS = 1 << 18  # rows in the buffer at which all are released
_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}  # ticks of Arrow timestamps

Seconds = Callable[[pa.Array], Floats]
"""A function that converts a column of stamps to seconds."""


class _Samples(NamedTuple):
    """Rows of many sensors, one after another."""

    sensor_numbers: Integers  # (N,) the sensor's number for each row, from `SensorBlockBuffer.number_sensors`
    time_s: Floats  # (N,) stamps in seconds; NaN where missing
    values: Floats  # (N, m) readings of the channels; NaN where missing


class SensorBlockBuffer:
    """A buffer that collects rows and releases them as blocks of one sensor each.

    Parameters
    ----------
    width : int
        Number of channels.
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self._numbers: dict[tuple[str, tuple[str, ...]], int] = {}
        self._held: list[_Samples] = []
        self._garbled: dict[int, list[UnreadableInput]] = {}
        self._rows = 0

    def number_sensors(self, sensors: pa.Array, units: tuple[str, ...] = ()) -> Integers:
        """Return the sensor's number for each row, (N,); rows with other `units` have another number."""
        own = sensors.fill_null("").dictionary_encode()
        numbers = np.array([self._number(name, units) for name in own.dictionary.to_pylist()], np.int64)
        return np.asarray(numbers[own.indices.to_numpy()])

    def add_loss(self, sensor: str, garbled: UnreadableInput) -> None:
        """Store a loss of a sensor, which is released with the sensor's next block."""
        self._garbled.setdefault(self._number(sensor, ()), []).append(garbled)

    def add(self, sensor_numbers: Integers, columns: Sequence[pa.Array], seconds: Seconds) -> Iterator[pa.RecordBatch]:
        """Add rows, or blocks of rows; if enough rows are buffered, yield all, with the columns of `columns.BATCH`.

        Parameters
        ----------
        sensor_numbers : (N,) int array
            The sensor's number for each row, from `number_sensors`.
        columns : sequence of (N,) Arrow arrays
            Stamps, and the readings of each channel.
        seconds : callable
            Converts stamps to seconds.
        """
        samples, garbled = _samples(sensor_numbers, columns, seconds)
        for number, lost in enumerate(np.bincount(garbled)):
            if lost:
                says = f"{lost} blocks came with columns of different lengths; they were left out."
                self._garbled.setdefault(number, []).append(UnreadableInput(int(lost), says))
        self._held.append(samples)
        self._rows += len(samples.time_s)
        if self._rows >= _HELD_ROWS:
            yield from self.rest()

    def rest(self) -> Iterator[pa.RecordBatch]:
        """Yield all buffered rows as blocks of one sensor each, with the columns of `columns.BATCH`."""
        nothing = _Samples(np.empty(0, np.int64), np.empty(0), np.empty((0, self._width)))
        sensor_numbers, time_s, values = (np.concatenate(parts) for parts in zip(nothing, *self._held, strict=True))
        order = np.argsort(sensor_numbers, kind="stable")
        ends = np.cumsum(np.bincount(sensor_numbers, minlength=len(self._numbers)))
        time_s, values = time_s[order], values[order]
        packed: list[tuple[str, bytes]] = []
        for number, (sensor, units) in enumerate(self._numbers):
            own = slice(ends[number - 1] if number else 0, ends[number])
            garbled = tuple(self._garbled.get(number, ()))
            if own.start < own.stop or garbled:
                packed.append((sensor, SensorRows(time_s[own], values[own], units, garbled).packed()))
        self._held, self._rows, self._garbled = [], 0, {}
        if packed:
            yield self._batch(packed)

    def _number(self, sensor: str, units: tuple[str, ...]) -> int:
        return self._numbers.setdefault((sensor, units), len(self._numbers))

    def _batch(self, packed: Sequence[tuple[str, bytes]]) -> pa.RecordBatch:
        columns = [
            pa.array([sensor for sensor, _ in packed], pa.string()),
            pa.array(np.zeros(len(packed), np.int64)),  # rows without a place are sorted by stamp
            pa.array([blob for _, blob in packed], pa.binary()),
            pa.array(np.zeros(len(packed))),
        ]
        return pa.RecordBatch.from_arrays(columns, names=["sensor", "place", "batch", "stored_s"])


def gathered(width: int, batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
    """Yield blocks of one sensor each, from rows or blocks of rows with a sensor, stamps and `width` channels."""
    gathering = SensorBlockBuffer(width)
    for batch in batches:
        yield from gathering.add(gathering.number_sensors(batch.column(0)), batch.columns[1:], seconds_of)
    yield from gathering.rest()


def seconds_of(column: pa.Array) -> Floats:
    """Return stamps in seconds, from timestamps or from numbers in seconds; NaN where missing."""
    if not pa.types.is_timestamp(column.type):
        return numbers_in(column)
    per_second = _PER_SECOND[column.type.unit]
    ticks = column.cast(pa.int64()).fill_null(0).to_numpy()
    if per_second == _PER_SECOND["ns"]:  # too many digits for a double: convert in two parts
        whole, rest = np.divmod(ticks, 1000)
        seconds = whole / _PER_SECOND["us"] + rest / per_second
    else:
        seconds = ticks / per_second
    return np.where(column.is_valid().to_numpy(zero_copy_only=False), seconds, np.nan)


def numbers_in(column: pa.Array) -> Floats:
    """Return a column as float64, NaN where missing."""
    return np.asarray(column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False), np.float64)


def _samples(sensor_numbers: Integers, columns: Sequence[pa.Array], seconds: Seconds) -> tuple[_Samples, Integers]:
    """Return the samples of rows or blocks, and the sensor's number of each block with arrays of unequal lengths."""
    time, *channels = columns
    if not pa.types.is_list(time.type):
        values = np.column_stack([*map(numbers_in, channels)])
        return _Samples(sensor_numbers, seconds(time), values), sensor_numbers[:0]
    lengths, fits = _lengths(time), np.ones(len(time), np.bool_)
    for one in channels:
        fits &= (_lengths(one) == lengths) | ~_valid(one)
    lengths = np.where(fits, lengths, 0)
    values = np.column_stack([_concatenated(one, lengths) for one in channels])
    stamps = seconds(time.filter(pa.array(fits)).flatten())
    return _Samples(np.repeat(sensor_numbers, lengths), stamps, values), sensor_numbers[~fits]


def _valid(column: pa.ListArray) -> Booleans:
    return np.asarray(column.is_valid().to_numpy(zero_copy_only=False), np.bool_)


def _lengths(column: pa.ListArray) -> Integers:
    return np.asarray(column.value_lengths().fill_null(0).to_numpy(zero_copy_only=False), np.int64)


def _concatenated(column: pa.ListArray, lengths: Integers) -> Floats:
    """Return the lists of a column, concatenated (N,), with the given lengths; NaN where a list is missing."""
    kept = _valid(column) & (_lengths(column) == lengths)
    values = numbers_in(column.filter(pa.array(kept)).flatten())
    if kept.all():
        return values
    out = np.full(int(lengths.sum()), np.nan)
    out[np.repeat(kept, lengths)] = values
    return out
