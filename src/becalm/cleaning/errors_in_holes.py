"""Measure the errors of a smoother in holes: hide blocks of readings and estimate them from all other readings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels import open_channel
from becalm.cleaning.holes import has_reading, lines_across_holes, widening
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import HoleRecipe
from becalm.core.arrays import Booleans, Floats
from becalm.core.reading_verdicts import LOST
from becalm.core.rows import EstimatedRows
from becalm.identification.likelihood import Evidence

LENGTHS = (8, 40, 200)
"""Lengths of the hidden blocks, in readings."""

_FEWEST = 4  # blocks that are needed for a correction
_LONGER = 1.5  # times the hidden length: a longer hole contains a hole of the record itself
_FADINGS = (0.0, *np.geomspace(0.02, 16.0, 48).tolist())
_STEEPEST = 2.0  # power by which sigma may grow
_HALVINGS, _DIGITS = 30, 3
_SEED = 33


def measure_hole_corrections(recipe: ChannelRecipe, evidence: Evidence, step_s: float) -> tuple[HoleRecipe, ...]:
    """Return the corrections of a smoother in holes of some lengths; none if its model needs none.

    Parameters
    ----------
    recipe : ChannelRecipe
        Recipe with a motion.
    evidence : Evidence
        The readings that it was tuned on.
    step_s : float
        One step, in seconds.
    """
    uncorrected = recipe.model_copy(update={"hole": (), "fill": True})
    pieces = [Evidence(evidence.z[part], evidence.elapsed[part]) for part in evidence.sample]
    sighted = [_smoothed(uncorrected, one.z[:, 0], one.elapsed, step_s) for one in pieces]
    pairs = list(zip(pieces, sighted, strict=True))
    by_length = [
        _correction([_estimate_hidden(uncorrected, *pair, step_s, length) for pair in pairs], length)
        for length in LENGTHS
    ]
    corrections = tuple(one for one in by_length if one is not None)
    return corrections if any(one.model_fading or one.sigma_growth for one in corrections) else ()


class HiddenEstimates(NamedTuple):
    """Estimates of k hidden readings, in unit: sighted ones use the hidden readings, blind ones do not."""

    sighted_departure: Floats  # from the line across the hole
    blind_departure: Floats
    blind_sigma: Floats
    widening: Floats  # blind sigma divided by sigma at the edge of the hole; at least 1
    sighted_sigma: Floats


def _correction(parts: list[HiddenEstimates], length: int) -> HoleRecipe | None:
    """Return the correction in holes of one length; None if the record is too short."""
    sighted, blind, sigma, wider, sighted_sigma = HiddenEstimates(*map(np.concatenate, zip(*parts, strict=True)))
    if len(sighted) < _FEWEST * length:
        return None
    squares = {fading: (sighted - wider**-fading * blind) ** 2 for fading in _FADINGS}
    fading = min(squares, key=lambda one: float(squares[one].mean()))
    if not _is_less(squares[fading], squares[0.0], length):
        fading = 0.0
    # Where sigma must grow, blind errors are far larger than sighted ones, and the difference has both.
    error_variance = float(squares[fading].mean()) - float(np.mean(sighted_sigma**2))
    growth = _growth(sigma, wider, error_variance)
    return HoleRecipe(readings=length, model_fading=round(fading, _DIGITS), sigma_growth=growth)


def _is_less(some: Floats, others: Floats, length: int) -> bool:
    """Return whether squared errors (k,) are smaller on average by more than a standard error, by means of `length`."""
    count = len(some) // length
    less = (others - some)[: count * length].reshape(count, length).mean(axis=1)
    return bool(less.mean() > less.std() / np.sqrt(count))


def _estimate_hidden(
    recipe: ChannelRecipe, piece: Evidence, sighted: EstimatedRows, step_s: float, length: int
) -> HiddenEstimates:
    """Hide blocks of one length and estimate them from all other readings; rejected readings are not compared."""
    hidden = choose_hidden_rows(len(sighted.signal), length)
    blind = _smoothed(recipe, np.where(hidden, np.nan, piece.z[:, 0]), piece.elapsed, step_s)
    hole = lines_across_holes(np.cumsum(piece.elapsed), blind, has_reading(blind), recipe.own_steps(step_s))
    departures = (sighted.signal - hole.line, blind.signal - hole.line)
    values = np.stack([*departures, blind.sigma, widening(blind.sigma, hole.edge), sighted.sigma])
    compared = hidden & ~LOST[sighted.verdicts] & (hole.missing < _LONGER * length)
    return HiddenEstimates(*values[:, compared & np.isfinite(values).all(axis=0)])


def choose_hidden_rows(count: int, length: int) -> Booleans:
    """Return which of `count` readings are hidden: blocks whose starts are two to three lengths apart."""
    rng, hidden = np.random.default_rng([_SEED, length]), np.zeros(count, bool)
    start = length + int(rng.integers(length))
    while start + 2 * length < count:
        hidden[start : start + length] = True
        start += 2 * length + int(rng.integers(length + 1))
    return hidden


def _smoothed(recipe: ChannelRecipe, z: Floats, elapsed: Floats, step_s: float) -> EstimatedRows:
    """Smooth readings (N,), NaN where they are hidden."""
    channel = open_channel(recipe, step_s, None)
    return EstimatedRows.joined([*channel.push(z, elapsed), *channel.finish()])


def _growth(sigma: Floats, wider: Floats, error_variance: float) -> float:
    """Return the power, at most 2, at which the mean of sigma^2 reaches the error; 0 if sigma is large enough."""
    low, high = 0.0, _STEEPEST
    if float(np.mean(sigma**2)) >= error_variance:
        return 0.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        too_small = float(np.mean((sigma * wider**middle) ** 2)) < error_variance
        low, high = (middle, high) if too_small else (low, middle)
    return round(low, _DIGITS)
