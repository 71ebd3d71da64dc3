"""List the files that a page may open: files in one folder, the file of the command line, and uploaded files."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import NamedTuple

from becalm.errors import InputError
from becalm.files.registry import BAG

READ_ENDINGS = (
    ".csv",
    ".txt",
    ".tsv",
    ".dat",
    ".log",
    ".csv.gz",
    ".txt.gz",
    ".parquet",
    ".pq",
    ".mf4",
    ".mdf",
    ".tdms",
    ".uff",
    ".unv",
    ".mat",
    ".h5",
    ".hdf5",
    ".npz",
    ".wav",
    ".bag",
    ".db3",
    ".mcap",
    ".ulg",
    ".ide",
)
"""Endings of the names of files that are listed; their content decides the format."""

_MOST_LISTED = 2000  # largest number of files that are listed from the folder


class OpenableFile(NamedTuple):
    """A file that a page may open.

    Attributes
    ----------
    id : str
        Name of the file in messages to and from a page.
    path : Path
        Path of the file.
    bytes : int
        Size in bytes.
    changed : float
        Time of the last change, in seconds since the start of 1970 (UTC).
    """

    id: str
    path: Path
    bytes: int
    changed: float

    def as_dict(self) -> dict[str, object]:
        """Return the description of the file for a page, without its path."""
        name = os.fsencode(self.path.name).decode("utf-8", "replace")
        return {"id": self.id, "name": name, "bytes": self.bytes, "changed": self.changed}


class Folder:
    """The files that the pages of a tuner may open.

    Parameters
    ----------
    folder : Path
        Folder whose files may be opened; those in its subfolders may not.
    file : Path or None
        Another file that may be opened, in any folder.
    """

    def __init__(self, folder: Path, file: Path | None) -> None:
        self.folder, self._file = folder, file
        self._uploaded: list[Path] = []

    @property
    def name(self) -> str:
        """Return the name of the folder."""
        return os.fsencode(self.folder.resolve().name or str(self.folder)).decode("utf-8", "replace")

    @property
    def first(self) -> str | None:
        """Return the id of the file of the command line, or None."""
        return None if self._file is None else _id("given", self._file.name)

    def openable_files(self) -> list[OpenableFile]:
        """List the files that may be opened: the file of the command line, uploaded files, files in the folder."""
        return [*self._elsewhere(), *self._in_folder()]

    def path_of(self, file: str) -> Path:
        """Return the path of a file that a page may open.

        Raises
        ------
        InputError
            If a page may not open the file, or the file no longer exists.
        """
        origin, _, name = file.partition("/")
        for one in self._in_folder(name) if origin == "folder" else self._elsewhere():
            if one.id == file:
                return one.path
        raise InputError("That file no longer exists; choose another one, or drop it here.")

    def add_uploaded(self, path: Path) -> str:
        """Add an uploaded file; return its id."""
        self._uploaded.append(path)
        return _id(f"brought/{path.parent.name}", path.name)

    def _elsewhere(self) -> list[OpenableFile]:
        files = [] if self._file is None else [_openable("given", self._file, allow_link_out=True)]
        files += [_openable(f"brought/{path.parent.name}", path) for path in self._uploaded]
        return [one for one in files if one is not None]

    def _in_folder(self, name: str | None = None) -> list[OpenableFile]:
        """List the files in the folder, or only those that a page may mean by a name."""
        given = None if self._file is None else os.path.realpath(self._file)
        paths = self._listed() if name is None else self._candidates(name)
        files = [_openable("folder", path) for path in paths if os.path.realpath(path) != given]
        return [one for one in files if one is not None]

    def _candidates(self, name: str) -> list[Path]:
        """Return the paths that a page may mean by a name, if possible without reading the whole folder."""
        if "\ufffd" in name:  # a replacement character: the real name is not valid text
            return self._listed()
        path = self.folder / name
        return [path] if path.name == name and _looks_readable(path) and path.exists() else []

    def _listed(self) -> list[Path]:
        try:
            inside = sorted(path for path in self.folder.iterdir() if _looks_readable(path))
        except OSError:
            return []
        return inside[:_MOST_LISTED]


def _looks_readable(path: Path) -> bool:
    if path.name.startswith("."):
        return False
    return path.name.lower().endswith(READ_ENDINGS) or (path.is_dir() and (path / BAG).is_file())


def _openable(origin: str, path: Path, *, allow_link_out: bool = False) -> OpenableFile | None:
    """Describe a file; None for a pipe, a device, an unreadable file or (unless allowed) a link to another folder."""
    try:
        if not allow_link_out and Path(os.path.realpath(path)).parent != Path(os.path.realpath(path.parent)):
            return None
        status = path.stat()
    except OSError:
        return None
    if stat.S_ISREG(status.st_mode) or (stat.S_ISDIR(status.st_mode) and (path / BAG).is_file()):
        return OpenableFile(_id(origin, path.name), path, status.st_size, status.st_mtime)
    return None


def _id(origin: str, name: str) -> str:
    return f"{origin}/{os.fsencode(name).decode('utf-8', 'replace')}"
