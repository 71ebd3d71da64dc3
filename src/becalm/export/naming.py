"""Make C names from the names of a recording and its channels."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

_FILES = re.compile(
    "main|becalm|counting|startup"
    "|assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal"
    "|stdarg|stdbool|stddef|stdint|stdio|stdlib|string|tgmath|time|wchar|wctype"
)
"""Names that no file of a filter may have: other files of a bundle, and headers of C99, which it would hide."""

_LONGEST = 40  # characters of a name


def identifier(text: str, otherwise: str) -> str:
    """Return a valid C name close to a text; accents are dropped, other characters become `_`.

    The name may be a C keyword, since every use adds an ending; it may also name a file. `otherwise` replaces an empty
    name, and precedes one that begins with a digit or is in `_FILES`.
    """
    plain = unicodedata.normalize("NFKD", text.replace("µ", "u")).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_").lower()[:_LONGEST].rstrip("_")
    if not name:
        return otherwise
    return f"_{name}".replace("_", f"{otherwise}_", 1) if name[0].isdigit() or _FILES.fullmatch(name) else name


def identifiers(texts: Iterable[str], otherwise: str) -> list[str]:
    """Return a unique C name for each text; numbers are appended to equal names, and to `otherwise`."""
    taken: list[str] = []
    for number, text in enumerate(texts):
        wanted = name = identifier(text, f"{otherwise}_{number + 1}")
        again = 2
        while name in taken:
            name, again = f"{wanted}_{again}", again + 1
        taken.append(name)
    return taken


def comment(text: str) -> str:
    """Return text on one line that is safe in a C comment: it cannot end the comment, and has no trigraph."""
    whole = re.sub(r"\?(?=\?)", "? ", text)
    return " ".join(whole.replace("*/", "* /").replace("/*", "/ *").split())
