"""Encode figures as JSON for the page, with each array once, as base64: x as float64, y as float32."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.report.data.description import Axis, Band, DrawnSurface, Figure, Lane, Layer, Rule

_LEAST, _MOST = 1e-30, 1e30  # magnitudes that float32 can hold with full precision
_NEAR = 0.1  # values with a smaller range, relative to the first value, are stored as differences from it


class _Arrays:
    """The arrays of a page; each is stored once."""

    def __init__(self) -> None:
        self.encoded: list[dict[str, object]] = []
        self._places: dict[tuple[int, bool], tuple[int, Floats]] = {}  # a reference keeps each id unique

    def place(self, values: Floats, *, exact: bool) -> int:
        """Return the index of an array; exact arrays are stored as float64, others as float32 if possible."""
        key = (id(values), exact)
        if key not in self._places:
            self._places[key] = len(self.encoded), values
            self.encoded.append(_encoded(values, exact))
        return self._places[key][0]


def _encoded(values: Floats, exact: bool) -> dict[str, object]:
    """Return an array as base64; in float32, a large offset is stored separately, so that no digits are lost."""
    finite = values[np.isfinite(values)]
    largest = float(np.abs(finite).max(initial=0.0))
    if exact or (largest and not _LEAST < largest < _MOST):
        return {"float64": _text(np.asarray(values, dtype="<f8"))}
    near = len(finite) and np.ptp(finite) < _NEAR * abs(finite[0])
    offset = float(finite[0]) if near else 0.0
    return {"float32": _text((values - offset).astype("<f4")), "offset": offset}


def _text(values: np.ndarray[Any, Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def payload(figures: Sequence[Figure]) -> str:
    """Return figures as JSON that is safe inside a script element of a page.

    Raises
    ------
    TypeError
        If a figure has a surface, which only print can show.
    """
    arrays = _Arrays()
    drawn = [_figure(figure, arrays) for figure in figures]
    text = json.dumps({"arrays": arrays.encoded, "figures": drawn}, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")  # a name cannot end the script element


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
    shared: dict[str, object] = {"name": layer.name, "role": layer.role, "x": arrays.place(layer.x, exact=True)}
    if isinstance(layer, Band):
        edges = {"low": arrays.place(layer.low, exact=False), "high": arrays.place(layer.high, exact=False)}
        return {"kind": "band", **shared, **edges, "faint": layer.faint}
    y = arrays.place(layer.y, exact=False)
    return {"kind": "curve", **shared, "y": y, "look": layer.look, "labels": list(layer.labels)}
