"""The strain paper's figures 1 to 8, redrawn from what the study measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.studies.strain import SHOWN, Shown, Study
from becalm.studies.strain_gauge import Gauge
from becalm.studies.strain_methods import AVERAGE, BECALM, BUTTERWORTH, KALMAN, READINGS

_POINTS = 1200  # across a figure
_ZOOM_S = 30.0
_DRAWN = ("G of the simulation, R at rest", "G by likelihood, R at rest", "becalm, smoothed")  # others hide each other
_LOOK: Any = {"svg.hashsalt": "becalm", "svg.fonttype": "none", "font.size": 9, "lines.linewidth": 1.0}


def figures(study: Study, folder: Path) -> dict[str, str]:
    """Draw the figures into a folder as SVG; return the file name of each by its title.

    Parameters
    ----------
    study : Study
        What was measured; without a gauge figures 7 and 8 are left out.
    folder : Path
        Where they go; it exists.
    """
    import matplotlib as mpl

    drawn = {}
    with mpl.rc_context(_LOOK):
        for number, (title, lines) in enumerate(_simulated(study.shown).items(), start=1):
            drawn[f"Figure {number}. {title}"] = _draw(folder / f"strain-{number}.svg", lines, "strain")
        if study.gauge is not None:
            for number, until_s in ((7, np.inf), (8, _ZOOM_S)):
                title = "The bridge's gauge and its filters" + ("." if until_s == np.inf else f", first {_ZOOM_S:g} s.")
                lines = _real(study.gauge, until_s)
                drawn[f"Figure {number}. {title}"] = _draw(folder / f"strain-{number}.svg", lines, study.gauge.unit)
    return drawn


Lines = dict[str, tuple[Floats, Floats]]
"""By its name, times in seconds and values; an envelope has (2, N) values, from and to."""


def _simulated(shown: Shown) -> dict[str, Lines]:
    t, truth, outputs = shown

    def line(name: str) -> tuple[Floats, Floats]:
        return t, outputs[name]

    def error(name: str) -> tuple[Floats, Floats]:
        return t, outputs[name] - truth

    signal = {"signal": (t, truth)}
    return {
        f"Signal and noisy readings, noise {SHOWN:g}.": {READINGS: line(READINGS), **signal},
        "The Kalman filters.": {KALMAN: line(KALMAN), BECALM: line(BECALM), **signal},
        "Noise before and after the filter.": {READINGS: error(READINGS), KALMAN: error(KALMAN)},
        "The Butterworth filter.": {BUTTERWORTH: line(BUTTERWORTH), **signal},
        "Errors of both.": {BUTTERWORTH: error(BUTTERWORTH), KALMAN: error(KALMAN), BECALM: error(BECALM)},
        "Software averaging.": {AVERAGE: line(AVERAGE), **signal},
    }


def _real(gauge: Gauge, until_s: float) -> Lines:
    first = gauge.time_s - gauge.time_s[0] < until_s
    lines = {READINGS: _envelope(gauge.time_s[first], gauge.readings[first])}
    every = max(1, int(first.sum()) // _POINTS)
    for name in _DRAWN:
        lines[name] = gauge.time_s[first][::every], gauge.trials[name].output[first][::every]
    return lines


def _envelope(time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return the least and greatest of values (N,) in each of some even parts, and when these begin."""
    begins = np.unique(np.linspace(0, len(values), _POINTS, endpoint=False).astype(np.intp))
    return time_s[begins], np.vstack([np.fmin.reduceat(values, begins), np.fmax.reduceat(values, begins)])


def _draw(path: Path, lines: Lines, unit: str) -> str:
    """Draw lines over time, and return the file's name."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 3.2), layout="constrained")
    axes: Any = figure.subplots()
    for name, (time_s, values) in lines.items():
        if values.ndim == 2:
            axes.fill_between(time_s, *values, label=name, color="0.8", linewidth=0.5)
        else:
            axes.plot(time_s, values, label=name, **_style(name))
    axes.set(xlabel="time (s)", ylabel=unit)
    axes.margins(x=0)
    axes.grid(color="0.93")
    axes.legend(fontsize=7, frameon=False)
    figure.savefig(path, metadata={"Date": None})
    return path.name


def _style(name: str) -> dict[str, str]:
    return {"signal": {"color": "black", "linestyle": "--"}, READINGS: {"color": "0.75"}}.get(name, {})
