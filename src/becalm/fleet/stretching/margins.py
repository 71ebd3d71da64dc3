"""Compute how many rows filters need before and after a stretch, so that their initial state no longer matters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels.filters import Filter
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.recipes.steps import lag_in_rows
from becalm.core.arrays import BLOCK, Integers
from becalm.files.inputs.shared_source import SharedSource
from becalm.files.outputs.chunked_cleaning import columns_of
from becalm.native.scans import REACH

TIMES = 16
"""Warm-up of a causal filter, in multiples of the readings after which its initial state has decayed to 1e-13.

After this warm-up, the states of two filters with different initial states are bitwise equal.
"""

SMOOTHED_TIMES = 2
"""The same multiple for a smoother, on each side of a stretch; its estimates must be right only to 1e-10."""

_GATED = 1024  # additional readings for a gate: it may reconsider the readings of a series that it rejected


class Margin(NamedTuple):
    """The rows that filters need on each side of a stretch."""

    readings: float  # least number of readings of each filtered channel, and of time steps; inf if no number is enough
    aligned: int  # the row at which filters start must be a multiple of this number


def margin_of(recipe: Recipe, step_s: float) -> Margin:
    """Return the margin that the filters of a recipe need.

    Raises
    ------
    RecipeError
        If a channel's settings do not give a valid filter at this sampling interval.
    """
    lag = None if recipe.mode == "smoothed" else 0 if recipe.lag_s is None else lag_in_rows(recipe.lag_s, step_s)
    filters = [Filter(channel, step_s, lag) for channel in recipe.channel if channel.motion is not None]
    times = TIMES if lag == 0 else SMOOTHED_TIMES
    readings = max((times * one.readings_to_forget + _GATED * (one.gate is not None) for one in filters), default=0.0)
    aligned = int(np.lcm.reduce([BLOCK, *(one.row_multiple for one in filters)]))
    return Margin(readings, aligned)


def warm_up_start(source: SharedSource, recipe: Recipe, margin: Margin, first: int, most: int) -> int | None:
    """Return the row at which a warm-up starts, so that each filtered channel has enough readings before `first`.

    Return None if the warm-up needs more than `most` rows.
    """
    rows = int(margin.readings) + BLOCK + REACH
    while rows <= most:
        begin = (first - rows) // margin.aligned * margin.aligned
        if begin <= 0:
            return 0
        if _is_long(source, recipe, margin, begin, first):
            return begin
        rows *= 2
    return None


def margin_end(source: SharedSource, recipe: Recipe, margin: Margin, span: tuple[int, int], most: int) -> int | None:
    """Return the row before which to stop, so that each filtered channel has enough readings after a stretch.

    `span` has two values: the row after the stretch, and the number of rows of the sensor. Return None if the margin
    needs more than `most` rows.
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


def _is_long(source: SharedSource, recipe: Recipe, margin: Margin, first: int, stop: int) -> bool:
    """Return whether the rows from `first` up to, not including, `stop` have the readings and steps of a margin."""
    counts, steps = np.zeros(len(recipe.channel), np.int64), 0.0
    for chunk in source.chunks(first, stop, stop - first):
        counts += _readings(columns_of(chunk, recipe))
        steps += float(chunk.elapsed_steps.sum())
    filtered = np.array([channel.motion is not None for channel in recipe.channel])
    return bool((counts >= margin.readings)[filtered].all() and steps >= margin.readings)


def _readings(columns: Sequence[np.ndarray]) -> Integers:
    return np.array([np.count_nonzero(np.isfinite(column)) for column in columns])
