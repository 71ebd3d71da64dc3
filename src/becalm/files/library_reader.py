"""Read a format with another library: import the library when it is needed, and explain its errors to the user."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from types import ModuleType

from becalm.errors import BecalmError, InputError

_MOST_RATIO = 200  # highest plausible ratio of unpacked to stored size: noise does not compress better
_SMALL = 256 << 20  # bytes of content that a file of any size may claim


class LibraryFile:
    """A file of a format that another library reads.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        The name of the format for messages, such as "MF4".

    Attributes
    ----------
    cut : bool
        Whether the file is truncated; set by the reader of the format.
    """

    def __init__(self, path: Path, name: str) -> None:
        self.path, self.name = path, name
        self._unpacked = 0
        self.cut = False

    def library(self, module: str) -> ModuleType:
        """Import and return a module of a library.

        Raises
        ------
        InputError
            If the library is not installed.
        """
        try:
            return import_module(module)
        except ModuleNotFoundError as cause:
            raise InputError(
                f"{self.path} is {self.name}, which is read by {module.partition('.')[0]}; that is not installed."
                " Type: pip install 'becalm[formats]'"
            ) from cause

    @contextmanager
    def explain_damage(self) -> Iterator[None]:
        """Turn any error of a library into an InputError about a damaged file.

        Raises
        ------
        InputError
            Instead of any exception other than becalm's own errors and a MemoryError.
        """
        try:
            yield
        except (BecalmError, MemoryError):
            raise
        except Exception as cause:  # a damaged file can make a library raise any exception
            raise self.damage_error(cause) from cause

    def damage_error(self, cause: object) -> InputError:
        """Return the error that says that the file is damaged; `cause` is the reason."""
        reason = " ".join(str(cause).split())[:200] or type(cause).__name__
        return InputError(f"{self.path} is a damaged {self.name} file ({reason}); copy or download it again.")

    def no_rows_error(self) -> InputError:
        """Return the error that says that the file has no rows that can be read, and why."""
        if self.cut:
            return InputError(f"{self.path} is cut short, and no rows in it can be read; copy or download it again.")
        return InputError(f"{self.path} holds no channel with rows; two or more rows are needed.")

    def refuse_claim(self, wanted_bytes: int) -> None:
        """Refuse to unpack more bytes than a recording of this size can plausibly hold.

        Raises
        ------
        InputError
            If the file claims to hold far more than its size.
        """
        refuse_claim(self.path, wanted_bytes, file_bytes(self.path))

    def refuse_unpacking(self, more_bytes: int) -> None:
        """Add the size of another compressed part, and refuse it if the sum is implausible for a file of this size.

        Raises
        ------
        InputError
            If the parts claim to hold far more than the file's size.
        """
        self._unpacked += more_bytes
        if self._unpacked > _SMALL:
            self.refuse_claim(self._unpacked)


def file_bytes(path: Path) -> int:
    """Return the number of bytes of a file, or of a folder's files."""
    size = 0
    with suppress(OSError):  # reading the file explains the error
        for one in path.iterdir() if path.is_dir() else [path]:
            with suppress(OSError):
                size += one.stat().st_size
    return size


def refuse_claim(path: Path, wanted_bytes: int, size: int) -> None:
    """Refuse a file of `size` bytes that claims to hold implausibly many bytes.

    Raises
    ------
    InputError
        If `wanted_bytes` is more than 256 MiB and more than 200 times `size`.
    """
    if wanted_bytes > max(_SMALL, _MOST_RATIO * size):
        raise InputError(
            f"{path} claims to hold {wanted_bytes:,} bytes in a file of {size:,}; it is damaged, or made to fill the"
            " memory, and is not read."
        )
