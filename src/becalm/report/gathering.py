"""What pictures need of a recording, gathered while its rows go by, in memory that does not grow with them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.rows import EstimatedRows, Judge
from becalm.core.verdict import Verdict
from becalm.metrics.running import PIECE
from becalm.report.closeup import Closeup, Farthest, Middle
from becalm.report.envelope import Cut, Envelope, Kinds, Means, Stretches
from becalm.report.spectra import RunningSpectrum

_STRETCHES = 18_000  # of all channels together
_FEWEST, _MOST = 300, 3000  # of one
_NIS_STRETCHES = 200

WIDTH = 2.0
"""How many sigma a band is wide, to each side."""


class FilteredRows(NamedTuple):
    """Some rows of one channel, after the filter."""

    times_s: Floats  # (B,) since the first row
    readings: Floats  # (B,) NaN where missing or impossible
    told: EstimatedRows


class Gathering:
    """Gathers what is drawn of a recording.

    Parameters
    ----------
    rows : int
        How many will come.
    step_s : float
        The step that elapsed steps are counted in, in seconds.
    channels : int
        How many channels each row has.

    Attributes
    ----------
    rows : int
        How many come.
    rows_each : int
        Rows of a stretch.
    times, nis_times : Envelope
        When each stretch began and ended, in seconds since the first row; those of the innovations are longer.
    channels : tuple of ChannelGathering
        In order.
    """

    def __init__(self, rows: int, step_s: float, channels: int) -> None:
        self._stretches = Stretches(rows, min(_MOST, max(_FEWEST, _STRETCHES // max(1, channels))))
        self._step_s, self._steps = step_s, 0.0
        self.rows = rows
        self.rows_each = self._stretches.rows_each
        self._nis_stretches = Stretches(rows, _NIS_STRETCHES)
        self.times, self.nis_times = Envelope(self._stretches.count), Envelope(self._nis_stretches.count)
        self.channels = tuple(ChannelGathering(rows, step_s, self._stretches.count) for _ in range(channels))

    @property
    def looks(self) -> Sequence[Judge]:
        """What takes the innovations of each channel."""
        return [channel.look for channel in self.channels]

    def add(self, columns: Sequence[Floats], elapsed: Floats, told: Sequence[EstimatedRows]) -> None:
        """Take the next rows of all channels.

        Parameters
        ----------
        columns : sequence of (B,) float arrays
            Readings as they came, one array a channel.
        elapsed : (B,) float array
            Steps since the row before.
        told : sequence of EstimatedRows
            What the filters say of these rows.
        """
        if not len(elapsed):
            return
        steps = self._steps + np.cumsum(elapsed)
        self._steps = float(steps[-1])
        times = steps * self._step_s
        cuts = [(part, self._stretches.next(part.stop - part.start)) for part in _parts(len(steps))]
        for part, cut in cuts:
            self.times.add(*cut, times[part], times[part])
        self.nis_times.add(*self._nis_stretches.next(len(steps)), times, times)
        for channel, z, of in zip(self.channels, columns, told, strict=True):
            channel.add(FilteredRows(times, _possible(z, of), of), cuts)


class ChannelGathering:
    """Gathers what is drawn of one channel.

    Parameters
    ----------
    rows : int
        How many will come.
    step_s : float
        The step that elapsed steps are counted in, in seconds.
    stretches : int
        How many they are cut into.

    Attributes
    ----------
    readings, clean, band : Envelope
        Of what was read, of the signal, and of `WIDTH` sigma about it, in unit.
    kinds : Kinds
        What became of readings.
    before, after : RunningSpectrum
        Of readings, those that are missing replaced by the signal; and of the signal.
    closeups : tuple of Closeup
        Some rows, each by itself.
    nis : Means
        Of normalised innovations squared.
    """

    def __init__(self, rows: int, step_s: float, stretches: int) -> None:
        self.readings, self.clean, self.band = (Envelope(stretches) for _ in range(3))
        self.kinds = Kinds(stretches)
        self.before, self.after = RunningSpectrum(rows, 1 / step_s), RunningSpectrum(rows, 1 / step_s)
        self.closeups: tuple[Closeup, ...] = (Middle(rows), Farthest())
        self._nis_stretches = Stretches(rows, _NIS_STRETCHES)
        self.nis = Means(self._nis_stretches.count)

    def add(self, rows: FilteredRows, cuts: Sequence[tuple[slice, Cut]]) -> None:
        """Take the next rows, and which parts of them are cut into stretches how."""
        times_s, z, told = rows
        for part, cut in cuts:
            self._enclose(z[part], told.rows(part), cut)
        self.before.add(z, told.signal)
        self.after.add(told.signal)
        for closeup in self.closeups:
            closeup.add(times_s, z, told)

    def _enclose(self, z: Floats, told: EstimatedRows, cut: Cut) -> None:
        half = WIDTH * np.where(np.isfinite(told.sigma), told.sigma, np.nan)
        self.readings.add(*cut, z, z)
        self.clean.add(*cut, told.signal, told.signal)
        self.band.add(*cut, told.signal - half, told.signal + half)
        self.kinds.add(*cut, told.verdicts)

    def look(self, innovations: Floats, innovation_sigma: Floats) -> None:
        """Take the next innovations (B,) and their standard deviations, NaN where there is none."""
        for part in _parts(len(innovations)):
            normalised = innovations[part] / innovation_sigma[part]
            self.nis.add(*self._nis_stretches.next(len(normalised)), normalised**2)


def _parts(rows: int) -> list[slice]:
    """Cut rows into parts that stay in the cache while they are looked at."""
    return [slice(start, min(start + PIECE, rows)) for start in range(0, rows, PIECE)]


def _possible(z: Floats, told: EstimatedRows) -> Floats:
    """Return readings to draw: without what no sensor gives, which would leave no room for the others."""
    if not told.verdicts.any():
        return z
    impossible = np.isin(told.verdicts, (Verdict.NONFINITE, Verdict.OVERRANGE))
    return np.where(impossible, np.nan, z)
