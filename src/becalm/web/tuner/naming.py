"""Make the names of saved files, and the command that writes the same files."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path

from becalm.files.registry import ENDINGS
from becalm.installation import typed

_FORMAT = re.compile(r"(\.(csv|txt|tsv|dat|log))?\.gz$|\.[^.]*$", re.IGNORECASE)
_UNTYPED = ("Cc", "Cf", "Cs")  # Unicode categories of characters that a terminal interprets, hides or cannot show


def stem_of(file: Path) -> str:
    """Return the name of a file without the ending of its format."""
    return _FORMAT.sub("", file.name) or "recording"


def command(file: Path, group: str | None) -> str:
    """Return the command that cleans a file; it must run in the folder that contains the file and the saved recipe.

    Parameters
    ----------
    file : Path
        Recording to clean.
    group : str or None
        Name of the time axis, for a file with several time axes.

    Returns
    -------
    str
        The command; "" if a name has characters that cannot be typed.
    """
    stem, suffix = stem_of(file), file.suffix if file.suffix in ENDINGS else ".csv"
    names = [file.name, f"{stem}-clean{suffix}", f"{stem}.recipe.toml"]
    read, written, recipe = (
        f"./{name}" if name.startswith("-") else name for name in names
    )  # a leading - would be an option
    words = ["becalm", "clean", read, "-o", written, "--recipe", recipe]
    command = typed(*words, *([] if group is None else ["--group", group]))
    return "" if any(unicodedata.category(letter) in _UNTYPED for letter in command) else command
