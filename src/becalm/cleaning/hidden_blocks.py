"""What a smoother is worth in holes, measured: readings of the record are hidden in blocks, and told by all others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels import open_channel
from becalm.cleaning.holes import across, has_reading, widening
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import HoleRecipe
from becalm.core.arrays import Booleans, Floats
from becalm.core.rows import EstimatedRows
from becalm.core.verdict import LOST
from becalm.identification.likelihood import Evidence

LENGTHS = (8, 40, 200)
"""Readings in a block."""

_FEWEST = 4  # blocks of which something is told
_LONGER = 1.5  # times what was hidden: a hole of the record itself is among it
_FADINGS = (0.0, *np.geomspace(0.02, 16.0, 48).tolist())
_STEEPEST = 2.0  # power by which sigma may grow
_HALVINGS, _DIGITS = 30, 3
_SEED = 33


def holes_shown(recipe: ChannelRecipe, evidence: Evidence, step_s: float) -> tuple[HoleRecipe, ...]:
    """Return what a smoother is worth in holes of some lengths; nothing where it is worth what its model says.

    Parameters
    ----------
    recipe : ChannelRecipe
        Of a motion.
    evidence : Evidence
        The readings that it was tuned on.
    step_s : float
        A step of theirs, in seconds.
    """
    blank = recipe.model_copy(update={"hole": (), "fill": True})
    rows = [Evidence(evidence.z[part], evidence.elapsed[part]) for part in evidence.sample]
    full = [_smoothed(blank, one.z[:, 0], one.elapsed, step_s) for one in rows]
    pairs = list(zip(rows, full, strict=True))
    found = [_shown([_hidden(blank, *pair, step_s, length) for pair in pairs], length) for length in LENGTHS]
    shown = tuple(one for one in found if one is not None)
    return shown if any(one.model_fading or one.sigma_growth for one in shown) else ()


class Hidden(NamedTuple):
    """Readings (k,) that were hidden, in unit."""

    off: Floats  # from a line across, as the smoother tells them that knows them
    bow: Floats  # from a line across, as the one tells them that does not
    sigma: Floats  # of the one that does not
    wider: Floats  # the same over sigma beside the hole
    known: Floats  # sigma of the smoother that knows them


def _shown(parts: list[Hidden], length: int) -> HoleRecipe | None:
    """Return what a smoother is worth in holes of one length; None of a record that is too short to tell."""
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
    """Whether squared errors (k,) are less than others, by more than blocks of so many differ by chance."""
    count = len(some) // length
    less = (others - some)[: count * length].reshape(count, length).mean(axis=1)
    return bool(less.mean() > less.std() / np.sqrt(count))


def _hidden(recipe: ChannelRecipe, rows: Evidence, full: EstimatedRows, step_s: float, length: int) -> Hidden:
    """Hide readings in blocks of one length, and tell them by all others; those that the filter left out are none."""
    hidden = hidden_rows(len(full.signal), length)
    told = _smoothed(recipe, np.where(hidden, np.nan, rows.z[:, 0]), rows.elapsed, step_s)
    hole = across(np.cumsum(rows.elapsed), told, has_reading(told), recipe.own_steps(step_s))
    found = np.stack([
        full.signal - hole.line, told.signal - hole.line, told.sigma, widening(told.sigma, hole.edge), full.sigma,
    ])  # fmt: skip
    sound = hidden & ~LOST[full.verdicts] & (hole.missing < _LONGER * length)
    return Hidden(*found[:, sound & np.isfinite(found).all(axis=0)])


def hidden_rows(count: int, length: int) -> Booleans:
    """Return which of so many readings are hidden: blocks, from one to the next two to three of their lengths."""
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
    """Return the power by which sigma grows, so that its mean square is that of the error; 0 where it is already."""
    low, high = 0.0, _STEEPEST
    if float(np.mean(sigma**2)) >= left:
        return 0.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        too_small = float(np.mean((sigma * wider**middle) ** 2)) < left
        low, high = (middle, high) if too_small else (low, middle)
    return round(low, _DIGITS)
