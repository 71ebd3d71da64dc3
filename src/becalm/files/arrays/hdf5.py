"""Read HDF5 files with h5py, and their values only when needed. netCDF 4, pandas and PyTables files are HDF5 too."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from textwrap import shorten
from types import ModuleType

from becalm.errors import InputError
from becalm.files.arrays.array_groups import Grouping
from becalm.files.arrays.hdf5_customs import apply_conventions
from becalm.files.arrays.hdf5_opening import Hdf5File
from becalm.files.arrays.hdf5_tree import Tree
from becalm.files.groups import tables
from becalm.files.library_reader import LibraryFile
from becalm.files.source import RawTable


def read(path: Path) -> tuple[RawTable, ...]:
    """Read the tables of an HDF5 file.

    Arrays that share a time, in their group or in one above it, form a table; so do arrays of one group and one length
    that have no time.

    Raises
    ------
    InputError
        If nothing in it can be read.
    """
    return read_tree(LibraryFile(path, "HDF5"), "hdf5", _grouping)


def _grouping(library_file: LibraryFile, opened: Hdf5File, h5py: ModuleType) -> Grouping:
    contents = Tree(library_file, opened, h5py).walk(opened.file)
    apply_conventions(contents)
    return Grouping(contents, "/", apart=True)


def read_tree(
    library_file: LibraryFile,
    form: str,
    group_contents: Callable[[LibraryFile, Hdf5File, ModuleType], Grouping],
    base: int = 0,
) -> tuple[RawTable, ...]:
    """Read the tables of a file that is HDF5 inside; close it if nothing can be read.

    Parameters
    ----------
    library_file : LibraryFile
        The file.
    form : str
        Short name of its format.
    group_contents : callable
        Reads the contents of the open file and returns their grouping.
    base : int
        Number of bytes before the HDF5 signature.

    Raises
    ------
    InputError
        If nothing in it can be read.
    """
    h5py = library_file.library("h5py")
    with library_file.explain_damage():
        opened = Hdf5File(h5py, library_file.path, base)
        library_file.cut = opened.size is not None
    try:
        with library_file.explain_damage():
            grouping = group_contents(library_file, opened, h5py)
            groups = grouping.groups()
        if not groups and grouping.notes:
            raise InputError(
                f"{library_file.path} holds no channel that can be read: {shorten(' '.join(grouping.notes), 500)}"
            )
    except BaseException as cause:
        opened.close()
        if library_file.cut and isinstance(cause, InputError):
            raise library_file.no_rows_error() from cause
        raise
    return tables(library_file, form, groups, opened.close)
