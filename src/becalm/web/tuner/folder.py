"""The files that a page may open: those of one folder, by name, and those that it brought itself."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import unicodedata
from pathlib import Path
from typing import NamedTuple

from becalm.errors import InputError, UsageError
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
_LONGEST_NAME = 255  # bytes, of a name in most file systems
_FORBIDDEN = frozenset('/\\:*?"<>|')


class Known(NamedTuple):
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
    """A folder that was chosen, and a private one for what is brought.

    Parameters
    ----------
    folder : Path
        Of which files may be opened; those in folders inside are not.
    file : Path or None
        One that may be opened wherever it is.
    """

    def __init__(self, folder: Path, file: Path | None) -> None:
        if not folder.is_dir():
            raise UsageError(f"{folder} is no folder; name one with --folder.")
        self.folder, self._file = folder, file
        self._brought: Path | None = None

    @property
    def name(self) -> str:
        """The folder's own name."""
        return os.fsencode(self.folder.resolve().name or str(self.folder)).decode("utf-8", "replace")

    @property
    def first(self) -> str | None:
        """The file that was named at the start, as a page calls it."""
        return None if self._file is None else _id("given", self._file.name)

    def known(self) -> list[Known]:
        """List what may be opened now, in the order of names: what is in the folder, what was brought, what was named."""
        found = [] if self._file is None else [_known("given", self._file, leaving=True)]
        if self._brought is not None:
            found += [_known("brought", path) for path in sorted(self._brought.iterdir())]
        named = None if self._file is None else self._file.resolve()
        for path in self._listed():
            if path.resolve() != named:
                found.append(_known("folder", path))
        return [one for one in found if one is not None]

    def path_of(self, file: str) -> Path:
        """Return where a file is that a page may open.

        Raises
        ------
        InputError
            If it is none of these, or no longer there.
        """
        for one in self.known():
            if one.id == file:
                return one.path
        raise InputError("That file is not there any more; choose another one, or drop it here.")

    def place_for(self, name: str) -> Path:
        """Return where a file that is brought is to be written, under its own name.

        Raises
        ------
        UsageError
            If the name is none for a file.
        """
        if not is_plain(name):
            raise UsageError("That is no plain name of a file; rename it, and drop it again.")
        if self._brought is None:
            self._brought = Path(tempfile.mkdtemp(prefix="becalm-"))  # readable by its owner only
        return self._brought / name

    def id_of_brought(self, name: str) -> str:
        """Return what a page calls a file that was brought."""
        return _id("brought", name)

    def close(self) -> None:
        """Remove what was brought."""
        if self._brought is not None:
            shutil.rmtree(self._brought, ignore_errors=True)
            self._brought = None

    def _listed(self) -> list[Path]:
        try:
            inside = sorted(path for path in self.folder.iterdir() if _looks_readable(path))
        except OSError:
            return []
        return inside[:_MOST_LISTED]


def is_plain(name: str) -> bool:
    """Whether a name is that of a file, and leads nowhere else."""
    if not name or name.startswith(".") or name != name.strip() or len(name.encode("utf-8", "replace")) > _LONGEST_NAME:
        return False
    return not any(sign in _FORBIDDEN or unicodedata.category(sign) in ("Cc", "Cs") for sign in name)


def _looks_readable(path: Path) -> bool:
    if path.name.startswith("."):
        return False
    return path.name.lower().endswith(READ_ENDINGS) or (path.is_dir() and (path / BAG).is_file())


def _known(room: str, path: Path, *, leaving: bool = False) -> Known | None:
    """Tell of a file; None of a link that leads out of its folder, a pipe, a device, or what cannot be looked at."""
    try:
        if not leaving and path.resolve().parent != path.parent.resolve():
            return None
        told = path.stat()
    except (OSError, RuntimeError):
        return None
    if stat.S_ISREG(told.st_mode) or (stat.S_ISDIR(told.st_mode) and (path / BAG).is_file()):
        return Known(_id(room, path.name), path, told.st_size, told.st_mtime)
    return None


def _id(room: str, name: str) -> str:
    return f"{room}/{os.fsencode(name).decode('utf-8', 'replace')}"
