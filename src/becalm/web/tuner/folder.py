"""The files that a page may open: those of one folder, by name, and those that it brought itself."""

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
"""Of names of recordings; the content decides what a file is."""

_MOST_LISTED = 2000


class OpenableFile(NamedTuple):
    """A file that may be opened.

    Attributes
    ----------
    id : str
        What a page calls it.
    path : Path
        Where it is.
    bytes : int
        How large it is.
    changed : float
        When it was written, in seconds since 1970.
    """

    id: str
    path: Path
    bytes: int
    changed: float

    def as_dict(self) -> dict[str, object]:
        """Tell a page of it, but not where it is."""
        name = os.fsencode(self.path.name).decode("utf-8", "replace")
        return {"id": self.id, "name": name, "bytes": self.bytes, "changed": self.changed}


class Folder:
    """A folder that was chosen, and what pages brought.

    Parameters
    ----------
    folder : Path
        Of which files may be opened; those in folders inside are not.
    file : Path or None
        One that may be opened wherever it is.
    """

    def __init__(self, folder: Path, file: Path | None) -> None:
        self.folder, self._file = folder, file
        self._brought: list[Path] = []

    @property
    def name(self) -> str:
        """The folder's own name."""
        return os.fsencode(self.folder.resolve().name or str(self.folder)).decode("utf-8", "replace")

    @property
    def first(self) -> str | None:
        """The file that was named at the start, as a page calls it."""
        return None if self._file is None else _id("given", self._file.name)

    def known(self) -> list[OpenableFile]:
        """List what may be opened now: what was named at the start, what was brought, what is in the folder."""
        return [*self._elsewhere(), *self._in_folder()]

    def path_of(self, file: str) -> Path:
        """Return where a file is that a page may open.

        Raises
        ------
        InputError
            If it is none of these, or no longer there.
        """
        room, _, name = file.partition("/")
        for one in self._in_folder(name) if room == "folder" else self._elsewhere():
            if one.id == file:
                return one.path
        raise InputError("That file is not there any more; choose another one, or drop it here.")

    def bring(self, path: Path) -> str:
        """Take in a file that a page sent; return what the page calls it."""
        self._brought.append(path)
        return _id(f"brought/{path.parent.name}", path.name)

    def _elsewhere(self) -> list[OpenableFile]:
        found = [] if self._file is None else [_known("given", self._file, leaving=True)]
        found += [_known(f"brought/{path.parent.name}", path) for path in self._brought]
        return [one for one in found if one is not None]

    def _in_folder(self, name: str | None = None) -> list[OpenableFile]:
        """List what the folder holds, or only what may be of one name."""
        given = None if self._file is None else os.path.realpath(self._file)
        paths = self._listed() if name is None else self._named(name)
        found = [_known("folder", path) for path in paths if os.path.realpath(path) != given]
        return [one for one in found if one is not None]

    def _named(self, name: str) -> list[Path]:
        """Return what a page may mean by a name, without a look at the others."""
        if "\ufffd" in name:  # it stands for what is no text
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


def _known(room: str, path: Path, *, leaving: bool = False) -> OpenableFile | None:
    """Tell of a file; None of a link that leads out of its folder, a pipe, a device, or what cannot be looked at."""
    try:
        if not leaving and Path(os.path.realpath(path)).parent != Path(os.path.realpath(path.parent)):
            return None
        told = path.stat()
    except OSError:
        return None
    if stat.S_ISREG(told.st_mode) or (stat.S_ISDIR(told.st_mode) and (path / BAG).is_file()):
        return OpenableFile(_id(room, path.name), path, told.st_size, told.st_mtime)
    return None


def _id(room: str, name: str) -> str:
    return f"{room}/{os.fsencode(name).decode('utf-8', 'replace')}"
