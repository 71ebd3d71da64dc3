"""Make golden vectors: readings that test a filter, and the signals and codes of becalm."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from becalm.core.arrays import Codes, Floats, Integers
from becalm.export.design import Design

STARTING = 32
"""Code in addition to those of `Verdict`: too few readings to determine the state; readings pass unchanged."""

_SEED = 20261124
_GATED = 0.1  # share of the sine's amplitude that a gate does not reject: long predictions have few digits
_LONGEST_TRIED = 400  # longest prediction that a hole tests, in rows
_BRIDGING = 3  # order of a motion; above it, few digits are left after hundreds of rows without a reading


class Reference(Protocol):
    """A reference that an exported filter is compared with."""

    def run(self, readings: Floats) -> tuple[Floats, Codes]:
        """Process readings (B,); return the signal and the code of each."""
        ...

    def gap(self, rows: int) -> None:
        """Advance by some rows without a reading."""
        ...


class Vector(NamedTuple):
    """A golden vector: readings, and the signal and codes of becalm.

    Attributes
    ----------
    name : str
        Name of what it tests.
    readings : (N,) float array
        Readings in unit; NaN where missing.
    gap_rows, gap_lengths : (g,) int arrays
        Rows with a gap before them, and the numbers of rows in these gaps.
    signal : (N,) float array
        Expected signal, in unit.
    codes : (N,) int8 array
        Expected code of each reading.
    """

    name: str
    readings: Floats
    gap_rows: Integers
    gap_lengths: Integers
    signal: Floats
    codes: Codes


def expected(name: str, readings: Floats, gaps: dict[int, int], reference: Reference) -> Vector:
    """Return the golden vector of readings (N,) and a reference; `gaps` has the length of the gap before a row."""
    cuts, results = [0, *sorted(gaps), len(readings)], []
    for first, stop in pairwise(cuts):
        if first in gaps:
            reference.gap(gaps[first])
        results.append(reference.run(readings[first:stop]))
    signal, codes = (np.concatenate(parts) for parts in zip(*results, strict=True))
    rows = np.array(sorted(gaps), np.int64)
    return Vector(name, readings, rows, np.array([gaps[row] for row in rows.tolist()], np.int64), signal, codes)


def extremes(design: Design, span: tuple[float, float] | None, largest: float) -> Floats:
    """Return the least and the greatest reading (2,) of a filter, in unit, just within its limits and `span`."""
    low, high = design.limits.rails
    low, high = max(low, -largest), min(high, largest)
    low, high = (low, high) if span is None else (max(low, span[0]), min(high, span[1]))
    inside = 1e-3 * (high - low)
    return np.array([low + inside, high - inside])


def golden_vectors(
    design: Design, rounded: Callable[[Floats], Floats], opened: Callable[[], Reference], recorded: Floats | None
) -> list[Vector]:
    """Return the golden vectors of a channel.

    Parameters
    ----------
    design : Design
        The filter of the channel.
    rounded : callable
        Function that rounds readings (N,), in unit, to those that the C code can take.
    opened : callable
        Function that returns a new reference.
    recorded : (N,) float array or None
        Readings of a real recording, in unit, if there is one.
    """
    made: list[tuple[str, Floats, dict[int, int]]] = [(name, readings, {}) for name, readings in _calm(design).items()]
    rng, centre, size = np.random.default_rng(_SEED), _centre(design), _size(design)
    noisy = centre + 0.3 * size * np.sin(np.arange(900) / 40) + rng.normal(0, min(design.noise_std, size / 8), 900)
    made += [("noise", noisy, {}), ("nan", _holed(noisy, np.nan, design), {}), ("inf", _infinite(noisy, design), {})]
    made += [("clip", _clipped(noisy, design), {}), ("gap", _waiting(noisy, design), _gaps(design))]
    made += [] if recorded is None else [("recording", recorded, {})]
    return [expected(name, rounded(readings), gaps, opened()) for name, readings, gaps in made]


def _calm(design: Design) -> dict[str, Floats]:
    """Return readings without noise, by name."""
    centre, size, k = _centre(design), _size(design), np.arange(500)
    return {
        "impulse": centre + size * (k == 100),
        "step": centre + size * (k >= 100),
        "ramp": centre + size * np.clip((k - 100) / 300, 0, 1),
        "sine": centre + size * (_GATED if design.gate else 1.0) * np.sin(2 * np.pi * k / 50),
    }


def _range(design: Design) -> tuple[float, float]:
    """Return the range of readings, in unit: within the saturation and the plausibility limits; inf if unknown."""
    limits = design.limits
    return max(limits.low, limits.outliers.low), min(limits.high, limits.outliers.high)


def _centre(design: Design) -> float:
    """Return the reading about which the vectors vary, in unit."""
    low, high = _range(design)
    inside = 100 * design.noise_std
    if np.isfinite(low):
        return (low + high) / 2 if np.isfinite(high) else low + inside
    return high - inside if np.isfinite(high) else 0.0


def _size(design: Design) -> float:
    """Return the amplitude of the vectors, in unit."""
    low, high = _range(design)
    noises = 10 if design.modes is not None else 40  # readings far from all modes make their probabilities unstable
    return float(min(noises * design.noise_std, 0.4 * (high - low)))


def _holed(readings: Floats, hole: float, design: Design) -> Floats:
    """Return readings with holes: at the start, single rows, several rows, and more than a filter predicts across."""
    holed, coasted = readings.copy(), min(design.coasts, _LONGEST_TRIED)
    for first, count in ((0, 3), (4, 1), (7, 1), (20, 1), (22, 1), (300, 7), (400, coasted + 3)):
        holed[first : first + count] = hole
    return holed


def _infinite(readings: Floats, design: Design) -> Floats:
    """Return readings of which some are infinite, and some overrange."""
    infinite = readings.copy()
    infinite[[0, 150, 151, 600]] = np.inf, -np.inf, np.inf, -np.inf
    infinite[[300, 301, 310, 311]] = 1e305, -1e305, 10 * design.largest, -10 * design.largest
    return infinite


def _clipped(readings: Floats, design: Design) -> Floats:
    """Return readings that reach the saturation limits; without limits, they are overrange."""
    clipped, (low, high) = readings.copy(), design.limits.rails
    clipped[200:210] = high if np.isfinite(high) else 10 * design.largest
    clipped[500:503] = low if np.isfinite(low) else -10 * design.largest
    return clipped


def _waiting(readings: Floats, design: Design) -> Floats:
    """Return readings with a spike just before a gap: the gate still waits for others that agree with it."""
    waiting = readings.copy()
    if design.gate is not None:
        waiting[299] = _centre(design) - _size(design)
    return waiting


def _gaps(design: Design) -> dict[int, int]:
    """Return the number of rows in each gap, by the row after it."""
    begins_anew = design.steady is not None and design.modes is None and design.motion_order <= _BRIDGING
    return {100: 1, 300: 5, 500: 60, 700: 3, 800: design.coasts + 3 if begins_anew else 60}
