"""Tables to MAT and NPZ: an array for each column, held in memory until the last row has come."""

from __future__ import annotations

import re
import zipfile
from typing import IO, Any

import numpy as np
import pyarrow as pa
from numpy.lib import format as npy
from numpy.typing import NDArray

from becalm.errors import OutputError
from becalm.files.array_labels import NAMES, UNITS, VARIABLES, variables
from becalm.files.column_arrays import refuse_strange_types, told_of, unit_of_field, whole_column

_MOST_BYTES = (1 << 31) - (1 << 16)  # of a variable of version 5


class _ArrayRows:
    """Takes tables of one schema.

    The lists `becalm_variables`, `becalm_names` and `becalm_units` tell which array holds which column. Dates are
    text. Missing whole numbers and flags make their column one of float64, NaN where they are missing.

    Parameters
    ----------
    file : binary file
        Where to.
    """

    form = ""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._held: list[pa.Table] = []

    def write(self, table: pa.Table) -> None:
        """Hold some rows."""
        if not self._held:
            refuse_strange_types(table.schema, self.form)
        self._held.append(table)
        self._refuse_size()

    def close(self) -> None:
        """Write all; the file stays open."""
        if not self._held:
            return
        table = pa.concat_tables(self._held)
        self._held = []
        names = variables(table.column_names)
        arrays = {name: whole_column(column) for name, column in zip(names, table.columns, strict=True)}
        units = [unit_of_field(field) for field in table.schema]
        lists = {VARIABLES: list(names), NAMES: table.column_names, UNITS: units}
        told = {re.sub(r"\W", "_", key): text for key, text in told_of(table.schema).items()}
        self._save(arrays, lists, told)

    def drop(self) -> None:
        """Forget what is held."""
        self._held = []

    def _refuse_size(self) -> None:
        """Refuse what the format cannot hold."""

    def _save(self, arrays: dict[str, NDArray[Any]], lists: dict[str, list[str]], told: dict[str, str]) -> None:
        raise NotImplementedError


class MatRows(_ArrayRows):
    """Writes version 5 of MAT: columns as variables, text as matrices of letters, what is told as texts.

    Parameters
    ----------
    file : binary file
        Where to.

    Raises
    ------
    OutputError
        If a column takes more than 2 GB, which that version cannot hold.
    """

    form = "MAT"

    def _refuse_size(self) -> None:
        rows = sum(table.num_rows for table in self._held)
        if rows * 8 > _MOST_BYTES:
            raise OutputError(
                f"{rows} rows are more than a MAT file of version 5 can hold, 2 GB a variable; write .h5, which MATLAB"
                " reads by h5read."
            )

    def _save(self, arrays: dict[str, NDArray[Any]], lists: dict[str, list[str]], told: dict[str, str]) -> None:
        from scipy.io import savemat
        from scipy.io.matlab import MatWriteError

        cells = {name: np.array([*texts, None], object)[:-1] for name, texts in lists.items()}
        try:
            savemat(
                self._file,  # type: ignore[arg-type]  # takes files
                {**arrays, **cells, **told},
                do_compression=True,
                long_field_names=True,
                oned_as="column",
            )
        except MatWriteError as cause:
            raise OutputError(f"A MAT file of version 5 cannot hold this ({cause}); write .h5 instead.") from cause


class NpzRows(_ArrayRows):
    """Writes NPZ: columns as arrays, nothing pickled; what repeats is packed.

    Parameters
    ----------
    file : binary file
        Where to.
    """

    form = "NPZ"

    def _save(self, arrays: dict[str, NDArray[Any]], lists: dict[str, list[str]], told: dict[str, str]) -> None:
        texts = {name: np.array(text) for name, text in (lists | told).items()}
        with zipfile.ZipFile(self._file, "w") as archive:
            for name, values in (arrays | texts).items():
                member = zipfile.ZipInfo(f"{name}.npy")  # its date is always the same
                member.compress_type = zipfile.ZIP_STORED if values.dtype.kind == "f" else zipfile.ZIP_DEFLATED
                with archive.open(member, "w", force_zip64=True) as file:
                    npy.write_array(file, np.ascontiguousarray(values), allow_pickle=False)
