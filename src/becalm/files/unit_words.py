"""Decide whether a text is a unit: `um/m`, `counts` and `degrees C` are, `raw`, `out` and `+0100` are not."""

from __future__ import annotations

import re
from functools import cache

from becalm.files.unit_definitions import DEFINITIONS

_OTHERS = (
    *("dB", "dBA", "dBm", "dBV", "dBFS", "pH", "bpm", "RH", "FS", "ADC", "adu", "inHg", "mmHg", "inH", "mmH", "cmH"),
    *("VDC", "VAC", "Vdc", "Vac", "Vrms", "Vpp", "grms", "gRMS", "RMS", "rms", "pk", "peak", "O", "Ah", "Wh", "VA"),
    *("var", "VAR", "Nm", "Ncm", "Nmm", "Deg", "gal", "lbs", "oz", "ksi", "ustrain", "mps", "kph", "kmh", "C", "F"),
    *("psig", "psia", "sample", "samples"),
)
"""Parts of units that becalm recognises but does not convert."""

_LONG = 4  # letters; a word of this length or longer is also a unit in lower case and in the plural
_MARKS = re.compile(r"[\s*/^().\-+\d%\[\]]*")
_WORDS = re.compile(r"[A-Za-z_]+")


def is_unit(text: str) -> bool:
    """Return whether each word of a text is a unit.

    Parameters
    ----------
    text : str
        The text in the brackets of a header, normalised by `tidy_unit`.
    """
    words = _WORDS.findall(text)
    if not words:
        return text in ("", "%")
    return _MARKS.fullmatch(_WORDS.sub("", text)) is not None and all(map(_is_known, words))


def _is_known(word: str) -> bool:
    units, prefixes = _names()
    spelt = [word, *([word.lower(), word.lower().removesuffix("s")] if len(word) >= _LONG else [])]
    if word == "sqrt" or any(one in units for one in spelt):
        return True
    return any(one.removeprefix(prefix) in units for one in spelt for prefix in prefixes if one.startswith(prefix))


@cache
def _names() -> tuple[frozenset[str], frozenset[str]]:
    """Return the names of all units, and of all prefixes."""
    units, prefixes = set(_OTHERS), set()
    for definition in DEFINITIONS:
        name, _, *aliases = (part.strip() for part in re.sub(r";[^=]*", "", definition).split("="))
        named = {name, *aliases}
        if name.endswith("-"):
            prefixes |= {one.removesuffix("-") for one in named}
        else:
            units |= {*named, *(one.lower() for one in named if len(one) >= _LONG)}
    return frozenset(units), frozenset(prefixes)
