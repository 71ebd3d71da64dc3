"""What killed tasks left behind goes when a job is done: then nobody writes any more."""

from __future__ import annotations

import fnmatch
import os
import shutil
from contextlib import suppress
from pathlib import Path

from becalm.files.atomic_file import UNNAMED
from becalm.fleet.pieces import STAGED


def swept(output: Path) -> None:
    """Remove what never got its name, files and folders of them.

    Parameters
    ----------
    output : Path
        Of a job that nobody works on any more.
    """
    for folder, names, files in os.walk(output):  # what goes meanwhile is no matter
        for name in fnmatch.filter(names, STAGED):
            shutil.rmtree(Path(folder) / name, ignore_errors=True)
            names.remove(name)
        for name in filter(UNNAMED.fullmatch, files):
            with suppress(OSError):
                (Path(folder) / name).unlink()
