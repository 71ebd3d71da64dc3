"""Write tables to files atomically, at once or chunk by chunk."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import IO, Protocol

import pyarrow as pa

from becalm.core.recording import Recording
from becalm.files.atomic_file import explain_write_errors, refuse_folder, replace_file, replacing
from becalm.files.outputs.tables import output_table, recording_table
from becalm.files.registry import CSV, CSV_GZ, HDF5, MAT, MF4, NPZ, PARQUET_FORMAT, TDMS, format_to_write

__all__ = ["TableOutput", "open_output", "output_table", "recording_table", "replace_file", "write", "write_table"]

_QUEUED_CHUNKS = 1  # largest number of computed chunks that wait to be written


def write(path: str | os.PathLike[str], recording: Recording, sigma: Recording | None = None) -> None:
    """Write a recording as CSV, CSV.GZ, HDF5, MAT, MF4, NPZ, Parquet or TDMS, by the ending of the name.

    Parameters
    ----------
    path : path-like
        The output; an older file of that name is replaced once the new one is complete.
    recording : Recording
        The channels; NaN becomes an empty cell in CSV.
    sigma : Recording, optional
        Standard uncertainties with the same names and rows; written as NAME_sigma.

    Raises
    ------
    RecordingError
        If `sigma` has other names or rows, or a channel is called `time_s`.
    OutputError
        If the file cannot be written; the temporary file is removed.
    """
    write_table(path, recording_table(recording, sigma))


def write_table(path: str | os.PathLike[str], table: pa.Table, metadata: Mapping[str, str] | None = None) -> None:
    """Write a table atomically: under a temporary name, then rename the file.

    Parameters
    ----------
    path : path-like
        The output; it ends in .csv, .csv.gz, .h5, .hdf5, .mat, .mf4, .npz, .parquet or .tdms.
    table : pyarrow.Table
        The table to write.
    metadata : mapping of str to str, optional
        Stored in the file: as Parquet's metadata, attributes (HDF5), history (MF4), properties (TDMS), texts (MAT,
        NPZ). CSV cannot store it.

    Raises
    ------
    OutputError
        If the file cannot be written; the temporary file is removed.
    """
    with open_output(path, metadata) as out:
        out.write(table)


@contextmanager
def open_output(
    path: str | os.PathLike[str], metadata: Mapping[str, str] | None = None, form: str = ""
) -> Iterator[TableOutput]:
    """Write a table chunk by chunk; the file appears at the end of the block unless an exception was raised.

    Parameters
    ----------
    path : path-like
        The output; it ends in .csv, .csv.gz, .h5, .hdf5, .mat, .mf4, .npz, .parquet or .tdms.
    metadata : mapping of str to str, optional
        Stored in the file: as Parquet's metadata, attributes (HDF5), history (MF4), properties (TDMS), texts (MAT,
        NPZ). CSV cannot store it.
    form : str
        The format, one of the constants of `becalm.files.registry`; "" for the format of the ending.

    Raises
    ------
    OutputError
        If the file cannot be written; the temporary file is removed.
    """
    target = Path(path)
    form = form or format_to_write(target)
    refuse_folder(target)
    with replacing(target) as file:
        output = TableOutput(target, _writer(form, file), metadata)
        try:
            yield output
        except BaseException:
            output.abandon()
            raise
        output.finish()


def refuse_columns(path: str | os.PathLike[str], schema: pa.Schema) -> None:
    """Refuse columns whose types an output format cannot store, by writing an empty table in memory.

    Parameters
    ----------
    path : path-like
        The output; its ending gives the format, and nothing is written to it.
    schema : pyarrow.Schema
        The columns of the output.

    Raises
    ------
    OutputError
        If the format cannot store one of them.
    """
    target = Path(path)
    with explain_write_errors(target):
        writer = _writer(format_to_write(target), io.BytesIO())
        writer.write(schema.empty_table())
        writer.close()


class _Writer(Protocol):
    """A writer of one format: `close` completes the output, `drop` abandons it."""

    def write(self, table: pa.Table) -> None: ...

    def close(self) -> None: ...

    def drop(self) -> None: ...


_WRITERS = {
    CSV: ("csv.writer", "CsvRows"),
    CSV_GZ: ("csv.writer", "GzippedCsvRows"),
    HDF5: ("arrays.hdf5_writer", "Hdf5Rows"),
    MAT: ("arrays.array_writer", "MatRows"),
    MF4: ("recorders.mf4_writer", "Mf4Rows"),
    NPZ: ("arrays.array_writer", "NpzRows"),
    PARQUET_FORMAT: ("outputs.parquet_writer", "ParquetTableWriter"),
    TDMS: ("recorders.tdms_writer", "TdmsRows"),
}
"""The module within `becalm.files` and the class that write each format."""


def _writer(form: str, file: IO[bytes]) -> _Writer:
    """Return a writer of a format; its module is loaded only now."""
    module, name = _WRITERS[form]
    writer: Callable[[IO[bytes]], _Writer] = getattr(import_module(f"becalm.files.{module}"), name)
    return writer(file)


class TableOutput:
    """A writer of chunks of a table, in a thread while later chunks are computed; made by `open_output`."""

    def __init__(self, path: Path, writer: _Writer, metadata: Mapping[str, str] | None) -> None:
        self._path, self._writer = path, writer
        self._metadata = {key.encode(): value.encode() for key, value in (metadata or {}).items()}
        self._queue: Queue[pa.Table | None] = Queue(_QUEUED_CHUNKS)
        self._failure: BaseException | None = None
        self._abandoned = False
        self._thread = Thread(target=self._work, name="becalm-writer", daemon=True)
        self._thread.start()

    def write(self, table: pa.Table) -> None:
        """Queue the next rows for writing; all chunks have the same schema, and the first may have no rows.

        Raises
        ------
        OutputError
            If these rows or earlier rows cannot be written.
        """
        if self._metadata:
            table = table.replace_schema_metadata({**(table.schema.metadata or {}), **self._metadata})
        self._raise_failure()
        self._queue.put(table)

    def finish(self) -> None:
        """Wait until all chunks are written.

        Raises
        ------
        OutputError
            If a chunk cannot be written.
        """
        self._queue.put(None)
        self._thread.join()
        self._raise_failure()

    def abandon(self) -> None:
        """Stop as soon as possible; queued chunks are not written."""
        self._abandoned = True
        self._queue.put(None)
        self._thread.join()

    def _work(self) -> None:
        """Write queued chunks until the queue yields None; after a failure, discard them: `write` must not block."""
        while (table := self._queue.get()) is not None:
            self._attempt(lambda table=table: self._writer.write(table))  # type: ignore[misc]
        self._attempt(self._writer.close)
        if self._failure is not None or self._abandoned:
            self._writer.drop()

    def _attempt(self, step: Callable[[], None]) -> None:
        if self._failure is not None or self._abandoned:
            return
        try:
            with explain_write_errors(self._path):
                step()
        except BaseException as cause:  # the next call of write or finish raises it in the caller's thread
            self._failure = cause

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure
