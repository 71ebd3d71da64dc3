"""Write text files atomically, and check before a long computation whether its output can be written."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from becalm.errors import OutputError
from becalm.files.atomic_file import explain_write_errors, refuse_folder, replacing
from becalm.files.temporary_files import removed_afterwards


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
        If a file cannot be written.
    """
    make_folder(folder)
    paths = {folder / path: text for path, text in texts.items()}
    for parent in {path.parent for path in paths}:
        make_folder(parent)
    with ExitStack() as waiting:
        for path, text in paths.items():
            waiting.enter_context(staged_text(path, text))
