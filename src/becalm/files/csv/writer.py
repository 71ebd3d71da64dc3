"""Write tables as CSV; the bytes do not depend on how the rows are split into chunks."""

from __future__ import annotations

import csv
import gzip
import io
from contextlib import suppress
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.files.column_arrays import refuse_strange_types, unit_of_field
from becalm.files.timing.time_column import is_time_name
from becalm.files.units.unit_spelling import time_unit

_ROWS = 1 << 16  # rows that are written at once
_LONG, _EXACT = 1e10, 2.0**53  # whole floats between these magnitudes are written as digits, without an exponent
_SPECIAL = '[",\r\n]'  # a cell with one of these needs quotes


class CsvRows:
    """A writer that appends tables of one schema as CSV.

    Parameters
    ----------
    file : binary file
        The output; it is not closed.
    packed : bool
        Whether to compress with gzip.
    """

    def __init__(self, file: IO[bytes], packed: bool = False) -> None:
        self._packed = gzip.GzipFile(filename="", fileobj=file, mode="wb", compresslevel=6, mtime=0) if packed else None
        self._file: Any = self._packed or file
        self._has_header = False

    def write(self, table: pa.Table) -> None:
        """Write rows; the first call writes the names above them.

        Raises
        ------
        OutputError
            If CSV cannot hold a column.
        """
        if not self._has_header:
            self._file.write(_header([_named_with_unit(field) for field in table.schema]))
            self._has_header = True
        refuse_strange_types(table.schema, "CSV")
        for start in range(0, table.num_rows, _ROWS):
            _write_block(table.slice(start, _ROWS), self._file)

    def close(self) -> None:
        """Finish the text; the file stays open."""
        if self._packed is not None:
            self._packed.close()

    def drop(self) -> None:
        """Close the compressor and ignore errors, because the output is not used."""
        with suppress(OSError):
            self.close()


class GzippedCsvRows(CsvRows):
    """A writer that appends tables as CSV compressed with gzip."""

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__(file, packed=True)


def _named_with_unit(field: pa.Field) -> str:
    """Return the name of a column; a time gets its unit behind its name, unless the name holds it already."""
    unit = unit_of_field(field)
    numeric = pa.types.is_integer(field.type) or pa.types.is_floating(field.type)
    return (
        f"{field.name} ({unit})"
        if unit and numeric and is_time_name(field.name) and not time_unit(field.name)
        else field.name
    )


def _header(names: list[str]) -> bytes:
    text = io.StringIO()
    like_comment = names[0].lstrip().startswith(("#", "%", "//"))
    dialect: type[csv.Dialect] = csv.unix_dialect if like_comment else csv.excel
    csv.writer(text, dialect, lineterminator="\n").writerow(names)
    return text.getvalue().encode("utf-8")


def _write_block(table: pa.Table, file: Any) -> None:
    import pyarrow.csv as arrow_csv

    columns = [_plain_column(column) for column in table.columns]
    if any(map(_has_special, columns)):
        file.write(_joined([_quoted(column) for column in columns]))
        return
    plain = pa.table(columns, names=table.column_names)
    arrow_csv.write_csv(plain, file, arrow_csv.WriteOptions(include_header=False, quoting_style="none"))


def _plain_column(column: pa.ChunkedArray) -> pa.Array:
    """Convert a column to a type that CSV can hold; NaN and empty text become empty cells."""
    array = column.combine_chunks()
    if pa.types.is_floating(array.type):
        return _without_nan(array)
    if not _is_plain(array.type):
        array = array.cast(pa.string())
    if pa.types.is_string(array.type):
        return pc.if_else(pc.equal(array, ""), pa.scalar(None, pa.string()), array)
    return array


def _without_nan(array: pa.Array) -> pa.Array:
    if pa.types.is_float16(array.type):
        array = array.cast(pa.float32())
    values = array.to_numpy(zero_copy_only=False)
    missing = np.isnan(values)
    numbers = pa.array(values, mask=missing) if missing.any() else pa.array(values)
    with np.errstate(invalid="ignore"):
        size = np.abs(values)
        long = (size >= _LONG) & (size <= _EXACT)
    if not long.any():
        return numbers
    long &= values == np.round(values)  # for example counts of milliseconds since 1970: write digits, not 1.7e+12
    digits = pa.array(np.where(long, values, 0.0).astype(np.int64), mask=missing)
    if np.all(long | missing):
        return digits
    return pc.if_else(pa.array(long), digits.cast(pa.string()), numbers.cast(pa.string()))


def _is_plain(kind: Any) -> bool:
    whole = pa.types.is_integer(kind) or pa.types.is_decimal(kind) or pa.types.is_boolean(kind)
    return bool(whole or pa.types.is_temporal(kind) or pa.types.is_string(kind) or pa.types.is_null(kind))


def _has_special(array: pa.Array) -> bool:
    return pa.types.is_string(array.type) and bool(pc.any(pc.match_substring_regex(array, _SPECIAL)).as_py())


def _quoted(array: pa.Array) -> pa.Array:
    """Convert a column to text, with quotes around the cells that need them."""
    if not pa.types.is_string(array.type):
        return _as_text(array)
    wrapped = pc.binary_join_element_wise("", pc.replace_substring(array, '"', '""'), "", '"')
    return pc.if_else(pc.match_substring_regex(array, _SPECIAL), wrapped, array)


def _as_text(array: pa.Array) -> pa.Array:
    """Convert numbers and times to the same text as pyarrow's CSV writer."""
    import pyarrow.csv as arrow_csv

    if pa.types.is_null(array.type) or not pa.types.is_temporal(array.type):
        return array.cast(pa.string())
    text = io.BytesIO()
    table = pa.table([array, pa.nulls(len(array))], names=["a", "b"])  # the second column keeps lines from being empty
    arrow_csv.write_csv(table, text, arrow_csv.WriteOptions(include_header=False, quoting_style="none"))
    cells = [line[:-1] or None for line in text.getvalue().decode("utf-8").splitlines()]
    return pa.array(cells, pa.string())


def _joined(columns: list[pa.Array]) -> bytes:
    """Join columns of cells into the text of their rows."""
    how = {"null_handling": "replace", "null_replacement": ""}
    ended = pc.binary_join_element_wise(columns[-1], "", "\n", **how)
    rows = pc.binary_join_element_wise(*columns[:-1], ended, ",", **how)
    return "".join(rows.to_pylist()).encode("utf-8")
