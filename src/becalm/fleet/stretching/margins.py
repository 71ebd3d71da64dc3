"""How many rows before a stretch, and after it, its filters need, until they know no more where they began."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from becalm.cleaning.filters import Filter
from becalm.cleaning.recipe import Recipe
from becalm.cleaning.steps import lag_in_rows
from becalm.core.arrays import BLOCK, Integers
from becalm.files.chunked_cleaning import columns_of
from becalm.files.shared_source import KnownSource
from becalm.native.scans import REACH

TIMES = 16
"""Times what leaves 1e-13 of where a causal filter began: until then the last bits of two that began apart agree."""

SMOOTHED_TIMES = 2
"""The same of a smoother, whose numbers are to be right to 1e-10."""

_GATED = 1024  # rows more: what a gate has rejected in a row is looked at anew


class Margin(NamedTuple):
    """What filters need beside a stretch."""

    readings: float  # of each channel that is filtered, and as much time in steps; inf where none is enough
    aligned: int  # rows at whose multiples they have to begin


def margin_of(recipe: Recipe, step_s: float) -> Margin:
    """Return what the filters of a recipe need.

    Raises
    ------
    RecipeError
        If a channel's numbers make no filter at this step.
    """
    lag = None if recipe.mode == "smoothed" else 0 if recipe.lag_s is None else lag_in_rows(recipe.lag_s, step_s)
    filters = [Filter(channel, step_s, lag) for channel in recipe.channel if channel.motion is not None]
    times = TIMES if lag == 0 else SMOOTHED_TIMES
    readings = max((times * one.forgotten_after + _GATED * (one.gate is not None) for one in filters), default=0.0)
    aligned = int(np.lcm.reduce([BLOCK, *(one.aligned for one in filters)]))
    return Margin(readings, aligned)


def begun(source: KnownSource, recipe: Recipe, margin: Margin, first: int, most: int) -> int | None:
    """Return the row to begin with, so that each channel has enough readings before `first`; None beyond `most`."""
    rows = int(margin.readings) + BLOCK + REACH
    while rows <= most:
        begin = (first - rows) // margin.aligned * margin.aligned
        if begin <= 0:
            return 0
        if _is_long(source, recipe, margin, begin, first):
            return begin
        rows *= 2
    return None


def ended(source: KnownSource, recipe: Recipe, margin: Margin, span: tuple[int, int], most: int) -> int | None:
    """Return the row to end before, so that each channel has enough readings after a stretch; None beyond `most`.

    `span` is where the stretch, and all of the sensor, stop.
    """
    stop, last = span
    rows = int(margin.readings) + BLOCK + REACH
    while rows <= most:
        if stop + rows >= last:
            return last
        if _is_long(source, recipe, margin, stop, stop + rows):
            return stop + rows
        rows *= 2
    return None


def _is_long(source: KnownSource, recipe: Recipe, margin: Margin, first: int, stop: int) -> bool:
    counts, steps = np.zeros(len(recipe.channel), np.int64), 0.0
    for chunk in source.chunks(first, stop, stop - first):
        counts += _readings(columns_of(chunk, recipe))
        steps += float(chunk.elapsed_steps.sum())
    filtered = np.array([channel.motion is not None for channel in recipe.channel])
    return bool((counts >= margin.readings)[filtered].all() and steps >= margin.readings)


def _readings(columns: Sequence[np.ndarray]) -> Integers:
    return np.array([np.count_nonzero(np.isfinite(column)) for column in columns])
