"""Tables to files: whole or not at all."""

from __future__ import annotations

import csv
import errno
import gzip
import io
import os
import secrets
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.errors import OutputError, RecordingError
from becalm.files.registry import CSV, CSV_GZ, PARQUET_FORMAT, format_to_write
from becalm.files.roles import SIGMA
from becalm.files.source import SourceFile

_TIME = "time_s"


def output_table(source: SourceFile, signal: Recording, sigma: Recording) -> pa.Table:
    """Put clean channels and their uncertainties in the place of the noisy ones.

    Parameters
    ----------
    source : SourceFile
        The file that was cleaned.
    signal, sigma : Recording
        The clean channels and their standard uncertainties; same names, as many rows as the file.

    Returns
    -------
    pyarrow.Table
        The columns of the file in their order, each NAME of `signal` followed by NAME_sigma.

    Raises
    ------
    RecordingError
        If names or numbers of rows do not agree.
    """
    _refuse_strangers(source, signal, sigma)
    fields, columns = [], []
    replaced = {name + SIGMA for name in signal.names}
    for field, column in zip(source.table.schema, source.table.columns, strict=True):
        if field.name in signal.names:
            unit = signal.units[signal.names.index(field.name)]
            fields += [_field(field.name, unit, field.metadata), _field(field.name + SIGMA, unit)]
            columns += [pa.array(signal.channel(field.name)), pa.array(sigma.channel(field.name))]
        elif field.name not in replaced:
            fields.append(field)
            columns.append(column)
    return pa.table(columns, schema=pa.schema(fields, metadata=source.table.schema.metadata))


def recording_table(recording: Recording, sigma: Recording | None = None) -> pa.Table:
    """Make a table of a recording: `time_s`, the channels, and NAME_sigma after each where given.

    Raises
    ------
    RecordingError
        If the names or numbers of rows do not agree, or a channel is called `time_s`.
    """
    if _TIME in recording.names:
        raise RecordingError(f"A channel is called {_TIME!r}, which is the time column's name; rename the channel.")
    if sigma is not None and (sigma.names != recording.names or len(sigma) != len(recording)):
        raise RecordingError(
            f"sigma has {len(sigma)} rows of {sigma.names}; {recording!r} needs its own names and rows."
        )
    fields, columns = [_field(_TIME, "s")], [pa.array(recording.times_s)]
    for name, unit in zip(recording.names, recording.units, strict=True):
        fields.append(_field(name, unit))
        columns.append(pa.array(recording.channel(name)))
        if sigma is not None:
            fields.append(_field(name + SIGMA, unit))
            columns.append(pa.array(sigma.channel(name)))
    return pa.table(columns, schema=pa.schema(fields))


def write(path: str | os.PathLike[str], recording: Recording, sigma: Recording | None = None) -> None:
    """Write a recording as CSV, CSV.GZ or Parquet, by the ending of the name.

    Parameters
    ----------
    path : path-like
        Where to; an older file of that name is replaced once the new one is complete.
    recording : Recording
        The channels; NaN becomes an empty cell in CSV.
    sigma : Recording, optional
        Standard uncertainties, same names and rows; written as NAME_sigma.

    Raises
    ------
    OutputError
        If it cannot be written; nothing is left behind.
    """
    write_table(path, recording_table(recording, sigma))


def write_table(path: str | os.PathLike[str], table: pa.Table, metadata: Mapping[str, str] | None = None) -> None:
    """Write a table whole or not at all: under a temporary name, then renamed.

    Parameters
    ----------
    path : path-like
        Ends in .csv, .csv.gz or .parquet.
    table : pyarrow.Table
        What to write.
    metadata : mapping of str to str, optional
        Kept in a Parquet file's own metadata; CSV has no place for it.

    Raises
    ------
    OutputError
        If it cannot be written; nothing is left behind.
    """
    target = Path(path)
    form = format_to_write(target)
    if target.is_dir():
        raise OutputError(f"{target} is a directory; give the path of a file in it.")
    writers: dict[str, Callable[[pa.Table, IO[bytes]], None]] = {
        CSV: _write_csv,
        CSV_GZ: _write_csv_gz,
        PARQUET_FORMAT: _write_parquet,
    }
    if metadata:
        own = {key.encode(): value.encode() for key, value in metadata.items()}
        table = table.replace_schema_metadata({**(table.schema.metadata or {}), **own})
    replace_file(target, lambda file: writers[form](table, file))


