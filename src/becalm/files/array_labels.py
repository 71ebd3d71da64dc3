"""Names of columns beside arrays whose own names cannot be such: `force (kN)` is kept as `force_kN`."""

from __future__ import annotations

import re
from collections.abc import Sequence

from becalm.files.arrays import Found
from becalm.files.csv_header import unique_names

VARIABLES, NAMES, UNITS = "becalm_variables", "becalm_names", "becalm_units"
"""Lists in a file: arrays, the columns that they hold, and their units."""

NAME = "becalm.name"
"""Of an array, the column that it holds."""

FLAG = "becalm.flag"
"""Of an array of whole numbers, that they are true and false."""

_LONGEST = 50  # letters; MATLAB reads 63


def variables(names: Sequence[str]) -> tuple[str, ...]:
    """Return an identifier for each name, all different."""
    plain = [re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")[:_LONGEST] for name in names]
    return unique_names([one if re.match(r"[A-Za-z]", one) else f"c_{one}".rstrip("_") for one in plain])


def take_labels(found: Found) -> None:
    """Give arrays the names and units that becalm wrote beside them, and forget the lists."""
    lists = [found.words.pop((key,), ()) for key in (VARIABLES, NAMES, UNITS)]
    found.leaves = [leaf for leaf in found.leaves if leaf.path not in {(VARIABLES,), (NAMES,), (UNITS,)}]
    if len({len(one) for one in lists}) == 1:
        for variable, name, unit in zip(*lists, strict=True):
            found.words[(variable, NAME)], found.words[(variable, "unit")] = (name,), (unit,)
