"""Which sensors of a fleet are to be looked at first, and the whole of it in a sentence."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import NamedTuple

from becalm.report.fleet_rows import FleetRow, counted, spaced

DOUBTFUL = 2.0
"""Factor by which a mean NIS may differ from 1: beyond it sigma is more than 1.4 times too small or too large."""

_LOST = re.compile(r"\b(?:clipped|stuck|dead|drifting)\b")  # as `faults_told` calls `LOSSES`
_DIGITS = re.compile(r"([0-9]+)")


class Trait(NamedTuple):
    """What may be true of a row.

    Attributes
    ----------
    name, says : str
        In a word or two, and in a sentence.
    holds : callable
        Tells of a row whether it is true.
    size : callable
        Tells of such a row, and the usual noise of its channel, how bad it is: larger is worse, NaN unknown.
    """

    name: str
    says: str
    holds: Callable[[FleetRow], bool]
    size: Callable[[FleetRow, float], float]


def _known(value: float | None) -> float:
    """Return a number; NaN where there is none."""
    return math.nan if value is None else value


def _wrong(row: FleetRow, usual: float = math.nan) -> float:
    """Return by which factor the mean NIS is wrong, as a logarithm."""
    nis = _known(row.health)
    return math.inf if nis == 0 else abs(math.log(nis)) if nis > 0 else math.nan


def _lost(row: FleetRow, usual: float = math.nan) -> float:
    """Return the share of the readings that tell nothing."""
    return 1 - _known(row.usable_share)


def _noisy(row: FleetRow, usual: float) -> float:
    """Return by which factor a channel is noisier than usual, as a logarithm."""
    noise_std = _known(row.noise_std)
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
        "The model describes the signal but for a narrow band of frequencies.",
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
"""What may be true of a row, the worst first; of any row at least one is, and "kept" never alone."""


def badness(row: FleetRow, usual_noise_std: float = math.nan) -> tuple[int, float]:
    """Return how soon a row is to be looked at: what is less comes sooner.

    Refused comes first, then what does not fit (mean NIS farthest from 1 first), is faulty (most readings lost first),
    outlying (noise most unlike the usual first), not judged, "fits except", has a doubtful sigma (mean NIS beyond a
    factor of two), and last what fits (noisiest first).

    Parameters
    ----------
    row : FleetRow
        What is None or NaN in it is unknown.
    usual_noise_std : float, optional
        Of channels like it, as `usual_noise` tells it, in unit.

    Returns
    -------
    place : int
        In `TRAITS`, of the worst that is true of it.
    goodness : float
        Beside others of that place; unknown ones come last. Never NaN, so that any rows have an order.
    """
    place, trait = next((place, trait) for place, trait in enumerate(TRAITS) if trait.holds(row))
    size = trait.size(row, usual_noise_std)
    return place, math.inf if math.isnan(size) else -size


def usual_noise(rows: Sequence[FleetRow]) -> Mapping[tuple[str, str], float]:
    """Return the median noise of all channels of a name and unit, by these."""
    known: dict[tuple[str, str], list[float]] = defaultdict(list)
    for row in rows:
        if 0 < _known(row.noise_std) < math.inf:
            known[row.channel, row.unit].append(_known(row.noise_std))
    return {channel: median(noise) for channel, noise in known.items()}


def worst_first(rows: Sequence[FleetRow]) -> list[FleetRow]:
    """Return the rows, those first that are to be looked at; of equally bad ones sensor 2 before sensor 10."""
    usual = usual_noise(rows)
    return sorted(rows, key=lambda row: (badness(row, usual.get((row.channel, row.unit), math.nan)), *_name_key(row)))


def _name_key(row: FleetRow) -> tuple[list[tuple[int, str]], str, str]:
    """Return what names are ordered by: numbers in them count as such."""
    parts = enumerate(_DIGITS.split(row.sensor))  # text and digits in turns
    told = [(len(part.lstrip("0")), part.lstrip("0")) if place % 2 else (0, part) for place, part in parts]
    return told, row.sensor, row.channel


def summary(rows: Sequence[FleetRow], done: str = "cleaned") -> str:
    """Return what became of a fleet, in a sentence: how many sensors are done, and how many are to be looked at.

    A sensor is done if none of its channels was refused, and does not fit, or is whatever else, if one of them is.

    Parameters
    ----------
    rows : sequence of FleetRow
        Of every channel of every sensor.
    done : str
        What was done to them, in a word.
    """
    if not rows:
        return "There is no sensor."
    found: dict[str, set[str]] = defaultdict(set)
    for row in rows:
        found[row.sensor].update(trait.name for trait in TRAITS if trait.holds(row))
    fine = [traits for traits in found.values() if "refused" not in traits]
    refused = len(found) - len(fine)
    told = [_told(fine, *words) for words in _REMARKS]
    remarks = ", ".join(remark for remark in told if remark)
    return (
        f"{spaced(len(fine))} of {counted(len(found), 'sensor is', 'sensors are')} {done}"
        + (f" ({remarks})" if remarks else "")
        + (f"; {counted(refused, 'is refused', 'are refused')}" if refused else "")
        + "."
    )


_REMARKS = (
    ("kept", "was finished before", "were finished before"),
    ("does not fit", "does not fit", "do not fit"),
    ("faulty", "is faulty", "are faulty"),
    ("outlying", "is outlying", "are outlying"),
)


def _told(sensors: Sequence[set[str]], trait: str, one: str, several: str) -> str:
    """Say of how many sensors a trait is true; nothing if of none."""
    count = sum(trait in traits for traits in sensors)
    return counted(count, one, several) if count else ""
