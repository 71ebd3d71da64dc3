"""Collect the library's C sources for an export; only the file of array sizes is changed."""

from __future__ import annotations

import re
from pathlib import Path

from becalm import native
from becalm.export.channel.kind import Sizes
from becalm.export.shared_parts import FOLDER
from becalm.export.templates import render

_FILTER, _MODES = ("channel.c", "device.c", "filter.c"), ("device_modes.c", "imm.c")
_SIZES = "sizes.h"
OWN_NAMES = frozenset({"channel", "device", "device_modes", "filter", "filter_modes", "imm", "becalm"})
"""Prefixes of the functions and types of the library's C, which an export must not use."""

_LINKED = re.compile(r"^(?:void|int|int64_t|real) (\w+)\(", re.M)  # definitions of functions that are not static


def own_files() -> set[str]:
    """Return the names of all C sources and headers of the library."""
    return {path.name for path in Path(native.__file__).parent.glob("*.[ch]")}


def sources_of(sizes: Sizes, stem: str) -> dict[str, str]:
    """Return the texts of the C sources that some filters need, by their paths in a bundle; {} without filters.

    Parameters
    ----------
    sizes : Sizes
        Array sizes of the filters.
    stem : str
        Prefix of the names under which functions are linked, so that another export with other array sizes can be
        linked into the same program.
    """
    wanted = [*(_FILTER if sizes.states else ()), *(_MODES if sizes.mode_states else ())]
    texts = dict[str, str]()
    while wanted:
        name = wanted.pop()
        if name not in texts and name != _SIZES:
            texts[name] = (Path(native.__file__).parent / name).read_text(encoding="utf-8")
            wanted += re.findall(r'^#include "(.+)"', texts[name], re.M)
    if texts:
        names = sorted({name for text in texts.values() for name in _LINKED.findall(text)})
        context = {**sizes._asdict(), "most_states": sizes.most_states, "stem": stem, "names": names}
        texts[_SIZES] = render("sizes.h.jinja", context)
    return {f"{FOLDER}/{name}": text for name, text in sorted(texts.items())}
