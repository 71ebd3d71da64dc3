"""Write text files whole or not at all, and check whether an output can be written before the work is done."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from becalm.errors import OutputError
from becalm.files.atomic_file import refuse_folder, replacing, sentences
from becalm.files.temporary_files import in_waiting


def make_folder(path: Path) -> None:
    """Make a folder, and those that it is in; one that is there stays as it is.

    Raises
    ------
    OutputError
        If it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as cause:
        raise OutputError(f"The folder {path} cannot be made ({cause.strerror}); name another with -o.") from cause


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write text as UTF-8, under a temporary name first.

    Raises
    ------
    OutputError
        If it cannot be written; nothing is left behind.
    """
    with text_in_waiting(path, text):
        pass


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write bytes, under a temporary name first.

    Raises
    ------
    OutputError
        If they cannot be written; nothing is left behind.
    """
    with replacing(Path(path)) as file, sentences(Path(path)):
        file.write(content)


@contextmanager
def text_in_waiting(path: str | os.PathLike[str], text: str) -> Iterator[None]:
    """Write text as UTF-8 under a temporary name; it gets its own at the end, if nothing was raised until then.

    Parameters
    ----------
    path : path-like
        Where to; an older file of that name is replaced.
    text : str
        What to write.

    Raises
    ------
    OutputError
        If it cannot be written; nothing is left behind.
    """
    target = Path(path)
    refuse_folder(target)
    with replacing(target) as file:
        with sentences(target):
            file.write(text.encode("utf-8"))
            file.flush()
            os.fsync(file.fileno())
        yield


def refuse_unwritable(*paths: str | os.PathLike[str]) -> None:
    """Raise what writing files of these names would raise for their names or folders.

    Raises
    ------
    OutputError
        If no file can have such a name, or none can be made in the folder.
    """
    targets = [Path(path) for path in paths]
    for target in targets:
        refuse_folder(target)
    for target in {target.parent: target for target in reversed(targets)}.values():
        probe = target.parent / f".becalm.{secrets.token_hex(4)}.probe"
        with in_waiting(probe), sentences(target):
            probe.touch(exist_ok=False)


def write_folder(folder: Path, texts: Mapping[str, str]) -> None:
    """Write texts as UTF-8 into a folder, by their paths in it; all are there, or, of a new folder, none.

    Parameters
    ----------
    folder : Path
        Where to; files of these names in it are replaced, others stay.
    texts : mapping of str to str
        By their paths, with `/` between folders.

    Raises
    ------
    OutputError
        If one cannot be written.
    """
    make_folder(folder)
    paths = {folder / path: text for path, text in texts.items()}
    for parent in {path.parent for path in paths}:
        make_folder(parent)
    with ExitStack() as waiting:
        for path, text in paths.items():
            waiting.enter_context(text_in_waiting(path, text))
