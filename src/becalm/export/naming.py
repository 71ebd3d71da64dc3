"""Make C names from the names of a recording and its channels."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

_FILES = re.compile(
    "main|becalm|counting|startup"
    "|assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal"
    "|stdarg|stdbool|stddef|stdint|stdio|stdlib|string|tgmath|time|wchar|wctype"
    r"|con|prn|aux|nul|com\d|lpt\d"
)
"""Names that a file of filters must not have: those of a bundle's other files, of C99 headers, which the file would
hide, and of Windows devices."""

_LONGEST = 40  # largest number of characters of a name


def identifier(text: str, otherwise: str) -> str:
    """Return a valid C name close to a text; accents are removed, all other invalid characters become `_`.

    The name may be a C keyword, because a suffix is always added; it may also be used as a file name. `otherwise`
    replaces an empty name, and is the prefix of a name that begins with a digit or is in `_FILES`.
    """
    plain = unicodedata.normalize("NFKD", text.replace("µ", "u")).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_").lower()[:_LONGEST].rstrip("_")
    if not name:
        return otherwise
    return f"_{name}".replace("_", f"{otherwise}_", 1) if name[0].isdigit() or _FILES.fullmatch(name) else name


def identifiers(texts: Iterable[str], otherwise: str) -> list[str]:
    """Return a unique C name for each text; a number is appended to a repeated name, and to `otherwise`."""
    names: list[str] = []
    for number, text in enumerate(texts):
        wanted = name = identifier(text, f"{otherwise}_{number + 1}")
        suffix = 2
        while name in names:
            name, suffix = f"{wanted}_{suffix}", suffix + 1
        names.append(name)
    return names


def comment(text: str) -> str:
    """Return a text on one line that is safe in a C comment: it contains neither comment marks nor trigraphs."""
    whole = re.sub(r"\?(?=\?)", "? ", text)
    return " ".join(whole.replace("*/", "* /").replace("/*", "/ *").split())
