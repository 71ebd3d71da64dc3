"""Draw figures for print with matplotlib, as SVG, PDF or PNG."""

from __future__ import annotations

import gc
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from itertools import cycle
from threading import Thread
from typing import TYPE_CHECKING, Any, Literal, NamedTuple
from warnings import catch_warnings, filterwarnings

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.report.data.description import Band, Curve, DrawnSurface, Figure, Lane, Role, Rule
from becalm.report.data.envelope import Envelope

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

Kind = Literal["png", "svg", "pdf"]

COLOURS: dict[Role, str] = {"readings": "#9aa5b1", "clean": "#0f62c4", "truth": "#101820", "limit": "#101820"}
OTHERS = ("#d55e00", "#117733", "#aa4499", "#8a6d00", "#2a9d9d", "#5b4a9c")
"""Colours of "other" layers, which colour-blind people can distinguish."""

_NUMBERS = 6  # largest number of tick labels of an axis; each takes time to draw
_LOOKS = {"line": "-", "dashed": "--", "dotted": ":", "points": "none"}
_MARKERS = "osD^"  # different shapes, so that points at the same place can be distinguished
_WIDTH, _HEIGHT, _SQUARE, _LANE = 7.5, 1.85, 2.6, 0.16  # inches: sheet width; height of axes, of a surface, of a lane
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.8, 0.15, 0.3, 0.45  # margins around the axes of a figure, in inches
_SCALE = 0.55  # width of the colour bar of a surface, in inches
_ENTRY, _MARK, _LETTER = 0.16, 0.42, 0.062  # inches in a legend: height of an entry, width of its mark, of a letter
_NARROW = 100.0  # ratio of limits below which a logarithmic axis has labels between powers of ten
_EDGE = 0.15  # share of the axes' width, on each side, that counts as near an edge
_ABOVE = 1.05  # height of an axis, relative to the highest value on it
_STRETCHES = 400  # largest number of stretches of a band, because print cannot show more
_TAG = re.compile(rb"<[^<>]*>")
_TOO_FINE = re.compile(rb"(\d\.\d\d)\d+")  # digits beyond hundredths of a point
_SETTINGS: Any = {
    "svg.hashsalt": "becalm",  # the same figure gives the same bytes
    "svg.fonttype": "none",
    "text.parse_math": False,  # a name may contain a dollar sign
    "path.simplify_threshold": 0.5,  # pixels
    "font.size": 9,
    "axes.titlesize": "medium",
    "axes.titley": 1.0,  # the search for a better place takes a tenth of the time
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.93",
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.columnspacing": 1.0,
}
_UNDATED: dict[Kind, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {}}


