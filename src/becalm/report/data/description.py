"""Describe figures, independently of whether they are drawn on an interactive page or for print."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from becalm.core.arrays import Floats

Role = Literal["readings", "clean", "truth", "limit", "other"]
"""Meaning of a layer, which determines its colour; each "other" layer has another colour."""

Look = Literal["line", "dashed", "dotted", "points"]


class Axis(NamedTuple):
    """The label, scale and limits of an axis."""

    label: str  # with the unit
    log: bool = False
    low: float | None = None
    high: float | None = None


class Curve(NamedTuple):
    """A line or a set of points."""

    name: str
    x: Floats  # (k,)
    y: Floats  # (k,) NaN where there is no value
    role: Role = "other"
    look: Look = "line"
    labels: tuple[str, ...] = ()  # one for each point


class Band(NamedTuple):
    """An area between two lines: the envelope of many samples, or an uncertainty."""

    name: str
    x: Floats  # (k,)
    low: Floats  # (k,) NaN where there is no value
    high: Floats  # (k,) NaN where there is no value
    role: Role = "other"
    faint: bool = False  # whether the area is translucent


class Lane(NamedTuple):
    """Intervals on the x axis, drawn as bars on a separate line of the figure."""

    name: str
    starts: Floats  # (k,)
    ends: Floats  # (k,)


class Rule(NamedTuple):
    """A vertical line at one position on the x axis."""

    name: str
    at: float  # position on the x axis
    role: Role = "other"


class DrawnSurface(NamedTuple):
    """Heights over a plane, drawn as filled contours or as coloured cells; for print only."""

    name: str
    x: Floats  # (k,)
    y: Floats  # (l,)
    height: Floats  # (k, l)
    by_point: bool = False  # coloured cells instead of contours, for a rough surface that would have too many contours


Layer = Curve | Band | Lane | Rule | DrawnSurface


@dataclass(frozen=True)
class Figure:
    """The description of a figure.

    Attributes
    ----------
    name : str
        Name of the figure's file and of its element on a page: letters, digits and hyphens.
    title : str
        Title above the figure.
    x, y : Axis
        Axes.
    layers : tuple of Curve, Band, Lane, Rule or DrawnSurface
        Layers, in the order of drawing.
    says : str
        Caption below the figure: one or two sentences on what it shows.
    """

    name: str
    title: str
    x: Axis
    y: Axis
    layers: tuple[Layer, ...]
    says: str = ""
