"""Compute the picture of a part of a channel: minimum and maximum of each stretch of rows show all spikes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.cleaning.channels.excerpt import ChannelRows, ChannelRun
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.arrays import Floats, Integers
from becalm.core.reading_verdicts import Verdict
from becalm.core.rows import EstimatedRows
from becalm.report.data.envelope import Envelope, Stretches, VerdictsByStretch
from becalm.report.gathering import WIDTH

LONG = 1 << 19
"""A view with at least this number of rows may be filtered as two halves in parallel."""

_PIECE = 1 << 16  # number of rows whose arrays fit into the cache of the processor

_WORTH = 4  # a view is split only if it is this many times as long as the run-up of the filter


class View(NamedTuple):
    """A range of rows, from `first` to before `stop`, and the largest number of stretches (`width`)."""

    first: int
    stop: int
    width: int

    @property
    def rows_each(self) -> int:
        """Return the number of rows in each stretch; the last one may have fewer."""
        return Stretches(self.stop - self.first, self.width).rows_each


class RawCurve(NamedTuple):
    """The part of a picture that does not depend on the filter."""

    times_s: Floats  # (k,) start of each of the k stretches, in seconds since the first row
    readings: Envelope


class CleanCurve(NamedTuple):
    """The part of a picture that is the output of the filter."""

    signal: Envelope
    band: Envelope  # signal -/+ WIDTH sigma
    verdicts: NDArray[np.uint16]  # (k,) one bit for each verdict that occurs
    spikes: Integers  # (n,) numbers of the rows that the gate rejected as spikes


def view_of(rows: ChannelRows, times_s: Callable[[], Floats] | None, span_s: tuple[float, float], width: int) -> View:
    """Return the view of a span of time.

    Parameters
    ----------
    rows : ChannelRows
        All rows of the channel.
    times_s : callable or None
        Returns the time of each row since the first, (N,), in seconds; None if the rows are evenly spaced.
    span_s : tuple of float
        Start and end, in seconds since the first row; they are limited to the recording.
    width : int
        Largest number of stretches.
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


def raw_of(rows: ChannelRows, times_s: Callable[[], Floats] | None, view: View) -> RawCurve:
    """Return the readings of a view."""
    stretches = Stretches(view.stop - view.first, view.width)
    readings = Envelope(stretches.count)
    starts = view.first + np.arange(stretches.count) * stretches.rows_each
    for start in range(view.first, view.stop, _PIECE):
        z = rows.plottable(slice(start, min(start + _PIECE, view.stop)))
        readings.add(*stretches.next(len(z)), z, z)
    return RawCurve(np.asarray(starts * rows.step_s) if times_s is None else times_s()[starts], readings)


def clean_of(rows: ChannelRows, recipe: ChannelRecipe, lag: int | None, view: View, pool: Executor) -> CleanCurve:
    """Run a filter over a view, in two halves in parallel if that is faster.

    Raises
    ------
    RecipeError
        If the parameters of the recipe do not make a valid filter.
    """
    if recipe.motion is None:
        return _unchanged(rows, recipe, view)
    run, each = ChannelRun(rows, recipe, lag), view.rows_each
    halves = [view]
    count = view.stop - view.first
    if count >= LONG and _WORTH * run.run_up_rows <= count:
        middle = view.first + count // 2 // each * each
        halves = [view._replace(stop=middle), view._replace(first=middle)]
    return _joined(list(pool.map(lambda half: _filter_part(run, half, each), halves)))


class _EnvelopeBuilder:
    """Computes the envelopes of a view from estimates that arrive in blocks."""

    def __init__(self, view: View, each: int) -> None:
        rows = view.stop - view.first
        self._stretches = Stretches(rows, -(-rows // each))
        self.signal, self.band = Envelope(self._stretches.count), Envelope(self._stretches.count)
        self.verdicts = VerdictsByStretch(self._stretches.count)
        self._row, self._spikes = view.first, [np.empty(0, np.int64)]

    def clean(self) -> CleanCurve:
        """Return the envelopes, verdicts and spikes of all rows so far."""
        return CleanCurve(self.signal, self.band, self.verdicts.bits, np.concatenate(self._spikes))

    def add(self, estimates: EstimatedRows) -> None:
        """Add the estimates of the next rows."""
        for start in range(0, len(estimates.signal), _PIECE):
            part = estimates.rows(slice(start, start + _PIECE))
            touched, begins = self._stretches.next(len(part.signal))
            self._enclose(part, touched, begins)
            self.verdicts.add(touched, begins, part.verdicts)
            if part.verdicts.any():
                self._spikes.append(self._row + np.flatnonzero(part.verdicts == Verdict.SPIKE))
            self._row += len(part.signal)

    def _enclose(self, estimates: EstimatedRows, touched: slice, begins: NDArray[np.intp]) -> None:
        signal, sigma = estimates.signal, estimates.sigma
        low, high = np.fmin.reduceat(signal, begins), np.fmax.reduceat(signal, begins)
        each = np.arange(len(low))
        self.signal.add(touched, each, low, high)
        least, greatest = float(sigma.min()), float(sigma.max())
        if least == greatest and np.isfinite(least):  # the filter is in its steady state, the usual case
            self.band.add(touched, each, low - WIDTH * least, high + WIDTH * least)
            return
        half = WIDTH * np.where(np.isfinite(sigma), sigma, np.nan)
        self.band.add(touched, begins, signal - half, signal + half)


def _filter_part(run: ChannelRun, view: View, each: int) -> CleanCurve:
    builder = _EnvelopeBuilder(view, each)
    for estimates in run.estimates_of(view.first, view.stop):
        builder.add(estimates)
    return builder.clean()


def _unchanged(rows: ChannelRows, recipe: ChannelRecipe, view: View) -> CleanCurve:
    """Return the usable readings as the output, without sigma."""
    healthy, builder = rows.healthy(recipe.limits), _EnvelopeBuilder(view, view.rows_each)
    part = slice(view.first, view.stop)
    unknown = np.full(view.stop - view.first, np.nan)
    builder.add(EstimatedRows(healthy.readings[part], unknown, unknown[np.newaxis], healthy.verdicts[part]))
    return builder.clean()


def _joined(parts: list[CleanCurve]) -> CleanCurve:
    if len(parts) == 1:
        return parts[0]
    signal, band = _concatenated([part.signal for part in parts]), _concatenated([part.band for part in parts])
    verdicts, spikes = ([getattr(part, name) for part in parts] for name in ("verdicts", "spikes"))
    return CleanCurve(signal, band, np.concatenate(verdicts), np.concatenate(spikes))


def _concatenated(parts: list[Envelope]) -> Envelope:
    whole = Envelope(0)
    whole.low = np.concatenate([part.low for part in parts])
    whole.high = np.concatenate([part.high for part in parts])
    return whole
