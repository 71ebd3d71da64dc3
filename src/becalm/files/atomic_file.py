"""Write a file under a temporary name, and rename it once it is safely on disk."""

from __future__ import annotations

import errno
import os
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

import pyarrow as pa

from becalm.errors import OutputError
from becalm.files.temporary_files import in_waiting

UNNAMED = re.compile(r"\..*\.[0-9a-f]{8}\.part", re.DOTALL)
"""Names of files that have none of their own yet."""

_LONGEST_SHOWN = 60  # letters of a name


def replace_file(path: Path, fill: Callable[[IO[bytes]], None]) -> None:
    """Write a file under a temporary name in the same folder, and rename it when it is safely on disk.

    Raises
    ------
    OutputError
        If that fails; the temporary file is removed.
    """
    with replacing(path) as file, sentences(path):
        fill(file)


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Give a file to fill that takes the place of `path` at the end, if nothing was raised until then.

    Raises
    ------
    OutputError
        If it cannot be made or finished; the temporary file is removed.
    """
    target = path.resolve()
    temporary = target.with_name(f".{target.name[:80]}.{secrets.token_hex(4)}.part")
    with in_waiting(temporary):
        with sentences(path):
            file = temporary.open("x+b")
        try:
            yield file
            with sentences(path):
                file.flush()
                os.fsync(file.fileno())
                file.close()
        finally:
            with suppress(OSError):  # what is left to write has no place, and is not wanted
                file.close()
        with sentences(path):
            temporary.replace(target)
            sync_folder(target.parent)


def refuse_folder(path: Path) -> None:
    """Refuse a path that is a folder, or that no file can have.

    Raises
    ------
    OutputError
        If it is such a path.
    """
    with sentences(path):
        if path.is_dir():
            raise OutputError(f"{path} is a directory; give the path of a file in it.")


@contextmanager
def sentences(path: Path) -> Iterator[None]:
    """Say in a sentence why `path` cannot be written.

    Raises
    ------
    OutputError
        In the place of what the system or the table library raises.
    """
    try:
        yield
    except OSError as cause:
        raise OutputError(_why_not(path, cause)) from cause
    except pa.ArrowException as cause:
        raise OutputError(f"{path} cannot be written: {' '.join(str(cause).split())[:200]}.") from cause


def sync_folder(folder: Path) -> None:
    """Make the new name last through a power cut, where the system can."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError:  # some network folders cannot; the file itself is safe
        return
    finally:
        os.close(handle)


def _why_not(path: Path, cause: OSError) -> str:
    folder = path.parent
    name = path.name if len(path.name) <= _LONGEST_SHOWN else f"{path.name[:_LONGEST_SHOWN]}..."
    sentences = {
        errno.ENOSPC: f"The disk of {folder} is full; make room or write elsewhere.",
        errno.EDQUOT: f"Your quota on the disk of {folder} is used up; make room or write elsewhere.",
        errno.EACCES: f"{folder} may not be written to; choose another folder with -o.",
        errno.EPERM: f"{folder} may not be written to; choose another folder with -o.",
        errno.EROFS: f"{folder} is on a read-only disk; choose another folder with -o.",
        errno.ENOENT: f"The folder {folder} does not exist; make it first (`mkdir -p {folder}`).",
        errno.ENOTDIR: f"{folder} is a file, not a folder; choose another path with -o.",
        errno.EISDIR: f"{path} is a directory; give the path of a file in it.",
        errno.ENAMETOOLONG: f"The name {name} is too long; choose a shorter one.",
    }
    text = sentences.get(cause.errno or 0, f"{path} cannot be written: {cause.strerror or cause}.")
    return f"{text} {name} was not written."
