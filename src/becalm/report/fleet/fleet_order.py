"""Sort the sensors of a fleet by how urgently they need attention, and summarise the fleet in a sentence."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import NamedTuple

from becalm.report.fleet.fleet_rows import FleetRow, counted, spaced

DOUBTFUL = 2.0
"""Largest factor by which a mean NIS may differ from 1; beyond it, sigma is wrong by a factor of more than 1.4."""

_LOST = re.compile(r"\b(?:clipped|stuck|dead|drifting)\b")  # the words that `faults_text` writes for `LOSSES`
_DIGITS = re.compile(r"([0-9]+)")


class Trait(NamedTuple):
    """A property that a row may have.

    Attributes
    ----------
    name, says : str
        The name, one or two words, and a sentence that explains the property.
    holds : callable
        Returns whether a row has the property.
    size : callable
        Returns how bad such a row is, from the row and its channel's usual noise. Larger is worse; NaN means unknown.
    """

    name: str
    says: str
    holds: Callable[[FleetRow], bool]
    size: Callable[[FleetRow, float], float]


def _number(value: float | None) -> float:
    """Return a number, or NaN for None."""
    return math.nan if value is None else value


def _wrong(row: FleetRow, usual: float = math.nan) -> float:
    """Return the absolute logarithm of the mean NIS, which is 0 if sigma is right; NaN if it is unknown."""
    nis = _number(row.health)
    return math.inf if nis == 0 else abs(math.log(nis)) if nis > 0 else math.nan


def _lost(row: FleetRow, usual: float = math.nan) -> float:
    """Return the share of readings that do not show the signal; NaN if it is unknown."""
    return 1 - _number(row.usable_share)


def _noisy(row: FleetRow, usual: float) -> float:
    """Return the logarithm of the ratio of a channel's noise to the usual noise; NaN if either is unknown."""
    noise_std = _number(row.noise_std)
    return math.log(noise_std) - math.log(usual) if 0 < noise_std < math.inf and usual > 0 else math.nan


TRAITS = (
    Trait("refused", "No output was written.", lambda row: row.state == "refused", lambda row, usual: 0.0),
    Trait("does not fit", "The model does not describe the signal.", lambda row: row.verdict == "does not fit", _wrong),
    Trait("faulty", "Clipped, stuck, drifting or dead for a while.", lambda row: bool(_LOST.search(row.faults)), _lost),
    Trait(
        "outlying",
        "Unlike the other sensors of its class.",
        lambda row: bool(row.outlying),
        lambda row, usual: abs(_noisy(row, usual)),
    ),
    Trait(
        "not judged",
        "Constant, or too few readings to judge.",
        lambda row: row.state != "refused" and row.verdict in ("", "constant", "untold"),
        _lost,
    ),
    Trait(
        "fits except",
        "The model describes the signal except in a narrow band of frequencies.",
        lambda row: row.verdict == "fits except",
        _wrong,
    ),
    Trait(
        "sigma doubtful",
        f"The mean NIS is not within a factor of {DOUBTFUL:g} of 1.",
        lambda row: _wrong(row) > math.log(DOUBTFUL),
        _wrong,
    ),
    Trait("fits", "The model describes the signal.", lambda row: row.verdict == "fits", _noisy),
    Trait("kept", "Finished before, and unchanged since.", lambda row: row.state == "kept", lambda row, usual: 0.0),
)
"""All properties, the worst first. Every row has at least one; a row with "kept" has at least one other."""


def badness(row: FleetRow, usual_noise_std: float = math.nan) -> tuple[int, float]:
    """Return a sort key for a row; the row with the smallest key needs attention first.

    The order is: refused, "does not fit" (mean NIS farthest from 1 first), faulty (most readings lost first),
    outlying (noise farthest from usual first), not judged, "fits except", doubtful sigma (mean NIS off by more than a
    factor of two), and "fits" (noisiest first).

    Parameters
    ----------
    row : FleetRow
        Row to judge; None or NaN means an unknown number.
    usual_noise_std : float, optional
        Usual noise of channels with this name and unit, from `usual_noise`, in that unit.

    Returns
    -------
    place : int
        Index in `TRAITS` of the row's worst property.
    goodness : float
        Order among rows with the same `place`: minus the `size` of the property, or inf if it is unknown; never NaN.
    """
    place, trait = next((place, trait) for place, trait in enumerate(TRAITS) if trait.holds(row))
    size = trait.size(row, usual_noise_std)
    return place, math.inf if math.isnan(size) else -size


def usual_noise(rows: Sequence[FleetRow]) -> Mapping[tuple[str, str], float]:
    """Return, by (name, unit), the median noise of all channels with this name and unit."""
    noises: dict[tuple[str, str], list[float]] = defaultdict(list)
    for row in rows:
        if 0 < _number(row.noise_std) < math.inf:
            noises[row.channel, row.unit].append(_number(row.noise_std))
    return {channel: median(noise) for channel, noise in noises.items()}


def worst_first(rows: Sequence[FleetRow]) -> list[FleetRow]:
    """Return the rows sorted, the most urgent first; equally urgent rows by name, with sensor 2 before sensor 10."""
    usual = usual_noise(rows)
    return sorted(rows, key=lambda row: (badness(row, usual.get((row.channel, row.unit), math.nan)), *_name_key(row)))


def _name_key(row: FleetRow) -> tuple[list[tuple[int, str]], str, str]:
    """Return a sort key for a row's names, in which digits count as numbers."""
    parts = enumerate(_DIGITS.split(row.sensor))  # text and digits alternate
    key = [(len(part.lstrip("0")), part.lstrip("0")) if place % 2 else (0, part) for place, part in parts]
    return key, row.sensor, row.channel


def summary(rows: Sequence[FleetRow], done: str = "cleaned") -> str:
    """Return a sentence with the number of finished sensors, and of those that need attention.

    A sensor is finished if none of its channels was refused. It counts as not fitting, faulty or outlying if at least
    one of its channels has this property.

    Parameters
    ----------
    rows : sequence of FleetRow
        A row for each channel of each sensor.
    done : str
        What was done to the sensors, as a participle: "cleaned" or "tuned".
    """
    if not rows:
        return "There is no sensor."
    sensors: dict[str, set[str]] = defaultdict(set)
    for row in rows:
        sensors[row.sensor].update(trait.name for trait in TRAITS if trait.holds(row))
    fine = [traits for traits in sensors.values() if "refused" not in traits]
    refused = len(sensors) - len(fine)
    remarks = ", ".join(filter(None, (_remark(fine, *words) for words in _REMARKS)))
    return (
        f"{spaced(len(fine))} of {counted(len(sensors), 'sensor is', 'sensors are')} {done}"
        + (f" ({remarks})" if remarks else "")
        + (f"; {counted(refused, 'is refused', 'are refused')}" if refused else "")
        + "."
    )


_REMARKS = (
    ("kept", "was finished before", "were finished before"),  # property, and words for one and for several sensors
    ("does not fit", "does not fit", "do not fit"),
    ("faulty", "is faulty", "are faulty"),
    ("outlying", "is outlying", "are outlying"),
)


def _remark(sensors: Sequence[set[str]], trait: str, one: str, several: str) -> str:
    """Return the number of sensors with a property, and its words; empty if there are no such sensors."""
    count = sum(trait in traits for traits in sensors)
    return counted(count, one, several) if count else ""
