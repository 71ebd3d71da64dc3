"""What is saved is called after the file it is of; and what to type for the same."""

from __future__ import annotations

import re
import shlex
import unicodedata
from pathlib import Path

from becalm.files.registry import ENDINGS

_FORMAT = re.compile(r"(\.(csv|txt|tsv|dat|log))?\.gz$|\.[^.]*$", re.IGNORECASE)
_UNTYPED = ("Cc", "Cf", "Cs")  # a terminal obeys these, hides them, or has no letters for them


def stem_of(file: Path) -> str:
    """Return the name of a file without what tells its format."""
    return _FORMAT.sub("", file.name) or "recording"


def command(file: Path, group: str | None) -> str:
    """Return what to type in a file's folder to clean it, once its recipe is saved there.

    Parameters
    ----------
    file : Path
        The file.
    group : str or None
        Of a file with channels at several times, which of them.

    Returns
    -------
    str
        "" where a name cannot be typed.
    """
    stem, suffix = stem_of(file), file.suffix if file.suffix in ENDINGS else ".csv"
    names = [file.name, f"{stem}-clean{suffix}", f"{stem}.recipe.toml"]
    read, written, recipe = (f"./{name}" if name.startswith("-") else name for name in names)  # - begins an option
    words = ["becalm", "clean", read, "-o", written, "--recipe", recipe]
    typed = shlex.join([*words, *([] if group is None else ["--group", group])])
    return "" if any(unicodedata.category(letter) in _UNTYPED for letter in typed) else typed
