"""Figures as JSON for the page: each array once, in base64; what runs along as float64, what it tells as float32."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.report.description import Axis, Band, DrawnSurface, Figure, Lane, Layer, Rule

_LEAST, _MOST = 1e-30, 1e30  # magnitudes that float32 holds well
_NEAR = 0.1  # of the first value: values no farther from it lose digits unless it is taken off


class _Arrays:
    """Arrays of a page, each kept once."""

    def __init__(self) -> None:
        self.held: list[dict[str, object]] = []
        self._known: dict[tuple[int, bool], tuple[int, Floats]] = {}  # with the array, so that its id stays its own

    def place(self, values: Floats, *, exact: bool) -> int:
        """Return the place of an array: an exact one is kept as float64, others as float32 if that holds them."""
        key = (id(values), exact)
        if key not in self._known:
            self._known[key] = len(self.held), values
            self.held.append(_encoded(values, exact))
        return self._known[key][0]


def _encoded(values: Floats, exact: bool) -> dict[str, object]:
    """Return an array as text; of what lies far from 0 an offset is taken off, which would cost digits."""
    known = values[np.isfinite(values)]
    largest = float(np.abs(known).max(initial=0.0))
    if exact or (largest and not _LEAST < largest < _MOST):
        return {"float64": _text(np.asarray(values, dtype="<f8"))}
    near = len(known) and np.ptp(known) < _NEAR * abs(known[0])
    offset = float(known[0]) if near else 0.0
    return {"float32": _text((values - offset).astype("<f4")), "offset": offset}


def _text(values: np.ndarray[Any, Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def payload(figures: Sequence[Figure]) -> str:
    """Return figures as JSON that may stand inside a script element of a page.

    Raises
    ------
    TypeError
        If a figure holds a surface, which only print shows.
    """
    arrays = _Arrays()
    drawn = [_figure(figure, arrays) for figure in figures]
    text = json.dumps({"arrays": arrays.held, "figures": drawn}, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")  # so that no name ends the script


def _figure(figure: Figure, arrays: _Arrays) -> dict[str, object]:
    return {
        "name": figure.name,
        "title": figure.title,
        "x": _axis(figure.x),
        "y": _axis(figure.y),
        "layers": [_layer(layer, arrays) for layer in figure.layers],
    }


def _axis(axis: Axis) -> dict[str, object]:
    return axis._asdict()


def _layer(layer: Layer, arrays: _Arrays) -> dict[str, object]:
    if isinstance(layer, DrawnSurface):
        raise TypeError(f"The surface {layer.name!r} is for print only.")
    if isinstance(layer, Lane):
        edges = {"starts": arrays.place(layer.starts, exact=True), "ends": arrays.place(layer.ends, exact=True)}
        return {"kind": "lane", "name": layer.name, **edges}
    if isinstance(layer, Rule):
        return {"kind": "rule", **layer._asdict()}
    told: dict[str, object] = {"name": layer.name, "role": layer.role, "x": arrays.place(layer.x, exact=True)}
    if isinstance(layer, Band):
        edges = {"low": arrays.place(layer.low, exact=False), "high": arrays.place(layer.high, exact=False)}
        return {"kind": "band", **told, **edges, "faint": layer.faint}
    y = arrays.place(layer.y, exact=False)
    return {"kind": "curve", **told, "y": y, "look": layer.look, "labels": list(layer.labels)}
