"""The car paper's Figures 6 to 10 redrawn, and the real car, as SVG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from becalm.core.arrays import Floats

if TYPE_CHECKING:
    from becalm.studies.car import CarStudy

_BINS = 500  # across a figure, each drawn by its least and its largest
_CLOSE_S = (20.0, 25.0)  # of the vertical acceleration, which is too quick for a minute across a figure


class Curve(NamedTuple):
    """A line of a figure."""

    name: str
    times_s: Floats  # (k,)
    values: Floats  # (k,)


class Figure(NamedTuple):
    """A figure before it is drawn."""

    file: str
    title: str
    axis: str
    curves: tuple[Curve, ...]


def thinned(name: str, times_s: Floats, values: Floats) -> Curve:
    """Return a curve with two points a bin, so that no peak is lost; NaN is left out."""
    seen = np.isfinite(values)
    t, y = times_s[seen], values[seen]
    if len(t) <= 2 * _BINS:
        return Curve(name, t, y)
    first = np.linspace(0, len(t), _BINS, endpoint=False).astype(int)
    extremes = np.column_stack([np.minimum.reduceat(y, first), np.maximum.reduceat(y, first)])
    return Curve(name, np.repeat(t[first], 2), extremes.ravel())


def plan(found: CarStudy) -> tuple[Figure, ...]:
    """Say what the figures show, from the numbers of the study."""
    from becalm.studies.car import MEASURED, OWN, PRINTED, TRUTH

    times, drawn = found.drive.truth.times_s, found.estimates

    def curves(column: int, *names: str, shown: slice = slice(None)) -> tuple[Curve, ...]:
        return tuple(thinned(name, times[shown], drawn[name][shown, column]) for name in names)

    close = slice(*np.searchsorted(times, _CLOSE_S))
    estimated = curves(2, PRINTED, OWN, TRUTH, shown=close)

    speed = thinned(MEASURED, times, found.drive.speed_kmh)
    along, up = "longitudinal acceleration (m/s²)", "vertical acceleration (m/s²)"
    planned = [
        Figure("car-6-speed.svg", "Figure 6: speed", "speed (km/h)", (speed,)),
        Figure("car-7-longitudinal.svg", "Figure 7: longitudinal acceleration", along, curves(1, MEASURED)),
        Figure("car-8-vertical.svg", "Figure 8: vertical acceleration", up, curves(2, MEASURED)),
        Figure("car-9-longitudinal.svg", "Figure 9: longitudinal, estimated", along, curves(1, PRINTED, OWN, TRUTH)),
        Figure("car-10-vertical.svg", "Figure 10: vertical, estimated, a few seconds of it", up, estimated),
    ]
    if found.real is not None:
        planned.append(_real(found))
    return tuple(planned)


def _real(found: CarStudy) -> Figure:
    assert found.real is not None
    real, times = found.real, found.real.record.times_s
    curves = (
        thinned("read", times, real.record.readings[:, 1]),
        thinned("three sensors", times, real.estimate[:, 1]),
        thinned("derivative of the speed", times, real.slope),
    )
    return Figure("car-real.svg", "A real car", "longitudinal acceleration (m/s²)", curves)


def figures(found: CarStudy, folder: Path) -> tuple[Path, ...]:
    """Draw the figures of a study into a folder; return where.

    Raises
    ------
    ModuleNotFoundError
        If matplotlib is not installed.
    """
    return tuple(_draw(figure, folder / figure.file) for figure in plan(found))


def _draw(planned: Figure, path: Path) -> Path:
    from matplotlib import rc_context
    from matplotlib.figure import Figure as Canvas

    with rc_context({"svg.hashsalt": "becalm", "svg.fonttype": "none"}):
        canvas = Canvas(figsize=(7, 2.8), layout="constrained")
        axes = canvas.add_subplot()
        for curve, colour in zip(planned.curves, _colours(planned.curves), strict=True):
            axes.plot(curve.times_s, curve.values, color=colour, linewidth=0.8, label=curve.name)
        axes.set(xlabel="time (s)", ylabel=planned.axis, title=planned.title)
        axes.margins(x=0)
        if len(planned.curves) > 1:
            canvas.legend(loc="outside lower center", ncols=3, fontsize="small", frameon=False)
        canvas.savefig(path, metadata={"Date": None})
    return path


def _colours(curves: Sequence[Curve]) -> Sequence[str]:
    return ("#9aa5b1",) if len(curves) == 1 else ("#b8c0c8", "#d1495b", "#1f2d3a")[: len(curves)]
