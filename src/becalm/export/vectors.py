"""Make golden vectors: readings that test a filter, with the signals and codes of becalm."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from becalm.core.arrays import Codes, Floats, Integers
from becalm.export.design import Design

STARTING = 32
"""Code, in addition to the `Verdict` codes, for a reading that passes unchanged because the state is undetermined."""

_SEED = 20261124
_GATED = 0.1  # factor on the sine's amplitude for a filter with a gate, so that the gate does not reject readings
_LONGEST_TRIED = 400  # longest prediction in a hole of a vector, in rows
_BRIDGING = 3  # largest order of a motion that has enough digits after hundreds of rows without a reading


class Reference(Protocol):
    """A reference that an exported filter is compared with."""

    def run(self, readings: Floats) -> tuple[Floats, Codes]:
        """Process readings (B,); return the signal (B,) and the codes (B,)."""
        ...

    def gap(self, rows: int) -> None:
        """Advance by `rows` rows without a reading."""
        ...


class Vector(NamedTuple):
    """A golden vector: readings, with the signal and codes of becalm.

    Attributes
    ----------
    name : str
        Name of the vector, for what it tests.
    readings : (N,) float array
        Readings in unit; NaN where missing.
    gap_rows, gap_lengths : (g,) int arrays
        Rows that follow a gap, and the number of rows in each gap.
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


def make_vector(name: str, readings: Floats, gaps: dict[int, int], reference: Reference) -> Vector:
    """Run a reference over readings (N,); return the golden vector. `gaps` has the length of the gap before a row."""
    cuts, results = [0, *sorted(gaps), len(readings)], []
    for first, stop in pairwise(cuts):
        if first in gaps:
            reference.gap(gaps[first])
        results.append(reference.run(readings[first:stop]))
    signal, codes = (np.concatenate(parts) for parts in zip(*results, strict=True))
    rows = np.array(sorted(gaps), np.int64)
    return Vector(name, readings, rows, np.array([gaps[row] for row in rows.tolist()], np.int64), signal, codes)


def extremes(design: Design, span: tuple[float, float] | None, largest: float) -> Floats:
    """Return the least and the greatest reading (2,), in unit, just inside the limits of a filter and `span`."""
    low, high = design.limits.rails
    low, high = max(low, -largest), min(high, largest)
    low, high = (low, high) if span is None else (max(low, span[0]), min(high, span[1]))
    inside = 1e-3 * (high - low)
    return np.array([low + inside, high - inside])


def golden_vectors(
    design: Design, rounded: Callable[[Floats], Floats], new_reference: Callable[[], Reference], recorded: Floats | None
) -> list[Vector]:
    """Return the golden vectors of a channel.

    Parameters
    ----------
    design : Design
        The filter of the channel.
    rounded : callable
        Function that rounds readings (N,), in unit, to readings that the C code can take.
    new_reference : callable
        Function that returns a new reference.
    recorded : (N,) float array or None
        Readings of a real recording, in unit; None without one.
    """
    made: list[tuple[str, Floats, dict[int, int]]] = [
        (name, readings, {}) for name, readings in _noise_free(design).items()
    ]
    rng, centre, size = np.random.default_rng(_SEED), _centre(design), _size(design)
    noisy = centre + 0.3 * size * np.sin(np.arange(900) / 40) + rng.normal(0, min(design.noise_std, size / 8), 900)
    made += [
        ("noise", noisy, {}),
        ("nan", _with_holes(noisy, np.nan, design), {}),
        ("inf", _with_infinity(noisy, design), {}),
    ]
    made += [("clip", _with_clipping(noisy, design), {}), ("gap", _with_spike(noisy, design), _gaps(design))]
    made += [] if recorded is None else [("recording", recorded, {})]
    return [make_vector(name, rounded(readings), gaps, new_reference()) for name, readings, gaps in made]


def _noise_free(design: Design) -> dict[str, Floats]:
    """Return readings without noise, by the name of the vector."""
    centre, size, k = _centre(design), _size(design), np.arange(500)
    return {
        "impulse": centre + size * (k == 100),
        "step": centre + size * (k >= 100),
        "ramp": centre + size * np.clip((k - 100) / 300, 0, 1),
        "sine": centre + size * (_GATED if design.gate else 1.0) * np.sin(2 * np.pi * k / 50),
    }


def _range(design: Design) -> tuple[float, float]:
    """Return the range of readings within the saturation and plausibility limits, in unit; +-inf without a limit."""
    limits = design.limits
    return max(limits.low, limits.outliers.low), min(limits.high, limits.outliers.high)


def _centre(design: Design) -> float:
    """Return the mean reading of the vectors, in unit."""
    low, high = _range(design)
    inside = 100 * design.noise_std
    if np.isfinite(low):
        return (low + high) / 2 if np.isfinite(high) else low + inside
    return high - inside if np.isfinite(high) else 0.0


def _size(design: Design) -> float:
    """Return the amplitude of the vectors, in unit."""
    low, high = _range(design)
    noises = 10 if design.modes is not None else 40  # distant readings make the modes' probabilities unstable
    return float(min(noises * design.noise_std, 0.4 * (high - low)))


def _with_holes(readings: Floats, hole: float, design: Design) -> Floats:
    """Return readings with holes: at the start, of one row, of several rows, and longer than a filter predicts."""
    holed, coasted = readings.copy(), min(design.coasts, _LONGEST_TRIED)
    for first, count in ((0, 3), (4, 1), (7, 1), (20, 1), (22, 1), (300, 7), (400, coasted + 3)):
        holed[first : first + count] = hole
    return holed


def _with_infinity(readings: Floats, design: Design) -> Floats:
    """Return readings of which some are infinite and some are overrange."""
    infinite = readings.copy()
    infinite[[0, 150, 151, 600]] = np.inf, -np.inf, np.inf, -np.inf
    infinite[[300, 301, 310, 311]] = 1e305, -1e305, 10 * design.largest, -10 * design.largest
    return infinite


def _with_clipping(readings: Floats, design: Design) -> Floats:
    """Return readings of which some are at the saturation limits; without limits, these are overrange."""
    clipped, (low, high) = readings.copy(), design.limits.rails
    clipped[200:210] = high if np.isfinite(high) else 10 * design.largest
    clipped[500:503] = low if np.isfinite(low) else -10 * design.largest
    return clipped


def _with_spike(readings: Floats, design: Design) -> Floats:
    """Return readings with a spike just before a gap, so that the gate's count of rejected readings spans the gap."""
    with_spike = readings.copy()
    if design.gate is not None:
        with_spike[299] = _centre(design) - _size(design)
    return with_spike


def _gaps(design: Design) -> dict[int, int]:
    """Return the number of rows in each gap, with the row after the gap as key."""
    restarts = design.steady is not None and design.modes is None and design.motion_order <= _BRIDGING
    return {100: 1, 300: 5, 500: 60, 700: 3, 800: design.coasts + 3 if restarts else 60}