def replace_file(path: Path, fill: Callable[[IO[bytes]], None]) -> None:
    """Write a file under a temporary name in the same folder, and rename it when it is safely on disk.

    Raises
    ------
    OutputError
        If that fails; the temporary file is removed.
    """
    target = path.resolve()
    temporary = target.with_name(f".{target.name[:80]}.{secrets.token_hex(4)}.part")
    try:
        with temporary.open("xb") as file:
            fill(file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
        _sync_folder(target.parent)
    except OSError as cause:
        raise OutputError(_why_not(path, cause)) from cause
    except pa.ArrowException as cause:
        raise OutputError(f"{path} cannot be written: {' '.join(str(cause).split())[:200]}.") from cause
    finally:
        _remove(temporary)


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError:  # the folder is not writable or not there: then nothing was made
        return


def _sync_folder(folder: Path) -> None:
    """Make the new name last through a power cut, where the system can."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError:  # some network folders cannot; the file itself is safe
        return
    finally:
        os.close(handle)


def _why_not(path: Path, cause: OSError) -> str:
    folder = path.parent
    sentences = {
        errno.ENOSPC: f"The disk of {folder} is full; make room or write elsewhere.",
        errno.EDQUOT: f"Your quota on the disk of {folder} is used up; make room or write elsewhere.",
        errno.EACCES: f"{folder} may not be written to; choose another folder with -o.",
        errno.EPERM: f"{folder} may not be written to; choose another folder with -o.",
        errno.EROFS: f"{folder} is on a read-only disk; choose another folder with -o.",
        errno.ENOENT: f"The folder {folder} does not exist; make it first (`mkdir -p {folder}`).",
        errno.ENOTDIR: f"{folder} is a file, not a folder; choose another path with -o.",
        errno.EISDIR: f"{path} is a directory; give the path of a file in it.",
        errno.ENAMETOOLONG: f"The name {path.name[:40]}... is too long; choose a shorter one.",
    }
    text = sentences.get(cause.errno or 0, f"{path} cannot be written: {cause.strerror or cause}.")
    return f"{text} Nothing was written."


def _write_csv(table: pa.Table, file: IO[bytes]) -> None:
    import pyarrow.csv as arrow_csv

    table = _for_csv(table)
    header = io.StringIO()
    like_comment = table.column_names[0].lstrip().startswith(("#", "%", "//"))
    dialect: type[csv.Dialect] = csv.unix_dialect if like_comment else csv.excel
    csv.writer(header, dialect, lineterminator="\n").writerow(table.column_names)
    file.write(header.getvalue().encode("utf-8"))
    style = "needed" if any(map(_needs_quotes, table.columns)) else "none"
    arrow_csv.write_csv(table, file, arrow_csv.WriteOptions(include_header=False, quoting_style=style))


def _write_csv_gz(table: pa.Table, file: IO[bytes]) -> None:
    with gzip.GzipFile(filename="", fileobj=file, mode="wb", compresslevel=6, mtime=0) as packed:
        _write_csv(table, packed)  # type: ignore[arg-type]  # GzipFile writes bytes, and says so only in words


def _write_parquet(table: pa.Table, file: IO[bytes]) -> None:
    import pyarrow.parquet as pq

    pq.write_table(table, file)


def _for_csv(table: pa.Table) -> pa.Table:
    """Make every column one that CSV can hold: NaN and empty text become empty cells."""
    for position, field in enumerate(table.schema):
        column = table.column(position)
        if pa.types.is_floating(field.type):
            column = _without_nan(column)
        elif pa.types.is_nested(field.type) or pa.types.is_binary(field.type):
            raise OutputError(
                f"Column {field.name!r} holds {field.type}, which CSV cannot hold; write .parquet instead."
            )
        elif not _plain(field.type):
            column = column.cast(pa.string())
        if pa.types.is_string(column.type):
            column = pc.if_else(pc.equal(column, ""), pa.scalar(None, pa.string()), column)
        table = table.set_column(position, field.name, column)
    return table


def _without_nan(column: pa.ChunkedArray) -> pa.ChunkedArray:
    if pa.types.is_float16(column.type):
        column = column.cast(pa.float32())
    values = np.asarray(column.to_numpy())
    missing = np.isnan(values)
    if _is_long_count(values[~missing]):  # an epoch in milliseconds: digits, not 1.7e+12
        values = np.where(missing, 0.0, values).astype(np.int64)
    return pa.chunked_array([pa.array(values, mask=missing)])


def _is_long_count(values: Floats) -> bool:
    """Tell whether all are whole, some with so many digits that they would be written as a power of ten."""
    largest = np.abs(values).max(initial=0.0)
    return bool(1e10 <= largest <= 2.0**53 and np.all(values == np.round(values)) and np.all(values != 0.0))


def _plain(kind: Any) -> bool:
    whole = pa.types.is_integer(kind) or pa.types.is_decimal(kind) or pa.types.is_boolean(kind)
    return bool(whole or pa.types.is_temporal(kind) or pa.types.is_string(kind) or pa.types.is_null(kind))


def _needs_quotes(column: pa.ChunkedArray) -> bool:
    if not pa.types.is_string(column.type):
        return False
    return bool(pc.any(pc.match_substring_regex(column, '[",\r\n]')).as_py())


def _field(name: str, unit: str, metadata: Mapping[bytes, bytes] | None = None) -> pa.Field:
    own = {**(metadata or {}), **({b"unit": unit.encode()} if unit else {})}
    return pa.field(name, pa.float64(), metadata=own or None)


def _refuse_strangers(source: SourceFile, signal: Recording, sigma: Recording) -> None:
    rows = source.table.num_rows
    if len(signal) != rows or len(sigma) != rows:
        raise RecordingError(f"{len(signal)} clean rows and {len(sigma)} uncertainties came for a file of {rows} rows.")
    if signal.names != sigma.names:
        raise RecordingError(f"Clean channels are {signal.names}, uncertainties {sigma.names}; they must be the same.")
    strangers = [name for name in signal.names if name not in source.table.column_names]
    if strangers:
        raise RecordingError(f"The file has no column {strangers[0]!r}; it has {', '.join(source.table.column_names)}.")
