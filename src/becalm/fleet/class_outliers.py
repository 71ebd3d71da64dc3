"""Find sensors that differ from their class by more than chance and the spread of the class explain."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import PurePosixPath

import numpy as np

from becalm.core.arrays import Floats
from becalm.fleet.outcome import Outcome
from becalm.fleet.recipes import DEFAULT
from becalm.report.fleet_rows import FleetRow

FEWEST = 8
"""Sensors of a class: fewer do not tell how much they differ by themselves."""

FACTOR = 1.5
"""By which a standard deviation differs at least: less is of no account, however alike the others are."""

SPREADS = 5.0
"""Robust standard deviations of the logarithms in a class, by which one differs at least."""

_ROBUST = 1.4826  # standard deviations in a median distance from the median, of a normal law


def class_of(sensor: str) -> str:
    """Return the class of a sensor: the folder that it is in, by whose name its recipe is looked up too.

    Parameters
    ----------
    sensor : str
        Its path within the lake; `kind=pump/sensor=17` is of the class `kind=pump`, `sensor=17` of `DEFAULT`.
    """
    folder = str(PurePosixPath(sensor).parent)
    return DEFAULT if folder == "." else folder


def factors_apart(sizes: Sequence[float]) -> list[float | None]:
    """Return of each that is unlike the rest how many times the median it is; None for those that are alike.

    Parameters
    ----------
    sizes : sequence of float
        Standard deviations, or what else is compared by its logarithm, one a sensor of a class; what is no positive
        number neither counts nor is told of.

    Notes
    -----
    It is unlike where its logarithm lies `SPREADS` robust standard deviations, by the median distance from the median,
    and `FACTOR` from the median of the class. Of a class of fewer than `FEWEST` nothing is told.
    """
    logs = np.array([math.log(size) if 0 < size < math.inf else math.nan for size in sizes])
    known = logs[np.isfinite(logs)]
    if len(known) < FEWEST:
        return [None] * len(logs)
    middle = float(np.median(known))
    apart = logs - middle
    least = max(math.log(FACTOR), SPREADS * _spread(known - middle))
    return [math.exp(one) if abs(one) > least else None for one in apart.tolist()]


def _spread(apart: Floats) -> float:
    """Return the standard deviation of most of these distances from their median (n,)."""
    return _ROBUST * float(np.median(np.abs(apart)))


def marked(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Return outcomes of cleaning whose rows say where a channel is unlike those of its class.

    All sensors of a class are compared whose channel of a name had the same recipe: their noise, as far as it is not
    the recipe's, is told by the mean square of the innovations, whose root is compared.
    """
    reasons = _reasons([row for outcome in outcomes for row in outcome.channels])
    return [replace(outcome, channels=_with(outcome.channels, reasons)) for outcome in outcomes]


def _with(rows: Sequence[FleetRow], reasons: Mapping[tuple[str, str], str]) -> tuple[FleetRow, ...]:
    return tuple(replace(row, outlying=reasons.get((row.sensor, row.channel), "")) for row in rows)


def _reasons(rows: Sequence[FleetRow]) -> dict[tuple[str, str], str]:
    """Say of sensors and channels that are unlike others why."""
    alike: dict[tuple[str, ...], list[FleetRow]] = defaultdict(list)
    for row in rows:
        if row.health is not None and row.verdict not in ("", "constant", "untold"):
            alike[class_of(row.sensor), row.channel, row.unit, row.recipe].append(row)
    told = {}
    for group in alike.values():
        factors = factors_apart([math.sqrt(row.health or 0.0) for row in group])
        for row, factor in zip(group, factors, strict=True):
            if factor is not None:
                told[row.sensor, row.channel] = _by_innovations(factor)
    return told


def _by_innovations(factor: float) -> str:
    how = "it is noisier, or moves more" if factor > 1 else "it is quieter, or moves less"
    return f"Its innovations are {times(factor)} those of its class, by the same recipe: {how}."


def times(factor: float) -> str:
    """Say a factor as people write it: "0.31 times", "3.2 times", "610 times"."""
    return f"{factor:.0f} times" if 99.5 <= factor < 1e6 else f"{factor:.2g} times"
