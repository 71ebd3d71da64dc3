"""Read the mark that a fleet job writes next to the complete output of a sensor; it lists the output's files."""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath

from becalm.errors import InputError
from becalm.files.decoding import explain_read_errors

MARK = "becalm.json"
"""The end of a mark's name: `_becalm.json` in the folder of a sensor, `_NAME.becalm.json` next to a single file."""

NAME = f"_{MARK}"
"""The mark of a folder."""

FILES = "files"
"""The key of the list of files in a mark; paths are relative to the mark's folder."""


def marked_files(root: Path) -> set[tuple[str, ...]]:
    """Return the files of a complete output, each as the parts of its path from `root`.

    Parameters
    ----------
    root : Path
        The folder of the mark.

    Raises
    ------
    InputError
        If the mark is damaged.
    """
    mark = root / NAME
    with explain_read_errors(mark):
        text = mark.read_bytes()
    try:
        return {PurePosixPath(name).parts for name in json.loads(text)[FILES]}
    except (ValueError, TypeError, KeyError) as cause:
        raise InputError(f"{mark} is damaged: it does not list the files of its folder; clean them again.") from cause
