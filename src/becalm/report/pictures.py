"""What became of a channel, in pictures: its signal, its verdicts, some rows close up, and its spectra."""

from __future__ import annotations

import re
import unicodedata
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.verdict import Verdict
from becalm.metrics.spectrum import Spectrum
from becalm.report.closeup import Closeup
from becalm.report.description import Axis, Band, Curve, Figure, Lane, Layer, Role
from becalm.report.envelope import Envelope
from becalm.report.gathering import WIDTH, ChannelGathering

TIME = Axis("time since the first row (s)")

_LONGEST_SLUG, _LONGEST_NAME = 40, 40
_PAUSE = 4.0  # usual steps in time, above which it pauses
_POINTS = 240  # of a spectrum, evenly spread over its logarithm


class Title(NamedTuple):
    """Which channel is drawn."""

    slug: str  # begins the names of its figures
    name: str
    unit: str

    @property
    def short(self) -> str:
        """As much of the channel's name as has room beside an axis."""
        return self.name if len(self.name) <= _LONGEST_NAME else f"{self.name[: _LONGEST_NAME - 1]}…"

    @property
    def axis(self) -> str:
        """The channel's name with its unit."""
        bracketed = re.search(r"[(\[]([^()\[\]]+)[)\]]\s*$", self.name)
        told = bracketed is not None and _folded(bracketed[1]) == _folded(self.unit)
        return f"{self.short} ({self.unit})" if self.unit and not told else self.short


def _folded(unit: str) -> str:
    """Return a unit as it is compared, however its powers and its micro are written."""
    return unicodedata.normalize("NFKC", unit).replace("^", "").replace("μ", "u").strip()


def slug_of(number: int, name: str) -> str:
    """Return what begins the names of a channel's figures, counted from 0: none has that of another."""
    return f"{number + 1}-{re.sub('[^a-z0-9]+', '-', name.lower()).strip('-')[:_LONGEST_SLUG]}".strip("-")


def signal_figures(title: Title, times: Envelope, gathered: ChannelGathering) -> tuple[Figure, ...]:
    """Draw the whole record: readings, signal and its uncertainty, and in lanes what became of readings.

    Parameters
    ----------
    title : Title
        Which channel.
    times : Envelope
        Of the stretches, in seconds.
    gathered : ChannelGathering
        What went by.

    Returns
    -------
    tuple of Figure
        One, or two where any reading was not used.
    """
    edges = [edge for of in (gathered.readings, gathered.band, gathered.clean) for edge in (of.low, of.high)]
    x, *y = parted(times.low, *edges)
    bands = (
        Band("readings", x, y[0], y[1], "readings"),
        Band(f"± {WIDTH:g} sigma", x, y[2], y[3], "clean", faint=True),
        Band("signal", x, y[4], y[5], "clean"),
    )
    drawn = Figure(f"{title.slug}-signal", f"{title.short}: readings and signal", TIME, Axis(title.axis), bands)
    lanes = tuple(_lanes(times, gathered))
    if not lanes:
        return (drawn,)
    said = "Readings that were not used as they came, and faults."
    whole = Axis(TIME.label, low=float(times.low[0]), high=float(times.high[-1]))
    return drawn, Figure(f"{title.slug}-verdicts", f"{title.short}: verdicts", whole, Axis(""), lanes, said)


def parted(times_s: Floats, *heights: Floats) -> tuple[Floats, ...]:
    """Put NaN where time pauses, so that nothing is drawn where there are no rows.

    Parameters
    ----------
    times_s : (k,) float array
        Never falling, in seconds.
    *heights : (k,) float array
        What is drawn there.

    Returns
    -------
    tuple of float array
        The times and the heights; the same arrays where there is no pause.
    """
    usual = _usual(times_s)
    before = np.flatnonzero(np.diff(times_s) > _PAUSE * usual)
    if not len(before):
        return times_s, *heights
    return np.insert(times_s, before + 1, times_s[before] + usual), *(np.insert(y, before + 1, np.nan) for y in heights)


def _usual(times_s: Floats) -> float:
    steps = np.diff(times_s)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf


def _lanes(times: Envelope, gathered: ChannelGathering) -> list[Lane]:
    ends = np.append(times.low[1:], times.high[-1])  # a stretch lasts until the next one, and not across a pause
    ends = np.minimum(ends, times.high + _usual(times.low))
    lanes = []
    for verdict in Verdict:
        first, after = gathered.kinds.runs(verdict)
        if len(first):
            lanes.append(Lane(verdict.name.lower(), times.low[first], ends[after - 1]))
    return lanes


def closeup_figures(title: Title, gathered: ChannelGathering) -> tuple[Figure, ...]:
    """Draw some rows, each by itself."""
    return tuple(
        _closeup(title, number, found) for number, found in enumerate(gathered.closeups, start=1) if found.kept.size
    )


def _closeup(title: Title, number: int, found: Closeup) -> Figure:
    times_s, z, signal, sigma = found.kept
    half = WIDTH * np.where(np.isfinite(sigma), sigma, np.nan)
    times_s, z, signal, half = parted(times_s, z, signal, half)
    layers: tuple[Layer, ...] = (
        Curve("readings", times_s, z, "readings"),
        Band(f"± {WIDTH:g} sigma", times_s, signal - half, signal + half, "clean", faint=True),
        Curve("signal", times_s, signal, "clean"),
    )
    return Figure(f"{title.slug}-closeup-{number}", found.title, TIME, Axis(title.axis), layers)


def spectrum_figure(title: Title, gathered: ChannelGathering) -> Figure | None:
    """Draw the spectra of readings and signal; None where no stretch was whole, or nothing ever changed."""
    before, after = gathered.before.result(), gathered.after.result()
    if before is None or after is None or not before.density.any():
        return None
    unit = f"density (({title.unit})²/Hz)" if title.unit else "density (1/Hz)"
    layers = (_drawn("readings", before, "readings"), _drawn("signal", after, "clean"))
    said = "Where the lines lie together it is taken for signal; where they part, noise is removed."
    axis = Axis(unit, log=True)
    return Figure(f"{title.slug}-spectrum", "Spectra", Axis("frequency (Hz)", log=True), axis, layers, said)


def _drawn(name: str, spectrum: Spectrum, role: Role) -> Curve:
    """Thin a spectrum out evenly over its logarithm: the means of what falls together."""
    f, density = spectrum
    edges = np.geomspace(f[0], f[-1] * (1 + 1e-9), _POINTS + 1)
    first = np.unique(np.searchsorted(f, edges[:-1]))
    counts = np.diff(np.append(first, len(f)))
    means = [np.add.reduceat(values, first) / counts for values in (f, density)]
    return Curve(name, means[0], _positive(means[1]), role)


def _positive(values: Floats) -> Floats:
    """Return what a logarithm can show."""
    return np.where(values > 0, values, np.nan)
