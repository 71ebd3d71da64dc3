"""Measure the errors of a smoother in holes: hide blocks of readings and estimate them from all others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels import open_channel
from becalm.cleaning.holes import across, has_reading, widening
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


def holes_shown(recipe: ChannelRecipe, evidence: Evidence, step_s: float) -> tuple[HoleRecipe, ...]:
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
    blank = recipe.model_copy(update={"hole": (), "fill": True})
    rows = [Evidence(evidence.z[part], evidence.elapsed[part]) for part in evidence.sample]
    full = [_smoothed(blank, one.z[:, 0], one.elapsed, step_s) for one in rows]
    pairs = list(zip(rows, full, strict=True))
    by_length = [_correction([_hidden(blank, *pair, step_s, length) for pair in pairs], length) for length in LENGTHS]
    shown = tuple(one for one in by_length if one is not None)
    return shown if any(one.model_fading or one.sigma_growth for one in shown) else ()


class Hidden(NamedTuple):
    """Estimates of k hidden readings, in unit."""

    off: Floats  # departure from the line across the hole, estimated with the hidden readings
    bow: Floats  # the same, estimated without them
    sigma: Floats  # sigma of the estimate without them
    wider: Floats  # sigma divided by sigma at the edge of the hole
    known: Floats  # sigma of the estimate with them


def _correction(parts: list[Hidden], length: int) -> HoleRecipe | None:
    """Return the correction in holes of one length; None if the record is too short."""
    off, bow, sigma, wider, known = Hidden(*map(np.concatenate, zip(*parts, strict=True)))
    if len(off) < _FEWEST * length:
        return None
    squares = {fading: (off - wider**-fading * bow) ** 2 for fading in _FADINGS}
    fading = min(squares, key=lambda one: float(squares[one].mean()))
    if not _is_less(squares[fading], squares[0.0], length):
        fading = 0.0
    left = float(squares[fading].mean()) - float(np.mean(known**2))
    growth = _growth(sigma, wider, left)
    return HoleRecipe(readings=length, model_fading=round(fading, _DIGITS), sigma_growth=growth)


def _is_less(some: Floats, others: Floats, length: int) -> bool:
    """Return whether squared errors (k,) are less than others by more than chance, from means over blocks."""
    count = len(some) // length
    less = (others - some)[: count * length].reshape(count, length).mean(axis=1)
    return bool(less.mean() > less.std() / np.sqrt(count))


def _hidden(recipe: ChannelRecipe, rows: Evidence, full: EstimatedRows, step_s: float, length: int) -> Hidden:
    """Hide blocks of one length and estimate them from all other readings, but for those that the filter left out."""
    hidden = hidden_rows(len(full.signal), length)
    blind = _smoothed(recipe, np.where(hidden, np.nan, rows.z[:, 0]), rows.elapsed, step_s)
    hole = across(np.cumsum(rows.elapsed), blind, has_reading(blind), recipe.own_steps(step_s))
    values = np.stack([
        full.signal - hole.line, blind.signal - hole.line, blind.sigma, widening(blind.sigma, hole.edge), full.sigma,
    ])  # fmt: skip
    sound = hidden & ~LOST[full.verdicts] & (hole.missing < _LONGER * length)
    return Hidden(*values[:, sound & np.isfinite(values).all(axis=0)])


def hidden_rows(count: int, length: int) -> Booleans:
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


def _growth(sigma: Floats, wider: Floats, left: float) -> float:
    """Return the power by which sigma grows, so that its mean square is at least that of the error; 0 if it is."""
    low, high = 0.0, _STEEPEST
    if float(np.mean(sigma**2)) >= left:
        return 0.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        too_small = float(np.mean((sigma * wider**middle) ** 2)) < left
        low, high = (middle, high) if too_small else (low, middle)
    return round(low, _DIGITS)
