"""Gather the data for a recording's figures during cleaning, in memory independent of the number of rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.core.rows import EstimatedRows, Judge
from becalm.metrics.whiteness import PIECE
from becalm.report.data.closeup import Closeup, Farthest, Middle
from becalm.report.data.envelope import Cut, Envelope, Means, Stretches, VerdictsByStretch
from becalm.report.data.spectra import RunningSpectrum

_STRETCHES = 18_000  # approximate number of stretches of all channels together
_FEWEST, _MOST = 300, 3000  # smallest and largest number of stretches of one channel
_NIS_STRETCHES = 200  # largest number of stretches over which the NIS is averaged

WIDTH = 2.0
"""Half-width of the uncertainty band, in multiples of sigma."""


class FilteredRows(NamedTuple):
    """Some rows of one channel with their estimates."""

    times_s: Floats  # (B,) seconds since the first row
    readings: Floats  # (B,) NaN where missing, infinite or overrange
    estimates: EstimatedRows


class Gathering:
    """The data for the figures of a recording.

    Parameters
    ----------
    rows : int
        Total number of rows.
    step_s : float
        Length of one step in seconds; elapsed time is counted in such steps.
    channels : int
        Number of channels in each row.

    Attributes
    ----------
    rows : int
        Total number of rows.
    rows_each : int
        Rows in each stretch.
    times, nis_times : Envelope
        Start and end of each stretch, in seconds since the first row; `nis_times` has the longer stretches of the NIS.
    channels : tuple of ChannelGathering
        Data of each channel, in order.
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
        """Return, for each channel, the function that receives its innovations."""
        return [channel.add_innovations for channel in self.channels]

    def add(self, columns: Sequence[Floats], elapsed: Floats, estimates: Sequence[EstimatedRows]) -> None:
        """Add the next rows of all channels.

        Parameters
        ----------
        columns : sequence of (B,) float arrays
            Readings, one array for each channel.
        elapsed : (B,) float array
            Steps since the previous row.
        estimates : sequence of EstimatedRows
            Estimates for these rows, one for each channel.
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
        for channel, z, own in zip(self.channels, columns, estimates, strict=True):
            channel.add(FilteredRows(times, _plausible(z, own), own), cuts)


class ChannelGathering:
    """The data for the figures of one channel.

    Parameters
    ----------
    rows : int
        Total number of rows.
    step_s : float
        Length of one step in seconds.
    stretches : int
        Number of stretches into which the rows are divided.

    Attributes
    ----------
    readings, clean, band : Envelope
        Envelopes, in the channel's unit, of the readings, of the signal, and of the signal ± `WIDTH` sigma.
    kinds : VerdictsByStretch
        Verdicts on the readings.
    before : RunningSpectrum
        Spectrum of the readings; the signal replaces missing readings.
    after : RunningSpectrum
        Spectrum of the signal.
    closeups : tuple of Closeup
        Rows that are drawn in full detail.
    nis : Means
        Means of the normalised innovations squared (NIS).
    """

    def __init__(self, rows: int, step_s: float, stretches: int) -> None:
        self.readings, self.clean, self.band = (Envelope(stretches) for _ in range(3))
        self.kinds = VerdictsByStretch(stretches)
        self.before, self.after = RunningSpectrum(rows, 1 / step_s), RunningSpectrum(rows, 1 / step_s)
        self.closeups: tuple[Closeup, ...] = (Middle(rows), Farthest())
        self._nis_stretches = Stretches(rows, _NIS_STRETCHES)
        self.nis = Means(self._nis_stretches.count)

    def add(self, rows: FilteredRows, cuts: Sequence[tuple[slice, Cut]]) -> None:
        """Add the next rows; `cuts` has parts of the rows, each with its division into stretches."""
        times_s, z, estimates = rows
        for part, cut in cuts:
            self._enclose(z[part], estimates.rows(part), cut)
        self.before.add(z, estimates.signal)
        self.after.add(estimates.signal)
        for closeup in self.closeups:
            closeup.add(times_s, z, estimates)

    def _enclose(self, z: Floats, estimates: EstimatedRows, cut: Cut) -> None:
        half = WIDTH * np.where(np.isfinite(estimates.sigma), estimates.sigma, np.nan)
        self.readings.add(*cut, z, z)
        self.clean.add(*cut, estimates.signal, estimates.signal)
        self.band.add(*cut, estimates.signal - half, estimates.signal + half)
        self.kinds.add(*cut, estimates.verdicts)

    def add_innovations(self, innovations: Floats, innovation_sigma: Floats) -> None:
        """Add the next innovations (B,) and their standard deviations, NaN where there is no innovation."""
        for part in _parts(len(innovations)):
            normalised = innovations[part] / innovation_sigma[part]
            self.nis.add(*self._nis_stretches.next(len(normalised)), normalised**2)


def _parts(rows: int) -> list[slice]:
    """Divide rows into parts that fit into the processor's cache."""
    return [slice(start, min(start + PIECE, rows)) for start in range(0, rows, PIECE)]


def _plausible(z: Floats, estimates: EstimatedRows) -> Floats:
    """Replace infinite and overrange readings by NaN, because they would extend the axis until others look flat."""
    if not estimates.verdicts.any():
        return z
    impossible = np.isin(estimates.verdicts, (Verdict.NONFINITE, Verdict.OVERRANGE))
    return np.where(impossible, np.nan, z)
