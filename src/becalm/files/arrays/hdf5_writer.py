"""Write tables to HDF5: one dataset for each column, chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import IO, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.errors import OutputError
from becalm.files.arrays.array_labels import FLAG, NAME, OF_TABLE, folder_name, variables
from becalm.files.column_arrays import (
    FillValues,
    is_text,
    metadata_of,
    numbers_of,
    refuse_strange_types,
    texts_of,
    unit_of_field,
)
from becalm.files.groups import GROUP

_CHUNK_ROWS = 1 << 15  # largest number of rows in a chunk
_FEWEST = 16  # smallest number of rows in a chunk
_LONGEST = 64  # largest number of letters in a date


class _ErrorDeferringFile:
    """A file that holds an exception back until `raise_failure`, because HDF5 ends the process if a write fails."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._failure: BaseException | None = None

    def raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _attempt(self, step: Callable[[], Any], otherwise: int) -> Any:
        if self._failure is None:
            try:
                return step()
            except (OSError, ValueError) as cause:
                self._failure = cause
        return otherwise

    def write(self, data: Any) -> Any:
        return self._attempt(lambda: self._file.write(data), len(data))

    def read(self, size: int = -1) -> Any:
        return self._attempt(lambda: self._file.read(size), 0)

    def readinto(self, buffer: Any) -> Any:
        return self._attempt(lambda: self._file.readinto(buffer), len(buffer))  # type: ignore[attr-defined]

    def seek(self, offset: int, whence: int = 0) -> Any:
        return self._attempt(lambda: self._file.seek(offset, whence), 0)

    def tell(self) -> Any:
        return self._attempt(self._file.tell, 0)

    def truncate(self, size: int | None = None) -> Any:
        return self._attempt(lambda: self._file.truncate(size), 0)

    def flush(self) -> None:
        self._attempt(self._file.flush, 0)


class Hdf5Rows:
    """A writer that appends tables of one schema; each table group of becalm goes into its own HDF5 group.

    Each column is a dataset, with its unit in the attribute `unit`. If the column's name is not valid for a dataset,
    the attribute `becalm.name` has it. Dates are text. Missing whole numbers have the value of the attribute
    `_FillValue`. Metadata of the table are attributes of the file, or of the group.

    Parameters
    ----------
    file : binary file
        The file to write; it must be readable, too.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = _ErrorDeferringFile(file)
        self._out: Any = None
        self._tables: dict[str, _Table] = {}

    def write(self, table: pa.Table) -> None:
        """Append rows to a group.

        Raises
        ------
        OutputError
            If h5py is not installed, HDF5 cannot hold a column, or a text is longer than its column allows.
        OSError
            If the file cannot be written.
        """
        if self._out is None:
            self._out = _h5py().File(self._file, "w", libver="v108", track_order=True)
        metadata = metadata_of(table.schema)
        group = metadata.get(GROUP, "")
        if group not in self._tables:
            refuse_strange_types(table.schema, "HDF5")
            name = folder_name(group, self._out.keys())
            folder = self._out.create_group(name, track_order=True) if group else self._out
            self._tables[group] = _Table(folder, table)
            for key, text in {GROUP: "", **metadata}.items():
                (folder if key in OF_TABLE else self._out).attrs[key] = text
        self._tables[group].write(table)
        self._file.raise_failure()

    def close(self) -> None:
        """Finish writing; the file itself stays open."""
        if self._out is None:
            return
        for table in self._tables.values():
            table.close()
        self._out.close()
        self._file.raise_failure()

    def drop(self) -> None:
        """Stop writing and discard the result."""
        if self._out is not None:
            with suppress(Exception):  # the file is not needed any more, and may be incomplete
                self._out.close()


class _Table:
    """The datasets of one table."""

    def __init__(self, folder: Any, table: pa.Table) -> None:
        self._datasets: list[Any] = []
        self._fills = FillValues()
        self._rows = 0
        chunk = (min(_CHUNK_ROWS, max(_FEWEST, table.num_rows)),)  # small chunks for a short table save space
        for variable, field in zip(variables(table.column_names), table.schema, strict=True):
            kind = _stored(field, table.column(field.name), _h5py())
            packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if kind.kind != "f" else {}
            dataset = folder.create_dataset(variable, (0,), kind, maxshape=(None,), chunks=chunk, **packed)
            if unit := unit_of_field(field):
                dataset.attrs["unit"] = unit
            if variable != field.name:
                dataset.attrs[NAME] = field.name
            if pa.types.is_boolean(field.type):
                dataset.attrs[FLAG] = True
            self._datasets.append(dataset)

    def write(self, table: pa.Table) -> None:
        stop = self._rows + table.num_rows
        for dataset, column in zip(self._datasets, table.columns, strict=True):
            dataset.resize((stop,))
            if table.num_rows:
                dataset[self._rows :] = self._values(dataset, column)
        self._rows = stop

    def close(self) -> None:
        for dataset in self._datasets:
            if dataset.dtype.kind in "iu" and (fill := self._fills.of(dataset.name, dataset.dtype)) is not None:
                dataset.attrs["_FillValue"] = fill
                dataset.attrs.pop(FLAG, None)

    def _values(self, dataset: Any, column: pa.ChunkedArray) -> NDArray[Any]:
        if is_text(column.type):
            texts = texts_of(column)
            if dataset.dtype.kind != "S":
                return texts
            encoded = np.array([text.encode() for text in texts])
            if encoded.dtype.itemsize > dataset.dtype.itemsize:
                raise OutputError(
                    f"{max(encoded, key=len).decode()!r} in {dataset.name!r} is longer than the words in earlier rows;"
                    " cast that column to pyarrow.string()."
                )
            return encoded
        values, missing = numbers_of(column)
        return (
            values
            if values.dtype.kind == "f"
            else self._fills.filled(dataset.name, values.astype(dataset.dtype, copy=False), missing)
        )


def _h5py() -> Any:
    try:
        return import_module("h5py")
    except ModuleNotFoundError as cause:
        raise OutputError("Writing HDF5 needs h5py. Type: pip install 'becalm[formats]'") from cause


def _stored(field: pa.Field, column: pa.ChunkedArray, h5py: Any) -> np.dtype[Any]:
    """Return the type of a dataset; repeating words get a fixed length, which packs well."""
    if not is_text(field.type):
        kind = numbers_of(column)[0].dtype
        return np.dtype(np.uint8) if kind.kind == "b" else kind
    if pa.types.is_dictionary(field.type):
        words = [word for chunk in column.chunks for word in chunk.dictionary.to_pylist() if word]
        if words:
            return np.dtype(f"S{max(len(str(word).encode()) for word in words)}")
    return np.dtype(f"S{_LONGEST}") if pa.types.is_temporal(field.type) else np.dtype(h5py.string_dtype())
