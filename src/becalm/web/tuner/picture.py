"""A part of a channel as a page draws it: the least and the greatest of each stretch, so that no spike is lost."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.cleaning.excerpt import ChannelRows, ChannelRun
from becalm.cleaning.recipe import ChannelRecipe
from becalm.core.arrays import Floats, Integers
from becalm.core.rows import EstimatedRows
from becalm.core.verdict import Verdict
from becalm.report.envelope import Envelope, Kinds, Stretches
from becalm.report.gathering import WIDTH

LONG = 1 << 19
"""Rows from which on two run side by side."""

_PIECE = 1 << 16  # rows that are looked at while they are in the cache

_WORTH = 4  # times what each has to run before its rows


class View(NamedTuple):
    """Which rows of a channel are looked at, and in how many stretches at the most."""

    first: int
    stop: int
    width: int

    @property
    def rows_each(self) -> int:
        """Rows of a stretch."""
        return Stretches(self.stop - self.first, self.width).rows_each


class Raw(NamedTuple):
    """What a view shows whatever the filter."""

    times_s: Floats  # (k,) where each stretch begins, since the first row
    readings: Envelope


class Clean(NamedTuple):
    """What a filter makes of a view."""

    signal: Envelope
    band: Envelope
    verdicts: NDArray[np.uint16]  # (k,) a bit for each
    spikes: Integers  # (n,) rows that its gate left out


def view_of(rows: ChannelRows, times_s: Callable[[], Floats] | None, span_s: tuple[float, float], width: int) -> View:
    """Return the view of a span of time.

    Parameters
    ----------
    rows : ChannelRows
        All rows.
    times_s : callable or None
        Gives the time of each since the first, (N,); None where they are even, and none is missing.
    span_s : tuple of float
        From and to, in seconds since the first row; whatever lies outside is cut off.
    width : int
        Stretches at the most.
    """
    count = len(rows)
    if times_s is None:
        bounds = np.clip(np.array(span_s) / rows.step_s, 0, count - 1)
        first, last = int(np.floor(bounds[0])), int(np.ceil(bounds[1]))
    else:
        times = times_s()
        first = int(np.searchsorted(times, span_s[0], side="right")) - 1
        last = int(np.searchsorted(times, span_s[1], side="left"))
    first, last = min(max(first, 0), count - 1), min(max(last, 0), count - 1)
    return View(first, max(last, first) + 1, width)


def raw_of(rows: ChannelRows, times_s: Callable[[], Floats] | None, view: View) -> Raw:
    """Return what a view shows of the readings."""
    stretches = Stretches(view.stop - view.first, view.width)
    readings = Envelope(stretches.count)
    starts = view.first + np.arange(stretches.count) * stretches.rows_each
    for start in range(view.first, view.stop, _PIECE):
        z = rows.possible(slice(start, min(start + _PIECE, view.stop)))
        readings.add(*stretches.next(len(z)), z, z)
    return Raw(np.asarray(starts * rows.step_s) if times_s is None else times_s()[starts], readings)


def clean_of(rows: ChannelRows, recipe: ChannelRecipe, lag: int | None, view: View, pool: Executor) -> Clean:
    """Run a filter over a view, in two halves side by side where that is worth it.

    Raises
    ------
    RecipeError
        If the recipe's numbers make no filter.
    """
    if recipe.motion is None:
        return _unchanged(rows, recipe, view)
    run, each = ChannelRun(rows, recipe, lag), view.rows_each
    halves = [view]
    count = view.stop - view.first
    if count >= LONG and _WORTH * run.reach <= count:
        middle = view.first + count // 2 // each * each
        halves = [view._replace(stop=middle), view._replace(first=middle)]
    return _joined(list(pool.map(lambda half: _enclosed(run, half, each), halves)))


class _Enclosing:
    """Encloses what is told of the rows of a view, as it comes."""

    def __init__(self, view: View, each: int) -> None:
        rows = view.stop - view.first
        self._stretches = Stretches(rows, -(-rows // each))
        self.signal, self.band = Envelope(self._stretches.count), Envelope(self._stretches.count)
        self.kinds = Kinds(self._stretches.count)
        self._row, self._spikes = view.first, [np.empty(0, np.int64)]

    def clean(self) -> Clean:
        """Return what all rows were."""
        return Clean(self.signal, self.band, self.kinds.met, np.concatenate(self._spikes))

    def add(self, told: EstimatedRows) -> None:
        """Take the next rows."""
        for start in range(0, len(told.signal), _PIECE):
            part = told.rows(slice(start, start + _PIECE))
            touched, begins = self._stretches.next(len(part.signal))
            self._enclose(part, touched, begins)
            self.kinds.add(touched, begins, part.verdicts)
            if part.verdicts.any():
                self._spikes.append(self._row + np.flatnonzero(part.verdicts == Verdict.SPIKE))
            self._row += len(part.signal)

    def _enclose(self, told: EstimatedRows, touched: slice, begins: NDArray[np.intp]) -> None:
        low, high = np.fmin.reduceat(told.signal, begins), np.fmax.reduceat(told.signal, begins)
        each = np.arange(len(low))
        self.signal.add(touched, each, low, high)
        least, greatest = float(told.sigma.min()), float(told.sigma.max())
        if least == greatest and np.isfinite(least):  # settled, as mostly
            self.band.add(touched, each, low - WIDTH * least, high + WIDTH * least)
            return
        half = WIDTH * np.where(np.isfinite(told.sigma), told.sigma, np.nan)
        self.band.add(touched, begins, told.signal - half, told.signal + half)


def _enclosed(run: ChannelRun, view: View, each: int) -> Clean:
    enclosing = _Enclosing(view, each)
    for told in run.told(view.first, view.stop):
        enclosing.add(told)
    return enclosing.clean()


def _unchanged(rows: ChannelRows, recipe: ChannelRecipe, view: View) -> Clean:
    """Give readings back, of which no sigma is told."""
    healthy, enclosing = rows.healthy(recipe.limits), _Enclosing(view, view.rows_each)
    part = slice(view.first, view.stop)
    unknown = np.full(view.stop - view.first, np.nan)
    enclosing.add(EstimatedRows(healthy.readings[part], unknown, unknown[np.newaxis], healthy.verdicts[part]))
    return enclosing.clean()


def _joined(parts: list[Clean]) -> Clean:
    if len(parts) == 1:
        return parts[0]
    signal, band = _end_to_end([part.signal for part in parts]), _end_to_end([part.band for part in parts])
    verdicts, spikes = ([getattr(part, name) for part in parts] for name in ("verdicts", "spikes"))
    return Clean(signal, band, np.concatenate(verdicts), np.concatenate(spikes))


def _end_to_end(parts: list[Envelope]) -> Envelope:
    whole = Envelope(0)
    whole.low = np.concatenate([part.low for part in parts])
    whole.high = np.concatenate([part.high for part in parts])
    return whole
