"""Parquet files of a lake, read by tasks: the engine finds them and moves their paths, and none of their rows.

So a file that cannot be read is told and stops nobody; units are known, and nanoseconds, which Spark has no type for.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats, Integers
from becalm.errors import BecalmError, InputError, UsageError
from becalm.files.identity import Original
from becalm.files.lake.listing import ENDINGS, is_hidden
from becalm.files.parquet import ParquetRows, units_of
from becalm.fleet.names import values_in
from becalm.fleet.stream.blocks import Garbled
from becalm.fleet.stream.gathering import Seconds, SensorBlockBuffer, numbers_in, seconds_of
from becalm.fleet.stream.plan import SensorPlan
from becalm.fleet.stream.shape import StreamSchema, is_reading, shape_of
from becalm.live.lines.cells import NumberStamps, stamp_reader

_ROWS = 1 << 16
_KINDS = {"float": "float", "halffloat": "float", "int8": "int", "int16": "int", "int32": "int", "int64": "bigint"}
_KINDS |= {"uint8": "int", "uint16": "int", "uint32": "bigint", "uint64": "bigint"}
_PASSING = {
    errno.EIO,
    errno.ESTALE,
    errno.ETIMEDOUT,
    errno.EAGAIN,
    errno.EBUSY,
    errno.EMFILE,
    errno.ENFILE,
    errno.ENOMEM,
}
_PASSING |= {errno.ENOTCONN, errno.ECONNRESET, errno.EHOSTDOWN, errno.EHOSTUNREACH, errno.ENETDOWN, errno.ENETUNREACH}
_LOOKED_AT = 20  # files, of which one must be readable, when a stream begins


def lake_shape(lake: str, plan: SensorPlan) -> StreamSchema:
    """Find the shape of a lake's rows in one of its files.

    Raises
    ------
    BecalmError
        If it holds none that can be read, or a column is not there, or of a type that it cannot have.
    """
    if not Path(lake).is_dir():
        raise InputError(f"{lake} is no folder; give one that Parquet files come into.")
    why: BecalmError | None = None
    for _, path in zip(range(_LOOKED_AT), _files(Path(lake)), strict=False):
        try:
            schema = ParquetRows(path, Original(path)).schema
        except InputError as cause:
            why = why or cause
            continue
        columns = [(field.name, _kind(field.type)) for field in schema]
        if plan.key not in schema.names and _key_in(Path(lake), path, plan.key) is not None:
            columns.append((plan.key, "string"))
        told = [(name, _as_told(kind) if name == plan.time else kind) for name, kind in columns]
        try:
            return shape_of(told, plan.key, plan.time, plan.channels)
        except UsageError as cause:  # of a file that is none of the stream's
            why = cause if why is None else why
    raise why or InputError(
        f"{lake} holds no Parquet file yet; a stream begins where there is one, which tells its columns."
    )


def read_files(lake: str, shape: StreamSchema, batches: Iterator[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
    """Return blocks of one sensor each, as `shape.BATCH`, of the rows in files; the first column has their paths.

    Raises
    ------
    InputError
        If the machine, and not the file, is why it cannot be read now: so that the engine reads it again.
    """
    gathering = SensorBlockBuffer(len(shape.channels))
    for batch in batches:
        for told in batch.column(0).to_pylist():
            path = Path(told.removeprefix("file://").removeprefix("file:"))
            sensor = _key_in(Path(lake), path, shape.key)
            try:
                for piece in _pieces(path, shape, gathering, sensor):
                    yield from gathering.add(*piece)
            except Exception as cause:  # also rubbish of a kind that nobody has thought of
                if _passes(cause):
                    raise InputError(
                        f"{path} cannot be read now ({cause}); if that stays so when the stream is begun again, move"
                        " the file away."
                    ) from cause
                says = str(cause) if isinstance(cause, BecalmError) else f"{path}: {type(cause).__name__}: {cause}."
                gathering.garble(sensor or "", _left_out(says))
    yield from gathering.rest()


def _passes(cause: BaseException | None) -> bool:
    """Whether something went wrong with the machine: its disks, its network, its memory.

    Arrow's own want of memory is of a damaged file, which claims to be as large as none.
    """
    while cause is not None:
        if type(cause) is MemoryError or (isinstance(cause, OSError) and cause.errno in _PASSING):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def _left_out(why: str) -> Garbled:
    return Garbled(
        None, f"{why} The rest of its rows was left out; once it is mended, put it there under another name."
    )


class _Piece(NamedTuple):
    """Some rows of a file, as `SensorBlockBuffer.add` takes them."""

    whose: Integers
    columns: list[pa.Array]
    seconds: Seconds


class _Clock:
    """Reads a column of stamps in seconds; numbers by their unit, the column's name or their size."""

    def __init__(self, name: str, unit: str) -> None:
        self._name, self._unit = name, unit
        self._second = 0.0  # how many make one; 0 as long as no stamp came

    def __call__(self, column: pa.Array) -> Floats:
        if pa.types.is_timestamp(column.type):
            return seconds_of(column)
        numbers = numbers_in(column)
        known = numbers[np.isfinite(numbers)]
        if not self._second and len(known):
            reader = stamp_reader(self._name, self._unit, float(np.median(known)))  # one odd stamp tells nothing
            assert isinstance(reader, NumberStamps)  # of a number
            self._second = reader.per_second / reader.factor
        return numbers / (self._second or 1.0)


