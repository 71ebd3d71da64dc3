"""Read the Parquet files of a lake in tasks. Spark only finds the files and sends their paths; becalm reads the rows.

Therefore a file that cannot be read is reported and does not stop the stream. Also, units and nanoseconds are
preserved; Spark has no type for nanoseconds.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats, Integers
from becalm.errors import BecalmError, InputError, UsageError
from becalm.files.decoding import Original
from becalm.files.lake.listing import is_hidden
from becalm.files.parquet import PARQUET_ENDINGS, ParquetRows, units_of
from becalm.fleet.names import values_in
from becalm.fleet.stream.blocks import UnreadableInput
from becalm.fleet.stream.columns import StreamSchema, is_reading, shape_of
from becalm.fleet.stream.gathering import Seconds, SensorBlockBuffer, numbers_in, seconds_of
from becalm.fleet.stream.plan import SensorPlan
from becalm.live.lines.cells import NumberStamps, stamp_reader

_ROWS = 1 << 16  # rows that are read at once
# Spark's names of types, by Arrow's names.
_KINDS = {"float": "float", "halffloat": "float", "int8": "int", "int16": "int", "int32": "int", "int64": "bigint"}
_KINDS |= {"uint8": "int", "uint16": "int", "uint32": "bigint", "uint64": "bigint"}
# Errors of the machine or its network, not of the file; a retry may help.
_TRANSIENT_ERRNOS = {
    errno.EIO,
    errno.ESTALE,
    errno.ETIMEDOUT,
    errno.EAGAIN,
    errno.EBUSY,
    errno.EMFILE,
    errno.ENFILE,
    errno.ENOMEM,
}
_TRANSIENT_ERRNOS |= {errno.ENOTCONN, errno.ECONNRESET}
_TRANSIENT_ERRNOS |= {errno.EHOSTDOWN, errno.EHOSTUNREACH, errno.ENETDOWN, errno.ENETUNREACH}
_MOST_TRIED = 20  # number of files to try when a stream starts; one of them must be readable


def lake_shape(lake: str, plan: SensorPlan) -> StreamSchema:
    """Return the columns of a lake's rows, from one of its files.

    Raises
    ------
    BecalmError
        If no file can be read, or if the files lack a column or have a type that cannot be used.
    """
    if not Path(lake).is_dir():
        raise InputError(f"{lake} is not a folder; give the folder that receives the Parquet files.")
    why: BecalmError | None = None
    for _, path in zip(range(_MOST_TRIED), _files(Path(lake)), strict=False):
        try:
            schema = ParquetRows(path, Original(path)).schema
        except InputError as cause:
            why = why or cause
            continue
        columns = [(field.name, _kind(field.type)) for field in schema]
        if plan.key not in schema.names and _key_in(Path(lake), path, plan.key) is not None:
            columns.append((plan.key, "string"))
        in_seconds = [(name, _stamp_kind(kind) if name == plan.time else kind) for name, kind in columns]
        try:
            return shape_of(in_seconds, plan.key, plan.time, plan.channels)
        except UsageError as cause:  # the file may not belong to the stream, so try the next one
            why = cause if why is None else why
    raise why or InputError(
        f"{lake} holds no Parquet file yet; a stream needs at least one at its start, to find the columns."
    )


def read_files(lake: str, shape: StreamSchema, batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
    """Yield blocks of one sensor each, with the columns of `columns.BATCH`, from files.

    The first column of `batches` contains the paths of the files.

    Raises
    ------
    InputError
        If a file cannot be read now because of the machine, such as its disk; Spark then repeats the read.
    """
    gathering = SensorBlockBuffer(len(shape.channels))
    for batch in batches:
        for uri in batch.column(0).to_pylist():
            path = _path_of(uri)
            sensor = _key_in(Path(lake), path, shape.key)
            try:
                for piece in _pieces(path, shape, gathering, sensor):
                    yield from gathering.add(*piece)
            except Exception as cause:  # damage of any kind
                if _is_transient(cause):
                    raise InputError(
                        f"{path} cannot be read now ({cause}); if it still cannot after a restart of the stream, move"
                        " the file away."
                    ) from cause
                says = str(cause) if isinstance(cause, BecalmError) else f"{path}: {type(cause).__name__}: {cause}."
                gathering.add_loss(sensor or "", _left_out(says))
    yield from gathering.rest()


def _is_transient(cause: BaseException | None) -> bool:
    """Return whether an error comes from the machine, such as its disk, network or memory, so that a retry may help.

    Arrow's own out-of-memory error does not count, because a damaged file with an impossible size causes it too.
    """
    while cause is not None:
        if type(cause) is MemoryError or (isinstance(cause, OSError) and cause.errno in _TRANSIENT_ERRNOS):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def _left_out(why: str) -> UnreadableInput:
    return UnreadableInput(
        None, f"{why} The rest of its rows was left out; repair the file and add it under another name."
    )


class _Piece(NamedTuple):
    """Some rows of a file: the arguments of `SensorBlockBuffer.add`."""

    sensor_numbers: Integers
    columns: list[pa.Array]
    seconds: Seconds


class _Clock:
    """A converter of stamps to seconds. The unit of numbers comes from metadata, the column's name or their size."""

    def __init__(self, name: str, unit: str) -> None:
        self._name, self._unit = name, unit
        self._second = 0.0  # ticks per second; 0 before the first stamp

    def __call__(self, column: pa.Array) -> Floats:
        if pa.types.is_timestamp(column.type):
            return seconds_of(column)
        numbers = numbers_in(column)
        finite = numbers[np.isfinite(numbers)]
        if not self._second and len(finite):
            reader = stamp_reader(self._name, self._unit, float(np.median(finite)))  # robust against wrong stamps
            assert isinstance(reader, NumberStamps)  # because the argument is a number
            self._second = reader.per_second / reader.factor
        return numbers / (self._second or 1.0)


