"""Figures for print: matplotlib draws what is described, as SVG, PDF or PNG."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from itertools import cycle
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.report.description import Band, Curve, Figure, Lane, Role, Rule, Surface
from becalm.report.envelope import Envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Kind = Literal["png", "svg", "pdf"]

COLOURS: dict[Role, str] = {"readings": "#9aa5b1", "clean": "#0f62c4", "truth": "#101820", "limit": "#101820"}
OTHERS = ("#d55e00", "#117733", "#aa4499", "#8a6d00", "#2a9d9d", "#5b4a9c")
"""Told apart by the colour-blind too."""

_LOOKS = {"line": "-", "dashed": "--", "dotted": ":", "points": ""}
_WIDTH, _HEIGHT, _LANE = 7.5, 2.6, 0.16  # inches: a sheet, a row, and a lane of one
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.8, 0.15, 0.3, 0.45  # inches about the axes of a figure
_STRETCHES = 400  # of a band: more no print shows
_TOO_FINE = re.compile(rb"(\d\.\d\d)\d+")  # less than a hundredth of a point
_SETTINGS: Any = {
    "svg.hashsalt": "becalm",  # the same figure gives the same bytes
    "svg.fonttype": "none",
    "path.simplify_threshold": 0.5,  # pixels
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.93",
    "legend.fontsize": 8,
    "legend.frameon": False,
}
_UNDATED: dict[Kind, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}


def can_print() -> bool:
    """Whether matplotlib is here."""
    return find_spec("matplotlib") is not None


def refuse_unprintable() -> None:
    """Raise a UsageError where matplotlib is not here."""
    if not can_print():
        raise UsageError("Figures are drawn by matplotlib, which is not here; type: pip install 'becalm[figures]'")


def printed(figures: Sequence[Figure], kind: Kind = "svg", columns: int = 1) -> bytes:
    """Draw figures onto one sheet.

    Parameters
    ----------
    figures : sequence of Figure
        Row by row.
    kind : {"png", "svg", "pdf"}
        What to draw them as.
    columns : int
        How many stand beside each other.

    Raises
    ------
    UsageError
        If matplotlib is not installed.
    """
    refuse_unprintable()
    from matplotlib import rc_context
    from matplotlib.figure import Figure as Sheet

    rows = [figures[start : start + columns] for start in range(0, len(figures), columns)]
    heights = [max(_height(figure) for figure in row) for row in rows]
    total, width = sum(heights), _WIDTH / columns
    with rc_context(_SETTINGS):
        sheet = Sheet(figsize=(_WIDTH, total))
        for row, height, below in zip(rows, heights, total - np.cumsum(heights), strict=True):
            for column, figure in enumerate(row):  # in inches, for a layout that is sought takes as long as drawing
                left, bottom = column * width + _LEFT, below + _BOTTOM
                across, up = width - _LEFT - _RIGHT, height - _TOP - _BOTTOM
                _draw(sheet.add_axes((left / _WIDTH, bottom / total, across / _WIDTH, up / total)), figure)
        file = io.BytesIO()
        sheet.savefig(file, format=kind, dpi=150, metadata=_UNDATED[kind])
    return _TOO_FINE.sub(rb"\1", file.getvalue()) if kind == "svg" else file.getvalue()


def _height(figure: Figure) -> float:
    lanes = [layer for layer in figure.layers if isinstance(layer, Lane)]
    return _TOP + _BOTTOM + _LANE * len(lanes) if lanes else _HEIGHT


def _draw(axes: Axes, figure: Figure) -> None:
    others, lanes = cycle(OTHERS), 0
    for layer in figure.layers:
        if isinstance(layer, Surface):
            _draw_surface(axes, layer)
        elif isinstance(layer, Lane):
            spans = list(zip(layer.starts, layer.ends - layer.starts, strict=True))
            axes.broken_barh(spans, (-lanes - 0.4, 0.8), color=OTHERS[lanes % len(OTHERS)])
            lanes += 1
        elif isinstance(layer, Rule):
            axes.axvline(layer.at, color=_colour(layer, others), linestyle=":", linewidth=1, label=layer.name)
        else:
            _draw_layer(axes, layer, others)
    if any(isinstance(layer, Band | Lane) for layer in figure.layers):
        axes.margins(x=0)  # what has time in common lies in line
    axes.set(title=figure.title, xlabel=figure.x.label, ylabel=figure.y.label)
    axes.set(xscale="log" if figure.x.log else "linear", yscale="log" if figure.y.log else "linear")
    axes.set(xlim=(figure.x.low, figure.x.high), ylim=(figure.y.low, figure.y.high))
    for axis, told in ((axes.xaxis, figure.x), (axes.yaxis, figure.y)):
        if told.log:
            axis.set_major_formatter("{x:g}")  # powers set as mathematics take a third of the time
    axes.minorticks_off()
    if lanes:
        names = [layer.name for layer in figure.layers if isinstance(layer, Lane)]
        axes.set_yticks(-np.arange(lanes), names)
    elif len(figure.layers) > 1:
        axes.legend(loc="upper right")  # the best place takes long to find


def _colour(layer: Curve | Band | Rule, others: Iterator[str]) -> str:
    return COLOURS.get(layer.role) or next(others)


def _draw_layer(axes: Axes, layer: Curve | Band, others: Iterator[str]) -> None:
    colour = _colour(layer, others)
    if isinstance(layer, Band):
        edge: dict[str, Any] = {"alpha": 0.25, "linewidth": 0} if layer.faint else {"linewidth": 0.6}
        axes.fill_between(*_thinned(layer), color=colour, label=layer.name, **edge)
        return
    marker = "o" if layer.look == "points" else None
    style: dict[str, Any] = {"color": colour, "label": layer.name or None, "linewidth": 1}
    axes.plot(layer.x, layer.y, _LOOKS[layer.look], marker=marker, markersize=5, **style)
    for text, *place in zip(layer.labels, layer.x, layer.y, strict=False):
        axes.annotate(text, tuple(place), xytext=(5, 5), textcoords="offset points", fontsize=8)


def _thinned(band: Band) -> tuple[Floats, Floats, Floats]:
    """Return a band of no more stretches than are seen."""
    each = [Envelope.of(values, _STRETCHES) for values in (band.x, band.low, band.high)]
    return (each[0].low + each[0].high) / 2, each[1].low, each[2].high


def _draw_surface(axes: Axes, layer: Surface) -> None:
    filled = axes.contourf(layer.x, layer.y, layer.height.T, 16)
    axes.figure.colorbar(filled, ax=axes, label=layer.name)
