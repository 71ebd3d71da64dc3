"""Read a CSV file larger than memory: parse it block by block into a temporary file, as if it were read whole."""

from __future__ import annotations

import io
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import pyarrow as pa

from becalm.errors import InputError
from becalm.files.csv.blocks import OtherEncodingError, TextFile, rows_of_text
from becalm.files.csv.broken_rows import LastLine, parse_error, refuse_strays, spans_lines, with_truncation_notes
from becalm.files.csv.rates import with_rate
from becalm.files.csv.reader import (
    NUMERIC,
    NumericTypeDetector,
    arrow_options,
    column_types,
    decimal_of_columns,
    exact,
    is_conversion_error,
    numbers_of,
    schema_with_units,
    text_layout,
    units_of,
    without_padding,
)
from becalm.files.csv.sniffing import Dialect, sniff
from becalm.files.rows import SpooledRows
from becalm.files.source import RawTable
from becalm.files.text.cells import TIME
from becalm.files.text.csv_header import unique_names

_PARSED_BYTES = 1 << 20  # bytes that pyarrow parses at once
_HEAD_BYTES = 8 << 20  # bytes of the text from which its layout is detected


def spool_csv(path: Path) -> RawTable:
    """Read a CSV file of any size, compressed or not, in constant memory.

    Raises
    ------
    InputError
        As in `read_csv`.
    """
    text = TextFile(path)
    while True:
        try:
            return _Spooling(path, text).table()
        except OtherEncodingError:
            text.assume_western()


class _Spooling:
    """One attempt to read a file in an assumed encoding."""

    def __init__(self, path: Path, text: TextFile) -> None:
        self._path, self._text = path, text
        self._dialect: Dialect = sniff(path, _head(text.lines()))
        self._last = LastLine(self._dialect)
        self._names = unique_names(self._dialect.header.names)

    def table(self) -> RawTable:
        types = column_types(self._dialect, self._names)
        try:
            rows = self._spooled(types)
        except pa.ArrowInvalid as cause:
            if not is_conversion_error(cause):
                raise self._parse_error(cause) from cause
            try:
                rows = self._spooled(dict.fromkeys(self._names, pa.string()))
            except pa.ArrowInvalid as second:
                raise self._parse_error(second) from second
        try:
            decimal = self._dialect.decimal or self._decimal_of(rows)
            rows = self._with_numbers(rows, decimal)
        except BaseException:
            rows.close()
            raise
        empty = [missing == rows.count for missing in rows.missing]
        rows.keep(without_padding(self._dialect, self._names, empty))
        units = units_of(self._dialect, self._names)
        rows.schema = schema_with_units(rows.schema, units)
        layout = text_layout(self._text.encoding, self._text.compression, self._dialect, decimal)
        raw = RawTable(rows, rows.count, "csv", units, layout)
        return with_rate(with_truncation_notes(raw, self._text.cut, self._last), self._dialect.header.rate_hz)

    def _body(self) -> Iterator[bytes]:
        return rows_of_text(self._last.whole_rows(self._text.lines()), self._dialect.separator)

    def _spooled(self, types: dict[str, pa.DataType]) -> SpooledRows:
        rows = SpooledRows(pa.schema(list(types.items())))
        lines_in_cells = False
        try:
            for table in self._parsed(types):
                lines_in_cells = lines_in_cells or spans_lines(table)
                rows.add(exact(table))
            if lines_in_cells:
                refuse_strays(self._path, self._body, self._dialect)
        except BaseException:
            rows.close()
            raise
        return rows

    def _parsed(self, types: dict[str, pa.DataType]) -> Iterator[pa.Table]:
        """Parse block by block; from the first block with a quote on, parse a stream, because cells may span blocks."""
        import pyarrow.csv as arrow_csv

        body = self._body()
        for block in body:
            if b'"' in block:
                stream = pa.PythonFile(_Stream(chain([block], body)), "r")
                how = arrow_options(
                    self._dialect, self._names, types, newlines_in_cells=True, block_bytes=_quoted_block(block)
                )
                yield from map(_one_batch, arrow_csv.open_csv(stream, **how))
                return
            how = arrow_options(self._dialect, self._names, types, newlines_in_cells=False, block_bytes=_PARSED_BYTES)
            yield arrow_csv.read_csv(pa.BufferReader(block), **how)

    def _parse_error(self, cause: pa.ArrowInvalid) -> InputError:
        return parse_error(self._path, self._body, self._dialect, str(cause))

    def _texts(self, rows: SpooledRows) -> dict[str, str]:
        """Return the columns of text that may be numbers, with their kinds in the first rows."""
        kinds = zip(self._names, self._dialect.kinds, strict=True)
        return {name: kind for name, kind in kinds if kind != TIME and pa.types.is_string(rows.schema.field(name).type)}

    def _decimal_of(self, rows: SpooledRows) -> str:
        names = [name for name, kind in self._texts(rows).items() if kind in NUMERIC]
        blocks = rows.blocks(names, max(1, rows.count)) if names else iter(())
        return decimal_of_columns(self._path, (column for block in blocks for column in block.columns))

    def _with_numbers(self, rows: SpooledRows, decimal: str) -> SpooledRows:
        """Return the rows with columns of text converted to numbers where possible; if any is, close the given rows."""
        columns = {name: NumericTypeDetector(kind, decimal) for name, kind in self._texts(rows).items()}
        for block in rows.blocks(list(columns), max(1, rows.count)) if columns else ():
            for name, numbers in columns.items():
                numbers.add(block.column(name))
            if not any(numbers.possible for numbers in columns.values()):
                return rows
        types = {name: kind for name, numbers in columns.items() if (kind := numbers.type) is not None}
        if not types:
            return rows
        fields = [pa.field(field.name, types.get(field.name, field.type)) for field in rows.schema]
        converted = SpooledRows(pa.schema(fields))
        try:
            for block in rows.blocks(self._names, max(1, rows.count)):
                arrays = [_converted(block.column(name), decimal, types.get(name)) for name in self._names]
                converted.add(pa.table(arrays, converted.schema))
        except BaseException:
            converted.close()
            raise
        rows.close()
        return converted


def _converted(column: pa.ChunkedArray, decimal: str, kind: pa.DataType | None) -> Any:
    return column if kind is None else numbers_of(column, decimal, kind)


def _head(lines: Iterator[bytes]) -> bytes:
    """Return the first lines, enough to detect the layout of the table."""
    head = b""
    while len(head) < _HEAD_BYTES and (block := next(lines, b"")):
        head += block
    return head


def _one_batch(batch: pa.RecordBatch) -> pa.Table:
    return pa.Table.from_batches([batch])


def _quoted_block(block: bytes) -> int:
    """Return how many bytes to parse at once: at least the whole block, so that long rows fit."""
    return max(_PARSED_BYTES, len(block))


class _Stream(io.RawIOBase):
    """A file object for blocks of bytes, which are read once from start to end."""

    def __init__(self, blocks: Iterator[bytes]) -> None:
        self._blocks = blocks
        self._rest = memoryview(b"")

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        out: list[memoryview] = []
        while size:
            if not self._rest:
                self._rest = memoryview(next(self._blocks, b""))
                if not self._rest:
                    break
            part = self._rest if size < 0 else self._rest[:size]
            self._rest = self._rest[len(part) :]
            out.append(part)
            size -= len(part) if size > 0 else 0
        return b"".join(out)
