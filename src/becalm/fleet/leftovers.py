"""Remove temporary files of killed tasks, at the end of a job, when no task is writing."""

from __future__ import annotations

import fnmatch
import os
import shutil
from contextlib import suppress
from pathlib import Path

from becalm.files.atomic_file import TEMPORARY_NAME
from becalm.fleet.pieces import STAGED


def remove_leftovers(output: Path) -> None:
    """Remove temporary files and staging folders from an output folder.

    Parameters
    ----------
    output : Path
        The output folder of a job whose tasks have all ended.
    """
    for folder, names, files in os.walk(output):  # files that vanish meanwhile do no harm
        for name in fnmatch.filter(names, STAGED):
            shutil.rmtree(Path(folder) / name, ignore_errors=True)
            names.remove(name)
        for name in filter(TEMPORARY_NAME.fullmatch, files):
            with suppress(OSError):
                (Path(folder) / name).unlink()