def _pieces(path: Path, shape: StreamSchema, gathering: SensorBlockBuffer, sensor: str | None) -> Iterator[_Piece]:
    """Read a file, some rows at a time; BecalmError if it cannot be read, or has other columns."""
    rows = ParquetRows(path, Original(path))
    channels = [name for name in shape.channels if name in rows.schema.names]
    _refuse_other(path, rows.schema, shape, channels, has_key=sensor is not None)
    known = units_of(rows.schema)
    units = tuple(known.get(name, "") for name in shape.channels)
    clock = _Clock(shape.time, known.get(shape.time, ""))
    keyed = [shape.key] if sensor is None else []
    for table in rows.blocks([*keyed, shape.time, *channels], _ROWS):
        columns = {name: table.column(name).combine_chunks() for name in table.column_names}
        names = columns[shape.key].cast(pa.string()) if sensor is None else pa.repeat(sensor, len(table))
        whose = gathering.whose(names, units)
        missing = pa.nulls(len(table), pa.list_(pa.float64()) if shape.in_blocks else pa.float64())
        yield _Piece(whose, [columns[shape.time], *(columns.get(name, missing) for name in shape.channels)], clock)


def _refuse_other(path: Path, schema: pa.Schema, shape: StreamSchema, channels: list[str], *, has_key: bool) -> None:
    """Refuse a file whose columns are not those of the stream, or that does not tell whose its rows are."""
    if not has_key and shape.key not in schema.names:
        raise InputError(f"{path} has no column {shape.key!r}, nor a folder as {shape.key}=17, that tells its sensor.")
    if shape.time not in schema.names or not channels:
        wanted = ", ".join(map(repr, shape.channels))
        there = ", ".join(map(repr, schema.names))
        raise InputError(f"{path} needs {shape.time!r} and one of {wanted}, and has {there}.")
    for name in (shape.time, *channels):
        kind = _kind(schema.field(name).type)
        is_stamp = name == shape.time and kind == ("array<timestamp>" if shape.in_blocks else "timestamp")
        is_known = is_stamp or is_reading(kind, in_blocks=shape.in_blocks)
        if not is_known:
            what = "arrays" if shape.in_blocks else "numbers"
            raise InputError(f"{path} has {kind} in its column {name!r}, where others have {what}.")


def _files(lake: Path) -> Iterator[Path]:
    """List a lake's files as they are found, but for those whose names say that they are no data."""
    for path in lake.rglob("*"):
        if path.name.lower().endswith(ENDINGS) and not any(map(is_hidden, path.relative_to(lake).parts)):
            yield path


def _key_in(lake: Path, path: Path, key: str) -> str | None:
    """Return what a path's folders in a lake tell of a key, as `sensor=17`; "" of nobody, None where they do not."""
    whole, path = lake.absolute(), path.absolute()
    told = values_in((path.relative_to(whole) if path.is_relative_to(whole) else path).parent)
    return (told[key] or "") if key in told else None


def _as_told(kind: str) -> str:
    """Return in which type stamps are told: numbers, whatever they count, in seconds."""
    inner = kind.removeprefix("array<").removesuffix(">")
    return kind.replace(inner, "double") if is_reading(inner, in_blocks=False) else kind


def _kind(kind: pa.DataType) -> str:
    """Return what Spark calls a type."""
    if pa.types.is_list(kind):
        return f"array<{_kind(kind.value_type)}>"
    if pa.types.is_timestamp(kind):
        return "timestamp"
    return str(kind) if pa.types.is_decimal(kind) else _KINDS.get(str(kind), str(kind))
