"""Replace missing or rejected readings by random draws, so that the spectrum of the record can be computed.

Source: Rubin, Multiple Imputation for Nonresponse in Surveys (1987), chapter 1.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.core.filter.smoothed_flow import SmoothedFlow
from becalm.core.rows import EstimatedRows
from becalm.identification.likelihood import FEWEST_FOR_TONES, JITTER, Evidence, Tuning, keeps_time

LONGEST_HOLE = 32
"""Longest time between two readings, in steps, whose missing rows are filled for a spectrum."""

MOST_MISSING = 0.2
"""Largest share of missing rows; with more, the draws would dominate the spectrum."""


def imputed(tuning: Tuning, readings: Floats, elapsed: Floats, rejected: Booleans) -> Floats:
    """Return readings (N,) with each reject replaced by a draw from its distribution given all other readings.

    A draw keeps the power of the noise; the mean of the distribution would reduce it. The same record always gets the
    same draws.
    """
    accepted = np.where(rejected, np.nan, readings)
    flow = SmoothedFlow(tuning.component, tuning.noise_variance, split=True)
    smoothed = EstimatedRows.joined([*flow.push(accepted, elapsed), *flow.finish()])
    mean, spread = smoothed.parts.sum(axis=0), np.sqrt(smoothed.sigma**2 + tuning.noise_variance)
    draws = np.random.default_rng(len(readings)).normal(size=len(readings))
    return np.where(rejected, mean + spread * draws, readings)


def completed(evidence: Evidence, tuning: Tuning) -> Evidence:
    """Return the longest part of a record whose holes are short and few, with random draws in its holes.

    Parameters
    ----------
    evidence : Evidence
        The readings; returned unchanged if that part has fewer than 256 readings, or no more than the longest complete
        stretch.
    tuning : Tuning
        The model that the draws come from.
    """
    part = nearly_complete(evidence)
    longest = max((one.stop - one.start for one in evidence.even), default=0)
    if part.stop - part.start < FEWEST_FOR_TONES or part.stop - part.start <= longest:
        return evidence
    steps = np.round(evidence.elapsed[part][1:]).astype(int)
    rows = np.concatenate([[0], np.cumsum(steps)])
    readings, known = np.full(rows[-1] + 1, np.nan), evidence.z[part, 0]
    readings[rows] = known
    drawn = imputed(tuning, readings, np.ones(len(readings)), np.isnan(readings))
    if not np.isfinite(drawn).all():
        return evidence
    step = float(evidence.elapsed[part][1:].sum()) / rows[-1]
    filled = np.clip(drawn, known.min(), known.max())  # no draw exceeds the range of the readings
    return Evidence(np.ascontiguousarray(filled[:, np.newaxis]), np.full(len(filled), step))


def nearly_complete(evidence: Evidence) -> slice:
    """Return the longest evenly sampled part of a record, apart from jitter, whose holes are short and few."""
    elapsed = evidence.elapsed
    steps = np.round(elapsed)
    odd = (np.abs(elapsed - steps) > JITTER) | (steps < 1) | (steps > LONGEST_HOLE)
    bounds = np.concatenate([[0], np.flatnonzero(odd[1:]) + 1, [len(elapsed)]])
    parts = [slice(start, stop) for start, stop in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True)]
    even = [part for part in parts if _is_even(elapsed[part][1:])]
    return max(even, key=lambda part: part.stop - part.start, default=slice(0, 0))


def _is_even(elapsed: Floats) -> bool:
    """Return whether steps (N,) between readings belong to an even clock with few rows missing."""
    if not len(elapsed):
        return False
    steps = np.round(elapsed)
    if len(steps) < (1 - MOST_MISSING) * steps.sum():
        return False
    return keeps_time(elapsed, steps)
