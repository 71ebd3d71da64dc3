"""Measure a smoother's errors in holes (missing readings): hide blocks of readings, and smooth all other readings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels.channels import open_channel
from becalm.cleaning.channels.holes import has_reading, lines_across_holes, widening
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import HoleRecipe
from becalm.core.arrays import Booleans, Floats
from becalm.core.reading_verdicts import LOST
from becalm.core.rows import EstimatedRows
from becalm.identification.likelihood import Evidence

LENGTHS = (8, 40, 200)
"""Lengths of the hidden blocks, in readings."""

_FEWEST = 4  # number of hidden blocks that are needed for a correction
_LONGER = 1.5  # largest length of a hole over the hidden length: a longer hole contains a hole of the record itself
_FADINGS = (0.0, *np.geomspace(0.02, 16.0, 48).tolist())  # values of `model_fading` that are tried
_STEEPEST = 2.0  # largest `sigma_growth`
_HALVINGS, _DIGITS = 30, 3  # steps of the bisection for `sigma_growth`; decimals of the results
_SEED = 33


def measure_hole_corrections(recipe: ChannelRecipe, evidence: Evidence, step_s: float) -> tuple[HoleRecipe, ...]:
    """Return the corrections of a smoother in holes of each length in `LENGTHS`; () if all are zero.

    Parameters
    ----------
    recipe : ChannelRecipe
        Recipe with a motion.
    evidence : Evidence
        Readings that the recipe was tuned on.
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
    """The estimates of k hidden readings, in unit.

    "Sighted" estimates use the hidden readings, "blind" estimates do not. A departure is that from the line across the
    hole.
    """

    sighted_departure: Floats
    blind_departure: Floats
    blind_sigma: Floats
    widening: Floats  # blind sigma divided by sigma at the edge of the hole; at least 1
    sighted_sigma: Floats


def _correction(parts: list[HiddenEstimates], length: int) -> HoleRecipe | None:
    """Return the correction in holes of `length` readings; None if the record is too short."""
    sighted, blind, sigma, ratio, sighted_sigma = HiddenEstimates(*map(np.concatenate, zip(*parts, strict=True)))
    if len(sighted) < _FEWEST * length:
        return None
    squares = {fading: (sighted - ratio**-fading * blind) ** 2 for fading in _FADINGS}
    fading = min(squares, key=lambda one: float(squares[one].mean()))
    if not _is_less(squares[fading], squares[0.0], length):
        fading = 0.0
    # The differences contain the errors of both estimates; the variance of the sighted errors is subtracted. This takes
    # the errors as independent, which matters little where sigma must grow: there the blind errors are far larger.
    error_variance = float(squares[fading].mean()) - float(np.mean(sighted_sigma**2))
    growth = _growth(sigma, ratio, error_variance)
    return HoleRecipe(readings=length, model_fading=round(fading, _DIGITS), sigma_growth=growth)


def _is_less(some: Floats, others: Floats, length: int) -> bool:
    """Return whether the mean of `some` squares is below that of `others` by more than a standard error; both (k,).

    The standard error is that of means over blocks of `length` rows.
    """
    count = len(some) // length
    less = (others - some)[: count * length].reshape(count, length).mean(axis=1)
    return bool(less.mean() > less.std() / np.sqrt(count))


def _estimate_hidden(
    recipe: ChannelRecipe, piece: Evidence, sighted: EstimatedRows, step_s: float, length: int
) -> HiddenEstimates:
    """Hide blocks of `length` readings and estimate them from all other readings; leave out rejected readings."""
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


def _growth(sigma: Floats, ratio: Floats, error_variance: float) -> float:
    """Return g, at most 2, for which the mean of (sigma ratio^g)^2 is `error_variance`; 0 if sigma is large enough."""
    low, high = 0.0, _STEEPEST
    if float(np.mean(sigma**2)) >= error_variance:
        return 0.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        too_small = float(np.mean((sigma * ratio**middle) ** 2)) < error_variance
        low, high = (middle, high) if too_small else (low, middle)
    return round(low, _DIGITS)
