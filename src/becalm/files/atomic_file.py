"""Write a file under a temporary name, and rename it once it is safely on disk."""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

import pyarrow as pa

from becalm.errors import OutputError

# Keep a list of the temporary files of this process, so that they are removed even if it ends early.

_registered: dict[Path, IO[bytes] | None] = {}  # with the open file, if this process has opened it


@contextmanager
def removed_afterwards(path: Path) -> Iterator[None]:
    """Register a temporary file or folder; at the end of the block, remove it if it still has this name."""
    _registered[path] = None
    try:
        yield
    finally:
        _remove(path)
        _registered.pop(path, None)


def abandon() -> None:
    """Remove all registered temporary files; called before the process ends without unwinding."""
    for path, file in tuple(_registered.items()):
        if file is not None:
            with suppress(OSError, ValueError):  # Windows removes no open file; close() could wait for a lock
                os.close(file.fileno())
        _remove(path)


def _remove(path: Path) -> None:
    try:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    except OSError:  # the folder is missing or not writable, so the file was never created
        return


TEMPORARY_NAME = re.compile(r"\..*\.[0-9a-f]{8}\.part", re.DOTALL)
"""A pattern that matches the temporary names of files that are being written."""

_OPEN_ELSEWHERE = (5, 32)  # errors of Windows: access denied, sharing violation
_LONGEST_SHOWN = 60  # characters of a file name in a message


def replace_file(path: Path, fill: Callable[[IO[bytes]], None]) -> None:
    """Write a file under a temporary name in the same folder, and rename it when it is safely on disk.

    Parameters
    ----------
    path : Path
        The file; an older file of that name is replaced.
    fill : callable
        Writes the content to an open binary file.

    Raises
    ------
    OutputError
        If writing or renaming fails; the temporary file is removed.
    """
    with replacing(path) as file, explain_write_errors(path):
        fill(file)


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Yield an open temporary file; at the end of the block, rename it to `path` unless an exception was raised.

    Raises
    ------
    OutputError
        If the file cannot be created, written or renamed; the temporary file is removed.
    """
    target = path.resolve()
    temporary = target.with_name(f".{target.name[:80]}.{secrets.token_hex(4)}.part")
    with removed_afterwards(temporary):
        with explain_write_errors(path):
            file = temporary.open("x+b")
        _registered[temporary] = file
        try:
            yield file
            with explain_write_errors(path):
                file.flush()
                os.fsync(file.fileno())
                file.close()
        finally:
            with suppress(OSError):  # after a failure the file is removed, so an error on closing does not matter
                file.close()
        with explain_write_errors(path):
            temporary.replace(target)
            sync_folder(target.parent)


def refuse_folder(path: Path) -> None:
    """Refuse an output path that is a directory or not a valid file name.

    Raises
    ------
    OutputError
        If the path is a directory, or the system does not accept it.
    """
    with explain_write_errors(path):
        if path.is_dir():
            raise OutputError(f"{path} is a directory; give the path of a file in it.")


@contextmanager
def explain_write_errors(path: Path) -> Iterator[None]:
    """Turn errors of the system and of pyarrow into an OutputError that explains why `path` cannot be written.

    Raises
    ------
    OutputError
        Instead of an `OSError` or a `pyarrow.ArrowException`.
    """
    try:
        yield
    except OSError as cause:
        raise OutputError(_why_not(path, cause)) from cause
    except pa.ArrowException as cause:
        raise OutputError(f"{path} cannot be written: {' '.join(str(cause).split())[:200]}.") from cause


def sync_folder(folder: Path) -> None:
    """Write a folder's entries to disk, so that a renamed file survives a power cut; POSIX systems only."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError:  # some network folders do not support it; the file's content is on disk already
        return
    finally:
        os.close(handle)


def _why_not(path: Path, cause: OSError) -> str:
    folder = path.parent
    if getattr(cause, "winerror", None) in _OPEN_ELSEWHERE and path.is_file():
        return f"{path} is open in another program; close it there, or choose another name with -o. It was not written."
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


# Write text files atomically, and check before a long computation whether its output can be written.


def make_folder(path: Path) -> None:
    """Make a folder and its parents; an existing folder is not changed.

    Raises
    ------
    OutputError
        If the folder cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as cause:
        raise OutputError(f"The folder {path} cannot be made ({cause.strerror}); name another with -o.") from cause


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write text as UTF-8 under a temporary name, then rename the file.

    Raises
    ------
    OutputError
        If the file cannot be written; the temporary file is removed.
    """
    with staged_text(path, text):
        pass


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write bytes under a temporary name, then rename the file.

    Raises
    ------
    OutputError
        If the file cannot be written; the temporary file is removed.
    """
    with replacing(Path(path)) as file, explain_write_errors(Path(path)):
        file.write(content)


@contextmanager
def staged_text(path: str | os.PathLike[str], text: str) -> Iterator[None]:
    """Write text as UTF-8 under a temporary name; at the end of the block, rename it unless an exception was raised.

    Parameters
    ----------
    path : path-like
        The file; an older file of that name is replaced.
    text : str
        The content.

    Raises
    ------
    OutputError
        If the file cannot be written; the temporary file is removed.
    """
    target = Path(path)
    refuse_folder(target)
    with replacing(target) as file:
        with explain_write_errors(target):
            file.write(text.encode("utf-8"))
            file.flush()
            os.fsync(file.fileno())
        yield


def refuse_unwritable(*paths: str | os.PathLike[str]) -> None:
    """Refuse output paths that cannot be written, by creating and removing an empty file in each folder.

    Raises
    ------
    OutputError
        If a name is not a valid file name, or no file can be created in its folder.
    """
    targets = [Path(path) for path in paths]
    for target in targets:
        refuse_folder(target)
    for target in {target.parent: target for target in reversed(targets)}.values():
        probe = target.parent / f".becalm.{secrets.token_hex(4)}.probe"
        with removed_afterwards(probe), explain_write_errors(target):
            probe.touch(exist_ok=False)


def write_folder(folder: Path, texts: Mapping[str, str]) -> None:
    """Write several texts as UTF-8 into a folder; the files get their names only once all are written.

    Parameters
    ----------
    folder : Path
        The folder; files of these names in it are replaced, others are not changed.
    texts : mapping of str to str
        Texts by their paths in the folder, with `/` between the parts of a path.

    Raises
    ------
    OutputError
        If a folder cannot be made, or a file cannot be written.
    """
    make_folder(folder)
    paths = {folder / path: text for path, text in texts.items()}
    for parent in {path.parent for path in paths}:
        make_folder(parent)
    with ExitStack() as waiting:
        for path, text in paths.items():
            waiting.enter_context(staged_text(path, text))
