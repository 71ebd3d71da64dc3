"""Draw the result of a channel: its signal, its verdicts, some rows close up, and its spectra."""

from __future__ import annotations

import re
import unicodedata
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.metrics.spectrum import Spectrum
from becalm.report.data.closeup import Closeup
from becalm.report.data.description import Axis, Band, Curve, Figure, Lane, Layer, Role
from becalm.report.data.envelope import Envelope
from becalm.report.gathering import WIDTH, ChannelGathering

TIME = Axis("time since the first row (s)")

_LONGEST_SLUG, _LONGEST_NAME = 40, 40  # characters
_PAUSE = 4.0  # a longer step in time is a pause; in median steps
_POINTS = 240  # points of a spectrum, evenly spaced in the logarithm of frequency


class Title(NamedTuple):
    """The names of a channel in its figures."""

    slug: str  # prefix of the names of its figures
    name: str
    unit: str

    @property
    def short(self) -> str:
        """Return the channel's name, shortened to fit next to an axis."""
        return self.name if len(self.name) <= _LONGEST_NAME else f"{self.name[: _LONGEST_NAME - 1]}…"

    @property
    def axis(self) -> str:
        """Return the channel's name with its unit, unless the name ends with that unit already."""
        bracketed = re.search(r"[(\[]([^()\[\]]+)[)\]]\s*$", self.name)
        has_unit = bracketed is not None and _normalised(bracketed[1]) == _normalised(self.unit)
        return f"{self.short} ({self.unit})" if self.unit and not has_unit else self.short


def _normalised(unit: str) -> str:
    """Return a unit with a uniform spelling of powers and of micro, for comparison."""
    return unicodedata.normalize("NFKC", unit).replace("^", "").replace("μ", "u").strip()


def slug_of(number: int, name: str) -> str:
    """Return the prefix of the names of a channel's figures; `number`, from 0, makes it unique."""
    return f"{number + 1}-{re.sub('[^a-z0-9]+', '-', name.lower()).strip('-')[:_LONGEST_SLUG]}".strip("-")


def signal_figures(title: Title, times: Envelope, gathered: ChannelGathering) -> tuple[Figure, ...]:
    """Draw the whole record: readings, signal and its uncertainty, and the verdicts on readings as lanes.

    Parameters
    ----------
    title : Title
        Names of the channel.
    times : Envelope
        Times of the stretches, in seconds since the first row.
    gathered : ChannelGathering
        Data of the channel.

    Returns
    -------
    tuple of Figure
        The signal, and the verdicts if any occurred other than "used".
    """
    edges = [edge for of in (gathered.readings, gathered.band, gathered.clean) for edge in (of.low, of.high)]
    x, *y = break_at_pauses(times.low, *edges)
    bands = (
        Band("readings", x, y[0], y[1], "readings"),
        Band(f"± {WIDTH:g} sigma", x, y[2], y[3], "clean", faint=True),
        Band("signal", x, y[4], y[5], "clean"),
    )
    drawn = Figure(f"{title.slug}-signal", f"{title.short}: readings and signal", TIME, Axis(title.axis), bands)
    lanes = tuple(_lanes(times, gathered))
    if not lanes:
        return (drawn,)
    caption = "Readings that were not used unchanged, and faults."
    whole = Axis(TIME.label, low=float(times.low[0]), high=float(times.high[-1]))
    return drawn, Figure(f"{title.slug}-verdicts", f"{title.short}: verdicts", whole, Axis(""), lanes, caption)


def break_at_pauses(times_s: Floats, *heights: Floats) -> tuple[Floats, ...]:
    """Insert NaN into each pause, so that no line is drawn where there are no rows.

    Parameters
    ----------
    times_s : (k,) float array
        Times in seconds, not decreasing.
    *heights : (k,) float array
        Values to draw at these times.

    Returns
    -------
    tuple of float array
        The times and the heights; the same arrays if there is no pause.
    """
    usual = _median_step(times_s)
    before = np.flatnonzero(np.diff(times_s) > _PAUSE * usual)
    if not len(before):
        return times_s, *heights
    return np.insert(times_s, before + 1, times_s[before] + usual), *(np.insert(y, before + 1, np.nan) for y in heights)


def _median_step(times_s: Floats) -> float:
    """Return the median step in time, in seconds; inf if there is none."""
    steps = np.diff(times_s)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf


def _lanes(times: Envelope, gathered: ChannelGathering) -> list[Lane]:
    ends = np.append(times.low[1:], times.high[-1])  # a stretch lasts until the next one begins, but not across a pause
    ends = np.minimum(ends, times.high + _median_step(times.low))
    lanes = []
    for verdict in Verdict:
        first, after = gathered.kinds.runs(verdict)
        if len(first):
            lanes.append(Lane(verdict.name.lower(), times.low[first], ends[after - 1]))
    return lanes


def closeup_figures(title: Title, gathered: ChannelGathering) -> tuple[Figure, ...]:
    """Draw the close-ups, in which every single reading is visible."""
    return tuple(
        _closeup(title, number, rows) for number, rows in enumerate(gathered.closeups, start=1) if rows.kept.size
    )


def _closeup(title: Title, number: int, rows: Closeup) -> Figure:
    times_s, z, signal, sigma = rows.kept
    half = WIDTH * np.where(np.isfinite(sigma), sigma, np.nan)
    times_s, z, signal, half = break_at_pauses(times_s, z, signal, half)
    layers: tuple[Layer, ...] = (
        Curve("readings", times_s, z, "readings"),
        Band(f"± {WIDTH:g} sigma", times_s, signal - half, signal + half, "clean", faint=True),
        Curve("signal", times_s, signal, "clean"),
    )
    return Figure(f"{title.slug}-closeup-{number}", rows.title, TIME, Axis(title.axis), layers)


def spectrum_figure(title: Title, gathered: ChannelGathering) -> Figure | None:
    """Draw the spectra of readings and signal; None if no segment was complete, or all readings are equal."""
    before, after = gathered.before.result(), gathered.after.result()
    if before is None or after is None or not before.density.any():
        return None
    unit = f"density (({title.unit})²/Hz)" if title.unit else "density (1/Hz)"
    layers = (_spectrum_curve("readings", before, "readings"), _spectrum_curve("signal", after, "clean"))
    caption = "Where the lines agree, the filter keeps the readings as signal; where they differ, it removes noise."
    axis = Axis(unit, log=True)
    return Figure(f"{title.slug}-spectrum", "Spectra", Axis("frequency (Hz)", log=True), axis, layers, caption)


def _spectrum_curve(name: str, spectrum: Spectrum, role: Role) -> Curve:
    """Return a spectrum as a curve, averaged in bins that have equal widths in the logarithm of frequency."""
    f, density = spectrum
    edges = np.geomspace(f[0], f[-1] * (1 + 1e-9), _POINTS + 1)
    first = np.unique(np.searchsorted(f, edges[:-1]))
    counts = np.diff(np.append(first, len(f)))
    means = [np.add.reduceat(values, first) / counts for values in (f, density)]
    return Curve(name, means[0], _positive(means[1]), role)


def _positive(values: Floats) -> Floats:
    """Replace values that a logarithmic axis cannot show by NaN."""
    return np.where(values > 0, values, np.nan)
