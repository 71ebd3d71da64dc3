"""The mark that a fleet's job writes beside a sensor's output when all of it is there: which files it is made of."""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath

from becalm.errors import InputError
from becalm.files.decoding import told

MARK = "becalm.json"
"""Ends its name: `_becalm.json` in the folder of a sensor, or `_NAME.becalm.json` of one that is one file."""

NAME = f"_{MARK}"
"""The mark of a folder."""

FILES = "files"
"""What lists them in it, by their paths from there."""


def marked_files(root: Path) -> set[tuple[str, ...]]:
    """Return the files of a finished output, each as the parts of its path from its folder.

    Parameters
    ----------
    root : Path
        The folder that the mark is in.

    Raises
    ------
    InputError
        If the mark is damaged.
    """
    mark = root / NAME
    with told(mark):
        text = mark.read_bytes()
    try:
        return {PurePosixPath(name).parts for name in json.loads(text)[FILES]}
    except (ValueError, TypeError, KeyError) as cause:
        raise InputError(f"{mark} is damaged: it does not list the files of its folder; clean them again.") from cause