def can_print() -> bool:
    """Return whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def load_meanwhile() -> None:
    """Import matplotlib in a thread, if it is installed; the import takes a second, in which other work continues."""
    if can_print():
        Thread(target=import_module, args=["matplotlib.figure"], daemon=True).start()


def refuse_unprintable() -> None:
    """Raise a UsageError if matplotlib is not installed."""
    if not can_print():
        raise UsageError("Figures need matplotlib, which is not installed; type: pip install 'becalm[figures]'")


def printed(figures: Sequence[Figure], kind: Kind = "svg", columns: int = 1) -> bytes:
    """Draw figures on one sheet, and return the bytes of its file.

    Parameters
    ----------
    figures : sequence of Figure
        Figures, row by row.
    kind : {"png", "svg", "pdf"}
        File format.
    columns : int
        Number of figures in a row.

    Raises
    ------
    UsageError
        If matplotlib is not installed.
    """
    refuse_unprintable()
    from matplotlib import rc_context
    from matplotlib.figure import Figure as Sheet

    rows = [figures[start : start + columns] for start in range(0, len(figures), columns)]
    width = _WIDTH / columns
    rooms = [[_Room.of(figure, width) for figure in row] for row in rows]
    ups = [max(room.up for room in row) for row in rooms]
    downs = [max(room.down for room in row) for row in rooms]
    heights = _TOP + np.add(ups, downs)
    total = float(heights.sum())
    with rc_context(_SETTINGS), _without_garbage_collection():
        sheet = Sheet(figsize=(_WIDTH, total))
        feet = total - np.cumsum(heights)
        for row, row_rooms, up, down, foot in zip(rows, rooms, ups, downs, feet, strict=True):
            for column, (figure, room) in enumerate(zip(row, row_rooms, strict=True)):
                # positions are computed here, because matplotlib's automatic layout takes as long as drawing
                left = column * width + _LEFT
                place = left / _WIDTH, (foot + down) / total, room.across / _WIDTH, up / total
                _draw(axes := sheet.add_axes(place), figure)
                _annotate(axes, figure, -_BOTTOM / up, room.entries)
        file = io.BytesIO()
        with catch_warnings():
            filterwarnings("ignore", message="Glyph")  # the font may lack letters of a name; SVG stores them as text
            sheet.savefig(file, format=kind, dpi=150, metadata=_UNDATED[kind])
    return _TAG.sub(_round_numbers, file.getvalue()) if kind == "svg" else file.getvalue()


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Disable garbage collection in a `with`; a sheet has so many objects that it takes a seventh of the time."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def _round_numbers(tag: re.Match[bytes]) -> bytes:
    """Round coordinates within a tag; the text between tags is not changed."""
    return _TOO_FINE.sub(rb"\1", tag[0])


class _Room(NamedTuple):
    """The size of a figure on a sheet."""

    across: float  # width of its axes in inches
    up: float  # height of its axes in inches
    down: float  # room below its axes in inches
    entries: int  # entries in a line of the legend; 0 without a legend

    @classmethod
    def of(cls, figure: Figure, width: float) -> _Room:
        kinds, names = [type(layer) for layer in figure.layers], _legend_names(figure)
        lanes = kinds.count(Lane)
        across, up = width - _LEFT - _RIGHT, _LANE * lanes if lanes else _HEIGHT
        if DrawnSurface in kinds:
            across, up = across - _SCALE, _SQUARE
        if not names:
            return cls(across, up, _BOTTOM, 0)
        entries = max(1, min(len(names), int(width / (_MARK + _LETTER * max(map(len, names))))))
        return cls(across, up, _BOTTOM + _ENTRY * -(-len(names) // entries), entries)


def _legend_names(figure: Figure) -> list[str]:
    """Return the names of layers in the legend; none for a figure with one layer."""
    if len(figure.layers) < 2:
        return []
    return [layer.name for layer in figure.layers if isinstance(layer, Curve | Band | Rule) and layer.name]


def _draw(axes: Axes, figure: Figure) -> None:
    others, markers, lanes = cycle(OTHERS), cycle(_MARKERS), 0
    for layer in figure.layers:
        if isinstance(layer, DrawnSurface):
            _draw_surface(axes, layer)
        elif isinstance(layer, Lane):
            spans = list(zip(layer.starts, layer.ends - layer.starts, strict=True))
            axes.broken_barh(spans, (-lanes - 0.4, 0.8), color=OTHERS[lanes % len(OTHERS)])
            lanes += 1
        elif isinstance(layer, Rule):
            axes.axvline(layer.at, color=_colour(layer, others), linestyle=":", linewidth=1, label=layer.name)
        elif isinstance(layer, Band):
            _draw_band(axes, layer, _colour(layer, others))
        else:
            _draw_curve(axes, layer, _colour(layer, others), markers)


def _annotate(axes: Axes, figure: Figure, legend_height: float, entries: int) -> None:
    """Set titles, scales, limits and tick labels of the axes, and draw the legend.

    Parameters
    ----------
    axes : Axes
        Axes with all layers drawn.
    figure : Figure
        Description of the figure.
    legend_height : float
        Top of the legend, as a share of the axes' height; negative below them.
    entries : int
        Number of entries in a line of the legend; 0 for no legend.
    """
    from matplotlib.ticker import MaxNLocator

    if not any(isinstance(layer, Curve) and layer.look == "points" for layer in figure.layers):
        axes.margins(x=0)  # no margins, so that figures with the same time axis are aligned
    axes.set(title=figure.title, xlabel=figure.x.label, ylabel=figure.y.label)
    x_log, y_log = (figure.x.log, figure.y.log) & np.isfinite(axes.dataLim.minpos)  # only if there is a positive value
    axes.set(xscale="log" if x_log else "linear", yscale="log" if y_log else "linear")
    axes.set(xlim=(figure.x.low, figure.x.high), ylim=(figure.y.low, figure.y.high))
    _leave_room_above(axes, figure.y.low, figure.y.high)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            _number(axis)
        else:
            axis.set_major_locator(MaxNLocator(_NUMBERS, steps=(1, 2, 2.5, 5, 10)))
    axes.minorticks_off()
    lanes = [layer.name for layer in figure.layers if isinstance(layer, Lane)]
    if lanes:
        axes.set_yticks(-np.arange(len(lanes)), lanes)
    for layer in figure.layers:
        if isinstance(layer, Curve):
            _label(axes, layer)
    if entries:
        anchor = (0.5, legend_height)
        axes.legend(loc="upper center", bbox_to_anchor=anchor, borderaxespad=0, borderpad=0, ncols=entries)


def _leave_room_above(axes: Axes, low: float | None, high: float | None) -> None:
    """Leave room above the highest value, if the axis has a lower limit but no upper limit."""
    highest = axes.dataLim.y1
    if low is not None and high is None and np.isfinite(highest) and highest > low:
        axes.set_ylim(top=low + _ABOVE * (highest - low))


def _number(axis: Axis) -> None:
    """Choose the tick labels of a logarithmic axis."""
    from matplotlib.ticker import LogLocator

    axis.set_major_formatter("{x:g}")  # mathematical typesetting of powers takes a third of the time
    low, high = axis.get_view_interval()
    if high < _NARROW * low:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))  # matplotlib uses even steps if these are too few


def _colour(layer: Curve | Band | Rule, others: Iterator[str]) -> str:
    return COLOURS.get(layer.role) or next(others)


def _draw_band(axes: Axes, layer: Band, colour: str) -> None:
    edge: dict[str, Any] = {"alpha": 0.25, "linewidth": 0} if layer.faint else {"linewidth": 0.6}
    axes.fill_between(*_thin_band(layer), color=colour, label=layer.name or None, **edge)


def _draw_curve(axes: Axes, layer: Curve, colour: str, markers: Iterator[str]) -> None:
    style: dict[str, Any] = {"color": colour, "label": layer.name or None, "linewidth": 1}
    if layer.look == "points":
        style |= {"marker": next(markers), "markersize": 5, "markerfacecolor": "none"}
    axes.plot(layer.x, layer.y, linestyle=_LOOKS[layer.look], **style)
    finite = np.isfinite(np.concatenate([[np.nan], layer.y, [np.nan]]))
    alone = finite[1:-1] & ~finite[:-2] & ~finite[2:]  # points without neighbours, which a line does not show
    if layer.look != "points" and alone.any():
        axes.plot(layer.x[alone], layer.y[alone], color=colour, marker=".", markersize=2, linestyle="none")


def _label(axes: Axes, layer: Curve) -> None:
    """Write the labels of points above the points; near an edge of the axes, shift a label so that it stays inside."""
    for text, *place in zip(layer.labels, layer.x, layer.y, strict=False):
        if np.isfinite(place).all():
            share = axes.transAxes.inverted().transform(axes.transData.transform(place))[0]
            side = "left" if share < _EDGE else "right" if share > 1 - _EDGE else "center"
            axes.annotate(text, tuple(place), xytext=(0, 5), textcoords="offset points", ha=side, fontsize=8)


def _thin_band(band: Band) -> tuple[Floats, Floats, Floats]:
    """Return a band reduced to at most `_STRETCHES` stretches."""
    each = [Envelope.of(values, _STRETCHES) for values in (band.x, band.low, band.high)]
    return (each[0].low + each[0].high) / 2, each[1].low, each[2].high


def _draw_surface(axes: Axes, layer: DrawnSurface) -> None:
    place = (layer.x, layer.y, layer.height.T)
    grey = "Greys"  # grey, because the layers on top have colours
    filled: Any
    if layer.by_point:
        filled = axes.pcolormesh(*place, cmap=grey, shading="nearest", rasterized=True)
    else:
        filled = axes.contourf(*place, 16, cmap=grey)
    axes.figure.colorbar(filled, ax=axes, label=layer.name)
