"""Store names of columns next to arrays, as names of arrays must be identifiers: `force (kN)` becomes `force_kN`."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from becalm.files.arrays.arrays import FileArrays
from becalm.files.groups import GROUP, START
from becalm.files.text.csv_header import unique_names

VARIABLES, NAMES, UNITS = "becalm_variables", "becalm_names", "becalm_units"
"""Names of lists in a file: the arrays, the names of their columns, and their units."""

NAME = "becalm.name"
"""Attribute of an array: the name of its column."""

FLAG = "becalm.flag"
"""Attribute of an array of whole numbers that are flags: 0 and 1 mean false and true."""

OF_TABLE = (GROUP, START)
"""Metadata that belong to one table, not to the file."""

_OWN = {VARIABLES, NAMES, UNITS, *(key.replace(".", "_") for key in OF_TABLE)}
_LONGEST = 50  # letters; MATLAB reads 63


def variables(names: Sequence[str]) -> tuple[str, ...]:
    """Return a distinct identifier for each name."""
    plain = [re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")[:_LONGEST] for name in names]
    return unique_names([one if re.match(r"[A-Za-z]", one) else f"c_{one}".rstrip("_") for one in plain])


def folder_name(group: str, taken: Collection[str]) -> str:
    """Return an identifier for a group that no other group has."""
    return variables((*taken, group))[-1]


def apply_labels(contents: FileArrays) -> None:
    """Give arrays the names and units from the lists that becalm wrote, and remove the lists."""
    for folder in [path[:-1] for path in contents.words if path[-1] == VARIABLES]:
        lists = [contents.words.pop((*folder, key), ()) for key in (VARIABLES, NAMES, UNITS)]
        if len({len(one) for one in lists}) == 1:
            for variable, name, unit in zip(*lists, strict=True):
                contents.words[(*folder, variable, NAME)] = (name,)
                contents.words[(*folder, variable, "unit")] = (unit,)
        for key in OF_TABLE:
            contents.words[(*folder, key)] = contents.words.pop((*folder, key.replace(".", "_")), ("",))
    contents.leaves = [leaf for leaf in contents.leaves if leaf.path[-1] not in _OWN]
