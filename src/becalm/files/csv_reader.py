"""CSV: the text once sniffed, its numbers are parsed by pyarrow; a cell that fails is named."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.errors import InputError
from becalm.files.cells import COMMA, GONE, MISSING, NUMBER, TIME, to_numbers
from becalm.files.csv_sniffing import Dialect, sniff
from becalm.files.source import RawTable, TextLayout
from becalm.files.text import decode

_EXACT_DIGITS = 15  # float64 keeps whole numbers of this many digits


def read_csv(path: Path, data: bytes) -> RawTable:
    """Read the bytes of a CSV file, compressed or not.

    Raises
    ------
    InputError
        If there is no table in it, it can be read in two ways, or a row has too many or too few cells.
    """
    text = decode(path, data)
    dialect = sniff(path, text.data)
    body = _body(text.data, dialect)
    names = unique_names(dialect.header.names)
    table, decimal = _parse(path, body, dialect, names)
    table = _without_padding(table, dialect)
    layout = TextLayout(
        encoding=text.encoding,
        compression=text.compression,
        separator=dialect.separator,
        decimal=decimal,
        header_rows=dialect.header.rows,
        skipped_rows=dialect.header.skipped,
        first_line=dialect.first_line + 1,
    )
    units = {name: unit for name, unit in zip(names, dialect.header.units, strict=True) if unit}
    return RawTable(table, "csv", units, layout)


def unique_names(names: Sequence[str]) -> tuple[str, ...]:
    """Give every column a name of its own: `column_3` where there is none, `x_2` for a second `x`."""
    taken = set(names)
    used: set[str] = set()
    out = []
    for number, name in enumerate(names, start=1):
        own = name or f"column_{number}"
        base, copy = own, 1
        while own in used or (own != name and own in taken):
            copy += 1
            own = f"{base}_{copy}"
        used.add(own)
        out.append(own)
    return tuple(out)


def _body(data: bytes, dialect: Dialect) -> bytes:
    """Return the rows of data, without blank lines at the end."""
    body = data[dialect.offset :].rstrip(b" \r\n\x1a" if dialect.separator == "\t" else b" \t\r\n\x1a")
    if dialect.separator == " ":
        body = re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", body)
        body = re.sub(rb"[ \t]+", b" ", body)
    return body + b"\n"


def _parse(path: Path, body: bytes, dialect: Dialect, names: Sequence[str]) -> tuple[pa.Table, str]:
    types = {name: _type(kind) for name, kind in zip(names, dialect.kinds, strict=True)}
    try:
        table = _arrow(body, dialect, names, types)
    except pa.ArrowInvalid as cause:
        if "conversion error" not in str(cause):
            raise _ragged(path, body, dialect, str(cause)) from cause
        table = _arrow_text(path, body, dialect, names)
    decimal = dialect.decimal or _decimal_of(table, dialect)
    for position, kind in enumerate(dialect.kinds):
        if kind != TIME and pa.types.is_string(table.schema.field(position).type):
            numbers, bad = to_numbers(table.column(position).combine_chunks(), decimal)
            if not bad.any() and (numbers.null_count < len(numbers) or kind in (NUMBER, GONE)):
                table = table.set_column(position, names[position], _exact(table.column(position), numbers))
    return table, decimal


def _type(kind: str) -> pa.DataType:
    return pa.float64() if kind in (NUMBER, GONE) else pa.string()


def _arrow(body: bytes, dialect: Dialect, names: Sequence[str], types: dict[str, pa.DataType]) -> pa.Table:
    import pyarrow.csv as arrow_csv

    quoted = b'"' in body
    _refuse_long_numbers(body, types)
    return arrow_csv.read_csv(
        pa.BufferReader(body),
        read_options=arrow_csv.ReadOptions(column_names=list(names), block_size=max(1 << 20, len(body) // 16 + 1)),
        parse_options=arrow_csv.ParseOptions(
            delimiter=dialect.separator or "\x1f",
            newlines_in_values=quoted,
            ignore_empty_lines=dialect.separator != "",
        ),
        convert_options=arrow_csv.ConvertOptions(
            column_types=types, null_values=list(MISSING), decimal_point=dialect.decimal or "."
        ),
    )


def _refuse_long_numbers(body: bytes, types: dict[str, pa.DataType]) -> None:
    """Take the careful road where whole numbers are too long for float64, as epoch nanoseconds are."""
    head = body[:4096]
    if pa.float64() in types.values() and re.search(rb"(?<![.,\d])\d{%d,}(?![.\d])" % (_EXACT_DIGITS + 1), head):
        raise pa.ArrowInvalid("conversion error: long whole numbers")


def _arrow_text(path: Path, body: bytes, dialect: Dialect, names: Sequence[str]) -> pa.Table:
    try:
        return _arrow(body, dialect, names, dict.fromkeys(names, pa.string()))
    except pa.ArrowInvalid as cause:
        raise _ragged(path, body, dialect, str(cause)) from cause


def _decimal_of(table: pa.Table, dialect: Dialect) -> str:
    """Decide the decimal sign on the whole file where the head had no fractions."""
    for position, kind in enumerate(dialect.kinds):
        if kind == NUMBER and pa.types.is_string(table.schema.field(position).type):
            column = table.column(position)
            fractions = pc.and_(pc.match_substring(column, ","), pc.match_substring_regex(column, COMMA))
            if pc.any(fractions).as_py():
                return ","
    return "."


def _exact(text: pa.ChunkedArray, numbers: pa.Array) -> pa.Array:
    """Keep whole numbers that float64 would round."""
    values = np.asarray(numbers.fill_null(0.0))
    if np.abs(values, where=np.isfinite(values), out=np.zeros_like(values)).max(initial=0.0) < 10.0**_EXACT_DIGITS:
        return numbers
    trimmed = pc.utf8_trim_whitespace(text.combine_chunks())
    try:
        return pc.if_else(pc.is_valid(numbers), trimmed, pa.scalar(None, pa.string())).cast(pa.int64())
    except pa.ArrowInvalid:
        return numbers


def _without_padding(table: pa.Table, dialect: Dialect) -> pa.Table:
    """Leave out nameless empty columns at the right: trailing separators make them."""
    last = table.num_columns
    while last > 1 and not dialect.header.names[last - 1] and _is_empty(table.column(last - 1)):
        last -= 1
    return table.select(list(range(last)))


def _is_empty(column: pa.ChunkedArray) -> bool:
    return bool(column.null_count == len(column))


def _ragged(path: Path, body: bytes, dialect: Dialect, cause: str) -> InputError:
    """Find the first row with another number of cells."""
    width = len(dialect.kinds)
    rows = csv.reader(io.StringIO(body.decode("utf-8"), newline=""), delimiter=dialect.separator or "\x1f")
    try:
        for number, row in enumerate((row for row in rows if row), start=1):
            if len(row) != width:
                line = dialect.first_line + rows.line_num
                return InputError(
                    f"Row {number} (line {line}) of {path} has {len(row)} cell{'s' * (len(row) != 1)} where {width} are"
                    f" needed: {(dialect.separator or ' ').join(row)[:60]!r}. Mend or remove that line."
                )
    except csv.Error as error:
        cause = str(error)
    return InputError(f"{path} cannot be read as a table: {' '.join(cause.split())[:200]}. Save it again as plain CSV.")