def _pieces(path: Path, shape: StreamSchema, gathering: SensorBlockBuffer, sensor: str | None) -> Iterator[_Piece]:
    """Yield a file's rows in pieces; raise BecalmError if the file cannot be read, or has other columns."""
    rows = ParquetRows(path, Original(path))
    channels = [name for name in shape.channels if name in rows.schema.names]
    _refuse_other(path, rows.schema, shape, channels, has_key=sensor is not None)
    stored_units = units_of(rows.schema)
    units = tuple(stored_units.get(name, "") for name in shape.channels)
    clock = _Clock(shape.time, stored_units.get(shape.time, ""))
    keyed = [shape.key] if sensor is None else []
    for table in rows.blocks([*keyed, shape.time, *channels], _ROWS):
        columns = {name: table.column(name).combine_chunks() for name in table.column_names}
        names = columns[shape.key].cast(pa.string()) if sensor is None else pa.repeat(sensor, len(table))
        sensor_numbers = gathering.number_sensors(names, units)
        missing = pa.nulls(len(table), pa.list_(pa.float64()) if shape.in_blocks else pa.float64())
        channel_columns = [columns.get(name, missing) for name in shape.channels]
        yield _Piece(sensor_numbers, [columns[shape.time], *channel_columns], clock)


def _refuse_other(path: Path, schema: pa.Schema, shape: StreamSchema, channels: list[str], *, has_key: bool) -> None:
    """Raise an error if a file lacks columns of the stream, has other types, or does not name its sensors."""
    if not has_key and shape.key not in schema.names:
        raise InputError(
            f"{path} has neither a column {shape.key!r} nor a folder like {shape.key}=17 to name its sensor."
        )
    if shape.time not in schema.names or not channels:
        wanted = ", ".join(map(repr, shape.channels))
        present = ", ".join(map(repr, schema.names))
        raise InputError(f"{path} needs {shape.time!r} and one of {wanted}, but has {present}.")
    for name in (shape.time, *channels):
        kind = _kind(schema.field(name).type)
        is_stamp = name == shape.time and kind == ("array<timestamp>" if shape.in_blocks else "timestamp")
        is_known = is_stamp or is_reading(kind, in_blocks=shape.in_blocks)
        if not is_known:
            what = "arrays" if shape.in_blocks else "numbers"
            raise InputError(f"{path} has {kind} in its column {name!r}, but other files have {what}.")


def _files(lake: Path) -> Iterator[Path]:
    """Yield a lake's Parquet files in the order of the file system, without hidden ones."""
    for path in lake.rglob("*"):
        if path.name.lower().endswith(PARQUET_ENDINGS) and not any(map(is_hidden, path.relative_to(lake).parts)):
            yield path


def _path_of(uri: str) -> Path:
    """Return the path of a file that Spark names: `file:/lake/a`, `file:///lake/a` or, on Windows, `file:///C:/lake/a`."""
    return Path(re.sub(r"^/(?=[A-Za-z]:)", "", uri.removeprefix("file://").removeprefix("file:")))


def _key_in(lake: Path, path: Path, key: str) -> str | None:
    """Return the value of a key in a path, such as "17" of `sensor=17`; "" for a null, None if the key is absent."""
    whole, path = lake.absolute(), path.absolute()
    values = values_in((path.relative_to(whole) if path.is_relative_to(whole) else path).parent)
    return (values[key] or "") if key in values else None


def _stamp_kind(kind: str) -> str:
    """Return the output type of stamps: numbers in any unit become seconds as double."""
    inner = kind.removeprefix("array<").removesuffix(">")
    return kind.replace(inner, "double") if is_reading(inner, in_blocks=False) else kind


def _kind(kind: pa.DataType) -> str:
    """Return Spark's name of an Arrow type."""
    if pa.types.is_list(kind):
        return f"array<{_kind(kind.value_type)}>"
    if pa.types.is_timestamp(kind):
        return "timestamp"
    return str(kind) if pa.types.is_decimal(kind) else _KINDS.get(str(kind), str(kind))
