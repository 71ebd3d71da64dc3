"""Convert columns of a table to NumPy arrays, for formats that store arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from becalm.errors import OutputError

_BYTES = (
    pa.types.is_binary,
    pa.types.is_large_binary,
    pa.types.is_fixed_size_binary,
    pa.types.is_binary_view,
)


def refuse_strange_types(schema: pa.Schema, form: str) -> None:
    """Refuse nested and binary columns, which array formats cannot store.

    Parameters
    ----------
    schema : pyarrow.Schema
        The schema of the table.
    form : str
        The name of the output format, for the message.

    Raises
    ------
    OutputError
        If there is such a column.
    """
    for field in schema:
        if pa.types.is_nested(field.type) or any(is_bytes(field.type) for is_bytes in _BYTES):
            raise OutputError(
                f"Column {field.name!r} holds {field.type}, which {form} cannot hold; write .parquet instead."
            )


def unit_of_field(field: pa.Field) -> str:
    """Return the unit of a column, "" if it has none; for a duration, the unit in which Arrow counts it."""
    if pa.types.is_duration(field.type):
        return str(field.type.unit)
    unit: bytes = (field.metadata or {}).get(b"unit", b"")
    return unit.decode("utf-8", "replace")


def metadata_of(schema: pa.Schema) -> Mapping[str, str]:
    """Return a table's metadata as text, without the schema that Arrow stores there."""
    return {key.decode("utf-8", "replace"): text.decode("utf-8", "replace") for key, text in _items(schema)}


def _items(schema: pa.Schema) -> list[tuple[bytes, bytes]]:
    return [(key, text) for key, text in (schema.metadata or {}).items() if key != b"ARROW:schema"]


def is_text(kind: pa.DataType) -> bool:
    """Return whether columns of a type are written as text: words, dates, times of day."""
    return not (
        pa.types.is_integer(kind)
        or pa.types.is_floating(kind)
        or pa.types.is_boolean(kind)
        or pa.types.is_decimal(kind)
        or pa.types.is_duration(kind)
        or pa.types.is_null(kind)
    )


def texts_of(column: pa.ChunkedArray) -> NDArray[np.object_]:
    """Return a column of text, dates or times of day as str, (N,), "" where a cell is missing."""
    text = pc.fill_null(column.cast(pa.string()), "")
    return np.asarray(text.to_numpy(), object)


def numbers_of(column: pa.ChunkedArray) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return the numbers or flags of a column, (N,), and a mask (N,) of missing cells.

    A missing cell is NaN in a column of floats, False among flags and 0 among whole numbers. A NaN of the column
    itself does not count as missing.
    """
    kind = column.type
    if pa.types.is_decimal(kind) or pa.types.is_null(kind):
        column = column.cast(pa.float64())
    elif pa.types.is_float16(kind):
        column = column.cast(pa.float32())
    elif pa.types.is_duration(kind):
        column = column.cast(pa.int64())
    missing = np.asarray(column.is_null().to_numpy())
    if missing.any():
        zero = np.nan if pa.types.is_floating(column.type) else False if pa.types.is_boolean(column.type) else 0
        column = pc.fill_null(column, pa.scalar(zero, column.type))
    return np.asarray(column.to_numpy()), missing


class FillValues:
    """The values that mark missing cells in columns of whole numbers, for formats that cannot store missing cells."""

    def __init__(self) -> None:
        self._marked: set[str] = set()  # names of columns with missing cells
        self._holding: set[str] = set()  # names of columns in which a present cell has the marking value

    def filled(self, name: str, values: NDArray[Any], missing: NDArray[np.bool_]) -> NDArray[Any]:
        """Return whole numbers (N,) with the missing ones replaced by the value of `fill_value`.

        Raises
        ------
        OutputError
            If a column has missing cells, and a present cell has the marking value.
        """
        fill = fill_value(values.dtype)
        if missing.any():
            self._marked.add(name)
        if (values[~missing] == fill).any():
            self._holding.add(name)
        if name in self._marked & self._holding:
            raise OutputError(
                f"{name!r} has missing cells and the number {fill}, which would stand for them; write .parquet or .csv"
                " instead, or cast that column to a wider type."
            )
        return np.where(missing, fill, values)

    def of(self, name: str, dtype: np.dtype[Any]) -> Any:
        """Return the value that marks missing cells of a column; None if no cell was missing so far."""
        return fill_value(dtype) if name in self._marked else None


def fill_value(dtype: np.dtype[Any]) -> Any:
    """Return the whole number that marks a missing cell: the largest unsigned, or the smallest signed one."""
    limits = np.iinfo(dtype)
    return dtype.type(limits.max if dtype.kind == "u" else limits.min)


def whole_column(name: str, column: pa.ChunkedArray) -> NDArray[Any]:
    """Return a column as one array, (N,): text as "U", whole numbers and flags with missing cells as float64.

    Raises
    ------
    OutputError
        If float64 cannot hold the whole numbers beside missing cells.
    """
    if is_text(column.type):
        texts = texts_of(column)
        return texts.astype(f"U{max((len(text) for text in texts), default=0) or 1}")
    values, missing = numbers_of(column)
    if missing.any() and values.dtype.kind != "f":
        if values.dtype.kind in "iu" and (values.astype(np.float64).astype(values.dtype) != values).any():
            raise OutputError(
                f"Column {name!r} has missing cells and whole numbers that float64 rounds; write .h5, .parquet or .csv"
                " instead."
            )
        return np.where(missing, np.nan, values.astype(np.float64))
    return values
