"""Read a format with its own library: load the library when it is needed, and report its failures in sentences."""

from __future__ import annotations

import logging
from collections.abc import Container, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from warnings import catch_warnings, simplefilter

from becalm.errors import BecalmError, InputError

_SQUEEZED = 200  # as often as its own size no recording unpacks, for noise does not pack
_SMALL = 256 << 20  # bytes that may be claimed whatever the size


class Foreign:
    """A file of a format that another library reads.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        The format as people call it, "MF4".

    Attributes
    ----------
    cut : bool
        Whether its reader saw that the file ends too early.
    """

    def __init__(self, path: Path, name: str) -> None:
        self.path, self.name = path, name
        self._libraries: set[str] = set()
        self._unpacked = 0
        self.cut = False

    def library(self, module: str) -> ModuleType:
        """Load a library.

        Raises
        ------
        InputError
            If it is not installed.
        """
        self._libraries.add(module.partition(".")[0])
        try:
            return import_module(module)
        except ModuleNotFoundError as cause:
            raise InputError(
                f"{self.path} is {self.name}, which is read by {module.partition('.')[0]}; that is not here."
                " Type: pip install 'becalm[formats]'"
            ) from cause

    @contextmanager
    def damage_told(self) -> Iterator[None]:
        """Say in a sentence that the file is damaged, whatever a library raises of it, and keep its words away.

        Raises
        ------
        InputError
            If anything but an error of becalm's own is raised.
        """
        try:
            with catch_warnings(), _silent(self._libraries):
                simplefilter("ignore")
                yield
        except (BecalmError, MemoryError):
            raise
        except Exception as cause:  # a library's of a damaged file: of any kind
            raise self.damaged(cause) from cause

    def damaged(self, cause: object) -> InputError:
        """Return the error that says so."""
        reason = " ".join(str(cause).split())[:200] or type(cause).__name__
        return InputError(f"{self.path} is a damaged {self.name} file ({reason}); copy or download it again.")

    def holds_nothing(self) -> InputError:
        """Return the error that says that nothing can be read, and why."""
        if self.cut:
            return InputError(
                f"{self.path} is cut short, and nothing that is left can be read; copy or download it again."
            )
        return InputError(f"{self.path} holds no channel with rows; two or more rows are needed.")

    def refuse_claim(self, wanted_bytes: int) -> None:
        """Refuse to unpack what no recording of this size holds.

        Raises
        ------
        InputError
            If the file claims to hold so much more than its size.
        """
        parts = self.path.iterdir() if self.path.is_dir() else [self.path]
        refuse_claim(self.path, wanted_bytes, sum(part.stat().st_size for part in parts))

    def refuse_unpacking(self, more_bytes: int) -> None:
        """Refuse to unpack another part where all of them are what no recording of this size holds.

        Raises
        ------
        InputError
            If they are.
        """
        self._unpacked += more_bytes
        if self._unpacked > _SMALL:
            self.refuse_claim(self._unpacked)


def refuse_claim(path: Path, wanted_bytes: int, size: int) -> None:
    """Refuse what claims to hold so much more than its size, in bytes, as no recording does.

    Raises
    ------
    InputError
        If it does.
    """
    if wanted_bytes > max(_SMALL, _SQUEEZED * size):
        raise InputError(
            f"{path} claims to hold {wanted_bytes:,} bytes in a file of {size:,}; it is damaged, or made to fill the"
            " memory, and is not read."
        )


@contextmanager
def _silent(libraries: Container[str]) -> Iterator[None]:
    """Keep the loggers of libraries quiet, for what they say is said in notes and errors."""
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in libraries]
    talking = [logger for logger in map(logging.getLogger, names) if not logger.disabled]
    for logger in talking:
        logger.disabled = True
    try:
        yield
    finally:
        for logger in talking:
            logger.disabled = False
