"""Read a CSV file in memory: detect its layout, parse it with pyarrow, and report the row that cannot be parsed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.files.csv.blocks import rows_of_text
from becalm.files.csv.broken_rows import LastLine, parse_error, refuse_strays, spans_lines, with_truncation_notes
from becalm.files.csv.rates import with_rate
from becalm.files.csv.sniffing import Dialect, sniff
from becalm.files.decoding import decode
from becalm.files.rows import MemoryRows
from becalm.files.source import RawTable, TextLayout
from becalm.files.text.cells import (
    COMMA,
    GROUPED,
    MISSING,
    MISSING_CELL,
    NUMBER,
    TIME,
    grouped_error,
    is_text,
    to_numbers,
)
from becalm.files.text.csv_header import unique_names

_EXACT = 1e15  # float64 is exact for whole numbers up to this, and for some larger ones
_LONG_WHOLE = "^[+-]?[0-9]{16,}$"
NUMERIC = (NUMBER, MISSING_CELL)  # kinds of columns that are numbers, as far as the first rows show


def read_csv(path: Path, data: bytes) -> RawTable:
    """Read the bytes of a CSV file, compressed or not.

    Raises
    ------
    InputError
        If the file holds no table or can be read in two ways, or if a row has too many or too few cells.
    """
    text = decode(path, data)
    dialect = sniff(path, text.data)
    last = LastLine(dialect)
    body = b"".join(rows_of_text(last.whole_rows([text.data]), dialect.separator))
    names = unique_names(dialect.header.names)
    table, decimal = _parse(path, body, dialect, names)
    table = table.select(without_padding(dialect, names, [column.null_count == len(table) for column in table.columns]))
    layout = text_layout(text.encoding, text.compression, dialect, decimal)
    units = units_of(dialect, names)
    table = pa.table(table.columns, schema=schema_with_units(table.schema, units))
    raw = RawTable(MemoryRows(table), table.num_rows, "csv", units, layout)
    return with_rate(with_truncation_notes(raw, text.cut, last), dialect.header.rate_hz)


def text_layout(encoding: str, compression: str, dialect: Dialect, decimal: str) -> TextLayout:
    """Return the layout of a text from its encoding, compression, dialect and decimal separator."""
    return TextLayout(
        encoding=encoding,
        compression=compression,
        separator=dialect.separator,
        decimal=decimal,
        header_rows=dialect.header.rows,
        skipped_rows=dialect.header.skipped,
        first_line=dialect.first_line + 1,
    )


def units_of(dialect: Dialect, names: Sequence[str]) -> dict[str, str]:
    """Return the units from the row of units, by column name."""
    return {name: unit for name, unit in zip(names, dialect.header.units, strict=True) if unit}


def schema_with_units(schema: pa.Schema, units: Mapping[str, str]) -> pa.Schema:
    """Return a schema whose columns of numbers hold their units from a row of units, so that outputs hold them."""
    numeric = (field.name for field in schema if not is_text(field.type) and field.name in units)
    for name in numeric:
        at = schema.get_field_index(name)
        schema = schema.set(at, schema.field(at).with_metadata({b"unit": units[name].encode()}))
    return schema


def _parse(path: Path, body: bytes, dialect: Dialect, names: Sequence[str]) -> tuple[pa.Table, str]:
    try:
        table = exact(_arrow(body, dialect, names, column_types(dialect, names)))
    except pa.ArrowInvalid as cause:
        if not is_conversion_error(cause):
            raise parse_error(path, lambda: [body], dialect, str(cause)) from cause
        table = _arrow_text(path, body, dialect, names)
    if spans_lines(table):
        refuse_strays(path, lambda: [body], dialect)
    columns = zip(dialect.kinds, table.columns, strict=True)
    texts = (column for kind, column in columns if kind in NUMERIC and pa.types.is_string(column.type))
    decimal = dialect.decimal or decimal_of_columns(path, texts)
    for position, kind in enumerate(dialect.kinds):
        if kind != TIME and pa.types.is_string(table.schema.field(position).type):
            examined = NumericTypeDetector(kind, decimal)
            examined.add(table.column(position))
            if (found := examined.type) is not None:
                numbers = numbers_of(table.column(position), decimal, found)
                table = table.set_column(position, names[position], numbers)
    return table, decimal


def column_types(dialect: Dialect, names: Sequence[str]) -> dict[str, pa.DataType]:
    """Return the type that pyarrow shall give to each column, judged by the first rows of the file."""
    return {
        name: pa.float64() if kind in NUMERIC else pa.string() for name, kind in zip(names, dialect.kinds, strict=True)
    }


def _arrow(body: bytes, dialect: Dialect, names: Sequence[str], types: dict[str, pa.DataType]) -> pa.Table:
    import pyarrow.csv as arrow_csv

    size = max(1 << 20, len(body) // 16 + 1)
    how = arrow_options(dialect, names, types, newlines_in_cells=b'"' in body, block_bytes=size)
    return arrow_csv.read_csv(pa.BufferReader(body), **how)


def arrow_options(
    dialect: Dialect,
    names: Sequence[str],
    types: dict[str, pa.DataType],
    *,
    newlines_in_cells: bool,
    block_bytes: int,
) -> dict[str, Any]:
    """Return the arguments for pyarrow's CSV reader.

    Parameters
    ----------
    dialect : Dialect
        The layout of the text.
    names : sequence of str
        The names of the columns.
    types : dict of str to pyarrow.DataType
        The types of the columns.
    newlines_in_cells : bool
        Whether cells may contain line ends.
    block_bytes : int
        Number of bytes that are parsed at once.
    """
    import pyarrow.csv as arrow_csv

    return {
        "read_options": arrow_csv.ReadOptions(column_names=list(names), block_size=block_bytes),
        "parse_options": arrow_csv.ParseOptions(
            delimiter=dialect.separator or "\x1f",
            newlines_in_values=newlines_in_cells,
            ignore_empty_lines=dialect.separator != "",
        ),
        "convert_options": arrow_csv.ConvertOptions(
            column_types=types, null_values=list(MISSING), decimal_point=dialect.decimal or "."
        ),
    }


def is_conversion_error(cause: pa.ArrowInvalid) -> bool:
    """Return whether pyarrow failed because a cell does not have the type of its column."""
    return "conversion error" in str(cause)


def exact(table: pa.Table) -> pa.Table:
    """Return a table unless float64 may have rounded its whole numbers, such as nanoseconds since 1970.

    Raises
    ------
    pyarrow.ArrowInvalid
        The error of a failed conversion, so that the caller reads the columns as text and converts them itself.
    """
    for column in table.columns:
        if pa.types.is_floating(column.type):
            ends = pc.min_max(column)
            if max(-(ends["min"].as_py() or 0.0), ends["max"].as_py() or 0.0) >= _EXACT:
                sizes = np.abs(column.to_numpy())
                if np.any((sizes >= _EXACT) & np.isfinite(sizes)):
                    raise pa.ArrowInvalid("conversion error: long whole numbers")
    return table


def _arrow_text(path: Path, body: bytes, dialect: Dialect, names: Sequence[str]) -> pa.Table:
    try:
        return _arrow(body, dialect, names, dict.fromkeys(names, pa.string()))
    except pa.ArrowInvalid as cause:
        raise parse_error(path, lambda: [body], dialect, str(cause)) from cause


def decimal_of_columns(path: Path, columns: Iterable[pa.ChunkedArray]) -> str:
    """Return the decimal separator of columns of text whose first rows have no fractions.

    Raises
    ------
    InputError
        If all commas may as well separate thousands.
    """
    grouped = ""
    for column in columns:
        fractions = pc.and_(pc.match_substring(column, ","), pc.match_substring_regex(column, COMMA))
        cells = column.filter(fractions)
        if not pc.all(pc.match_substring_regex(cells, GROUPED), min_count=0).as_py():
            return ","
        grouped = grouped or (str(cells[0]) if len(cells) else "")
    if grouped:
        raise grouped_error(path, grouped)
    return "."


class NumericTypeDetector:
    """Examine a column of text block by block, and find its numeric type.

    Parameters
    ----------
    kind : str
        The kind of the column in the first rows of the file.
    decimal : str
        The decimal separator, "." or ",".
    """

    def __init__(self, kind: str, decimal: str) -> None:
        self._kind, self._decimal = kind, decimal
        self.possible = True
        self._has_numbers = False
        self._all_integers = True
        self._rounded = False  # whether float64 would round a whole number
        self._largest = 0.0

    def add(self, text: pa.ChunkedArray) -> None:
        """Examine the next cells."""
        if not self.possible:
            return
        numbers, bad = to_numbers(text.combine_chunks(), self._decimal)
        self.possible = not bad.any()
        self._has_numbers = self._has_numbers or numbers.null_count < len(numbers)
        values = np.asarray(numbers.fill_null(0.0))
        finite = np.where(np.isfinite(values), values, 0.0)
        self._largest = max(self._largest, float(np.abs(finite).max(initial=0.0)))
        self._rounded = self._rounded or (self._largest >= _EXACT and _has_rounded(text))
        self._all_integers = (
            self._all_integers and bool(np.all(finite == np.round(finite))) and _to_int64(text, numbers) is not None
        )

    @property
    def type(self) -> pa.DataType | None:
        """Return int64 for whole numbers with 16 digits or more, float64 for other numbers, None for text.

        Whole numbers that neither type can hold, such as numbers of 20 digits, stay text.
        """
        if not self.possible or not (self._has_numbers or self._kind in NUMERIC):
            return None
        if self._all_integers and self._largest >= _EXACT:
            return pa.int64()
        return None if self._rounded else pa.float64()


def numbers_of(text: pa.ChunkedArray, decimal: str, kind: pa.DataType) -> pa.Array:
    """Convert a column of text to numbers of type `kind`."""
    numbers = to_numbers(text.combine_chunks(), decimal)[0]
    return _to_int64(text, numbers) if pa.types.is_integer(kind) else numbers


def _without_plus(text: pa.ChunkedArray) -> pa.Array:
    return pc.replace_substring_regex(pc.utf8_trim_whitespace(text.combine_chunks()), r"^\+", "")


def _has_rounded(text: pa.ChunkedArray) -> bool:
    """Return whether float64 would round a whole number among cells."""
    trimmed = _without_plus(text)
    long = trimmed.filter(pc.match_substring_regex(trimmed, _LONG_WHOLE)).to_pylist()
    return any(int(cell) != float(cell) for cell in long)


def _to_int64(text: pa.ChunkedArray, numbers: pa.Array) -> pa.Array | None:
    """Convert text to int64 without rounding; return None if some cells are not whole numbers."""
    trimmed = _without_plus(text)
    try:
        return pc.if_else(pc.is_valid(numbers), trimmed, pa.scalar(None, pa.string())).cast(pa.int64())
    except pa.ArrowInvalid:
        return None


def without_padding(dialect: Dialect, names: Sequence[str], empty: Sequence[bool]) -> list[str]:
    """Return the names without empty, unnamed columns at the right, which trailing separators create."""
    last = len(names)
    while last > 1 and not dialect.header.names[last - 1] and empty[last - 1]:
        last -= 1
    return list(names[:last])
