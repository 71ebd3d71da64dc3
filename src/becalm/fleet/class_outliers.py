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
from becalm.report.fleet.fleet_rows import FleetRow

FEWEST = 8
"""Smallest class, in sensors, that can have outliers; a smaller class does not show its usual spread."""

FACTOR = 1.5
"""Smallest ratio of a size to the median of its class, or the inverse ratio, that is reported."""

SPREADS = 5.0
"""Smallest distance of a size's logarithm from the median of its class that is reported, in robust sigmas."""

_ROBUST = 1.4826  # standard deviation / median absolute deviation of a normal distribution


def class_of(sensor: str) -> str:
    """Return the name of a sensor's class: the folder above the sensor. The recipe of the class has the same name.

    Parameters
    ----------
    sensor : str
        The sensor's path within the lake. `kind=pump/sensor=17` has the class `kind=pump`; `sensor=17` has `DEFAULT`.
    """
    folder = str(PurePosixPath(sensor).parent)
    return DEFAULT if folder == "." else folder


def factors_apart(sizes: Sequence[float]) -> list[float | None]:
    """Return, for each size, its ratio to the median if it is an outlier, else None.

    Parameters
    ----------
    sizes : sequence of float
        Standard deviations, or other sizes in one unit, one for each sensor of a class. Sizes that are not positive and
        finite are ignored; their result is None.

    Notes
    -----
    A size is an outlier if two conditions hold. Its logarithm differs from the median by more than `SPREADS` robust
    standard deviations, which come from the median absolute deviation. And its ratio to the median, or the inverse
    ratio, exceeds `FACTOR`. A class with fewer than `FEWEST` usable sizes has no outliers.
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
    """Return the robust standard deviation of values, given their differences from the median (n,)."""
    return _ROBUST * float(np.median(np.abs(apart)))


def mark_outliers(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Return the outcomes; each row whose channel is an outlier of its class gets a remark in `outlying`.

    Channels of the same class, name, unit and recipe are compared by the root mean square (RMS) of their normalised
    innovations. A channel whose noise or motion differs from that of the others has a different RMS.
    """
    reasons = _reasons([row for outcome in outcomes for row in outcome.channels])
    return [replace(outcome, channels=_with(outcome.channels, reasons)) for outcome in outcomes]


def _with(rows: Sequence[FleetRow], reasons: Mapping[tuple[str, str], str]) -> tuple[FleetRow, ...]:
    return tuple(replace(row, outlying=reasons.get((row.sensor, row.channel), "")) for row in rows)


def _reasons(rows: Sequence[FleetRow]) -> dict[tuple[str, str], str]:
    """Return, by sensor and channel, a sentence on each outlier."""
    alike: dict[tuple[str, ...], list[FleetRow]] = defaultdict(list)
    for row in rows:
        if row.health is not None and row.verdict not in ("", "constant", "untold"):
            alike[class_of(row.sensor), row.channel, row.unit, row.recipe].append(row)
    reasons = {}
    for group in alike.values():
        factors = factors_apart([math.sqrt(row.health or 0.0) for row in group])
        for row, factor in zip(group, factors, strict=True):
            if factor is not None:
                reasons[row.sensor, row.channel] = _by_innovations(factor)
    return reasons


def _by_innovations(factor: float) -> str:
    how = "it is noisier, or moves more" if factor > 1 else "it is quieter, or moves less"
    return f"Its innovations are {times(factor)} those of its class with the same recipe: {how}."


def times(factor: float) -> str:
    """Format a factor for a sentence: "0.31 times", "3.2 times", "610 times"."""
    return f"{factor:.0f} times" if 99.5 <= factor < 1e6 else f"{factor:.2g} times"
