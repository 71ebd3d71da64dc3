"""Write tables to MAT and NPZ: an array for each column, kept in memory until the end."""

from __future__ import annotations

import io
import re
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import IO, Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.lib import format as npy
from numpy.typing import NDArray

from becalm.errors import OutputError
from becalm.files.arrays.array_labels import NAMES, OF_TABLE, UNITS, VARIABLES, folder_name, variables
from becalm.files.column_arrays import metadata_of, refuse_strange_types, unit_of_field, whole_column
from becalm.files.groups import GROUP

_HEAD = b"MATLAB 5.0 MAT-file, written by becalm".ljust(116)  # without a date, so that equal data give equal bytes
_MOST_BYTES = (1 << 31) - (1 << 16)  # largest size of a variable in version 5


class _Folder(NamedTuple):
    """The data to write for one group, by name: arrays, texts and lists of texts."""

    arrays: dict[str, NDArray[Any]]
    texts: dict[str, str | list[str]]


class _ArrayRows(ABC):
    """A writer that collects tables of one schema; each group of tables goes into a folder of its own.

    The lists `becalm_variables`, `becalm_names` and `becalm_units` name the column and the unit of each array;
    `becalm_group` is the name of a folder's group. Dates are text. A column of whole numbers or flags with missing
    values becomes float64, with NaN where missing.

    Parameters
    ----------
    file : binary file
        The file to write.
    """

    form = ""  # name of the format, for messages

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._held: dict[str, list[pa.Table]] = {}

    def write(self, table: pa.Table) -> None:
        """Collect rows of a group.

        Raises
        ------
        OutputError
            If the format cannot hold a column, or so many rows.
        """
        group = metadata_of(table.schema).get(GROUP, "")
        if group not in self._held:
            refuse_strange_types(table.schema, self.form)
        self._held.setdefault(group, []).append(table)
        rows = sum(one.num_rows for one in self._held[group])
        self._refuse_size(rows, 8 * rows * (table.num_columns if group else 1))

    def close(self) -> None:
        """Write all tables; the file itself stays open."""
        if not self._held:
            return
        root = _Folder({}, {})
        folders: dict[str, _Folder] = {}
        for group in list(self._held):
            table = pa.concat_tables(self._held.pop(group))
            metadata = metadata_of(table.schema)
            root.texts.update(_texts({key: text for key, text in metadata.items() if key not in OF_TABLE}))
            folder = _folder(table, {key: text for key, text in metadata.items() if key in OF_TABLE})
            if group:
                folders[folder_name(group, {*folders, *root.texts})] = folder
            else:
                root.arrays.update(folder.arrays)
                root.texts.update(folder.texts)
        self._save(root, folders)

    def drop(self) -> None:
        """Discard all rows."""
        self._held = {}

    def _refuse_size(self, rows: int, most_bytes: int) -> None:
        """Raise an error if the format cannot hold so many rows; by default it can hold any number."""
        del rows, most_bytes

    @abstractmethod
    def _save(self, root: _Folder, folders: dict[str, _Folder]) -> None:
        """Write all groups."""


def _folder(table: pa.Table, metadata: Mapping[str, str]) -> _Folder:
    names = variables(table.column_names)
    arrays = {name: whole_column(name, column) for name, column in zip(names, table.columns, strict=True)}
    units = [unit_of_field(field) for field in table.schema]
    lists = {VARIABLES: list(names), NAMES: table.column_names, UNITS: units}
    return _Folder(arrays, lists | _texts(metadata))


def _texts(metadata: Mapping[str, str]) -> dict[str, str | list[str]]:
    return {re.sub(r"\W", "_", key): text for key, text in metadata.items()}


class MatRows(_ArrayRows):
    """A writer of MAT version 5: columns are variables, texts are char matrices, and each group is a struct.

    Parameters
    ----------
    file : binary file
        The file to write.

    Raises
    ------
    OutputError
        By `write` or `close`, if a column or a struct is larger than 2 GB, the limit of that version.
    """

    form = "MAT"

    def _refuse_size(self, rows: int, most_bytes: int) -> None:
        if most_bytes > _MOST_BYTES:
            raise OutputError(
                f"{rows} rows are more than a MAT file of version 5 can hold, 2 GB a variable; write .h5, which MATLAB"
                " reads with h5read."
            )

    def _save(self, root: _Folder, folders: dict[str, _Folder]) -> None:
        from scipy.io import savemat
        from scipy.io.matlab import MatWriteError

        try:
            savemat(
                self._file,  # type: ignore[arg-type]  # takes files
                _members(root) | {name: _members(folder) for name, folder in folders.items()},
                do_compression=True,
                long_field_names=True,
                oned_as="column",
            )
        except MatWriteError as cause:
            raise OutputError(f"A MAT file of version 5 cannot hold this ({cause}); write .h5 instead.") from cause
        self._file.seek(0)
        self._file.write(_HEAD)
        self._file.seek(0, io.SEEK_END)


def _members(folder: _Folder) -> dict[str, Any]:
    """Return variables, or fields of a struct: column vectors, and lists as cells."""
    columns = {name: values.reshape(-1, 1) for name, values in folder.arrays.items()}
    cells = {
        name: texts if isinstance(texts, str) else np.array([*texts, None], object)[:-1].reshape(-1, 1)
        for name, texts in folder.texts.items()
    }
    return columns | cells


class NpzRows(_ArrayRows):
    """A writer of NPZ: columns are arrays; names in a group begin with `folder/`.

    Nothing is pickled. Arrays other than floats are compressed.

    Parameters
    ----------
    file : binary file
        The file to write.
    """

    form = "NPZ"

    def _save(self, root: _Folder, folders: dict[str, _Folder]) -> None:
        with zipfile.ZipFile(self._file, "w") as archive:
            for prefix, folder in {"": root, **{f"{name}/": folder for name, folder in folders.items()}}.items():
                texts = {name: np.array(text) for name, text in folder.texts.items()}
                for name, values in (folder.arrays | texts).items():
                    _add(archive, f"{prefix}{name}.npy", values)


def _add(archive: zipfile.ZipFile, name: str, values: NDArray[Any]) -> None:
    member = zipfile.ZipInfo(name)  # with a constant date, so that equal data give equal bytes
    member.compress_type = zipfile.ZIP_STORED if values.dtype.kind == "f" else zipfile.ZIP_DEFLATED
    with archive.open(member, "w", force_zip64=True) as file:
        npy.write_array(file, np.ascontiguousarray(values), allow_pickle=False)
