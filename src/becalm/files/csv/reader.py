"""Read a CSV file in memory: detect its layout, parse it with pyarrow, and name the cell that cannot be parsed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.files.csv.blocks import rows_of_text
from becalm.files.csv.broken_rows import LastLine, ragged, refuse_strays, spans_lines, with_truncation_notes
from becalm.files.csv.rates import with_rate
from becalm.files.csv.sniffing import Dialect, sniff
from becalm.files.decoding import decode
from becalm.files.rows import MemoryRows
from becalm.files.source import RawTable, TextLayout
from becalm.files.text.cells import COMMA, MISSING, MISSING_CELL, NUMBER, TIME, to_numbers
from becalm.files.text.csv_header import unique_names

_EXACT_DIGITS = 15  # whole numbers of up to this many digits are exact in float64


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
    raw = RawTable(MemoryRows(table), table.num_rows, "csv", units_of(dialect, names), layout)
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


def _parse(path: Path, body: bytes, dialect: Dialect, names: Sequence[str]) -> tuple[pa.Table, str]:
    try:
        refuse_long_numbers(body, dialect)
        table = _arrow(body, dialect, names, column_types(dialect, names))
    except pa.ArrowInvalid as cause:
        if not is_conversion(cause):
            raise ragged(path, lambda: [body], dialect, str(cause)) from cause
        table = _arrow_text(path, body, dialect, names)
    if spans_lines(table):
        refuse_strays(path, lambda: [body], dialect)
    decimal = dialect.decimal or _decimal_of(table, dialect)
    for position, kind in enumerate(dialect.kinds):
        if kind != TIME and pa.types.is_string(table.schema.field(position).type):
            examined = TextNumbers(kind, decimal)
            examined.add(table.column(position))
            if (to := examined.type) is not None:
                table = table.set_column(position, names[position], numbers_of(table.column(position), decimal, to))
    return table, decimal


def column_types(dialect: Dialect, names: Sequence[str]) -> dict[str, pa.DataType]:
    """Return the type that pyarrow shall give to each column, judged by the first rows of the file."""
    return {
        name: pa.float64() if kind in (NUMBER, MISSING_CELL) else pa.string()
        for name, kind in zip(names, dialect.kinds, strict=True)
    }


def _arrow(body: bytes, dialect: Dialect, names: Sequence[str], types: dict[str, pa.DataType]) -> pa.Table:
    import pyarrow.csv as arrow_csv

    size = max(1 << 20, len(body) // 16 + 1)
    how = arrow_options(dialect, names, types, (b'"' in body, size))
    return arrow_csv.read_csv(pa.BufferReader(body), **how)


def arrow_options(
    dialect: Dialect, names: Sequence[str], types: dict[str, pa.DataType], block: tuple[bool, int]
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
    block : (bool, int)
        Whether cells may contain line ends; how many bytes are parsed at once.
    """
    import pyarrow.csv as arrow_csv

    return {
        "read_options": arrow_csv.ReadOptions(column_names=list(names), block_size=block[1]),
        "parse_options": arrow_csv.ParseOptions(
            delimiter=dialect.separator or "\x1f",
            newlines_in_values=block[0],
            ignore_empty_lines=dialect.separator != "",
        ),
        "convert_options": arrow_csv.ConvertOptions(
            column_types=types, null_values=list(MISSING), decimal_point=dialect.decimal or "."
        ),
    }


def is_conversion(cause: pa.ArrowInvalid) -> bool:
    """Return whether pyarrow failed because a cell does not have the type of its column."""
    return "conversion error" in str(cause)


def refuse_long_numbers(body: bytes, dialect: Dialect) -> None:
    """Refuse to read as float64 whole numbers that are too long for it, such as nanoseconds since 1970.

    Only the first 4096 bytes are searched.

    Raises
    ------
    pyarrow.ArrowInvalid
        The error of a failed conversion, so that the caller reads the columns as text and converts them itself.
    """
    fraction = b"." if dialect.separator == "," else b".,"  # digits after one of these are not a whole number
    long = rb"(?<![%b\d])\d{%d,}(?![.\d])" % (fraction, _EXACT_DIGITS + 1)
    if {NUMBER, MISSING_CELL} & set(dialect.kinds) and re.search(long, body[:4096]):
        raise pa.ArrowInvalid("conversion error: long whole numbers")


def _arrow_text(path: Path, body: bytes, dialect: Dialect, names: Sequence[str]) -> pa.Table:
    try:
        return _arrow(body, dialect, names, dict.fromkeys(names, pa.string()))
    except pa.ArrowInvalid as cause:
        raise ragged(path, lambda: [body], dialect, str(cause)) from cause


def _decimal_of(table: pa.Table, dialect: Dialect) -> str:
    """Return the decimal separator of all rows; used if the first rows have no fractions."""
    for position, kind in enumerate(dialect.kinds):
        column = table.column(position)
        if kind == NUMBER and pa.types.is_string(column.type) and has_decimal_commas(column):
            return ","
    return "."


def has_decimal_commas(column: pa.ChunkedArray) -> bool:
    """Return whether a column of text has numbers with a decimal comma."""
    fractions = pc.and_(pc.match_substring(column, ","), pc.match_substring_regex(column, COMMA))
    return bool(pc.any(fractions).as_py())


class TextNumbers:
    """A test, block by block, whether a column of text holds numbers.

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
        self._some = False
        self._whole = True
        self._largest = 0.0

    def add(self, text: pa.ChunkedArray) -> None:
        """Examine the next cells."""
        if not self.possible:
            return
        numbers, bad = to_numbers(text.combine_chunks(), self._decimal)
        self.possible = not bad.any()
        self._some = self._some or numbers.null_count < len(numbers)
        values = np.asarray(numbers.fill_null(0.0))
        finite = np.where(np.isfinite(values), values, 0.0)
        self._largest = max(self._largest, float(np.abs(finite).max(initial=0.0)))
        self._whole = self._whole and bool(np.all(finite == np.round(finite))) and _whole(text, numbers) is not None

    @property
    def type(self) -> pa.DataType | None:
        """Return int64 for whole numbers with 16 digits or more, float64 for other numbers, None for text."""
        if not self.possible or not (self._some or self._kind in (NUMBER, MISSING_CELL)):
            return None
        return pa.int64() if self._whole and self._largest >= 10.0**_EXACT_DIGITS else pa.float64()


def numbers_of(text: pa.ChunkedArray, decimal: str, kind: pa.DataType) -> pa.Array:
    """Convert a column of text to numbers of type `kind`."""
    numbers = to_numbers(text.combine_chunks(), decimal)[0]
    return _whole(text, numbers) if pa.types.is_integer(kind) else numbers


def _whole(text: pa.ChunkedArray, numbers: pa.Array) -> pa.Array | None:
    """Convert text to int64 without rounding; return None if some cells are not whole numbers."""
    trimmed = pc.utf8_trim_whitespace(text.combine_chunks())
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
