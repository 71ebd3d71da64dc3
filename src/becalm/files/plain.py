"""Text files, whole or not at all; and whether an output can be written, before the work is done."""

from __future__ import annotations

import os
from pathlib import Path
from typing import IO

from becalm.errors import OutputError
from becalm.files.registry import format_to_write
from becalm.files.writing import replace_file


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write text as UTF-8, under a temporary name first.

    Raises
    ------
    OutputError
        If it cannot be written; nothing is left behind.
    """
    target = Path(path)
    if target.is_dir():
        raise OutputError(f"{target} is a directory; give the path of a file in it.")

    def fill(file: IO[bytes]) -> None:
        file.write(text.encode("utf-8"))

    replace_file(target, fill)


def refuse_unwritable(path: str | os.PathLike[str], *others: str | os.PathLike[str]) -> None:
    """Raise what writing a table to `path`, or anything to the others, would raise for its ending or folder.

    Raises
    ------
    OutputError
        If the ending is not known, or a file cannot be made in the folder.
    """
    target = Path(path)
    format_to_write(target)
    for place in (target, *map(Path, others)):
        if place.is_dir():
            raise OutputError(f"{place} is a directory; give the path of a file in it.")
    probe = target.with_name(f".{target.name[:80]}.probe")
    replace_file(probe, lambda _: None)
    probe.unlink()
