"""A figure before it is drawn: one description for the page, where it can be looked into, and for print."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from becalm.core.arrays import Floats

Role = Literal["readings", "clean", "truth", "limit", "other"]
"""What a layer stands for, which decides its colour; "other" ones differ from each other."""

Look = Literal["line", "dashed", "dotted", "points"]


class Axis(NamedTuple):
    """What is measured along an axis."""

    label: str  # with its unit
    log: bool = False
    low: float | None = None
    high: float | None = None


class Curve(NamedTuple):
    """A line, or points."""

    name: str
    x: Floats  # (k,)
    y: Floats  # (k,) NaN where there is none
    role: Role = "other"
    look: Look = "line"
    labels: tuple[str, ...] = ()  # of points, one each


class Band(NamedTuple):
    """What lies between two lines: an envelope of many samples, or an uncertainty."""

    name: str
    x: Floats  # (k,)
    low: Floats  # (k,) NaN where there is none
    high: Floats  # (k,)
    role: Role = "other"
    faint: bool = False  # whether what is behind it shows through


class Lane(NamedTuple):
    """Stretches along the x axis during which something holds, in a lane of their own."""

    name: str
    starts: Floats  # (k,)
    ends: Floats  # (k,)


class Rule(NamedTuple):
    """A place on the x axis."""

    name: str
    at: float
    role: Role = "other"


class DrawnSurface(NamedTuple):
    """Heights over a plane, drawn as filled contours, or point by point; for print only."""

    name: str
    x: Floats  # (k,)
    y: Floats  # (l,)
    height: Floats  # (k, l)
    by_point: bool = False  # of a rough one, whose contours would be many


Layer = Curve | Band | Lane | Rule | DrawnSurface


@dataclass(frozen=True)
class Figure:
    """What a figure shows.

    Attributes
    ----------
    name : str
        Of its file, and of its place on a page: letters, digits and hyphens.
    title : str
        Above it.
    x, y : Axis
        Its axes.
    layers : tuple of Curve, Band, Lane, Rule or DrawnSurface
        The first is behind all others.
    says : str
        What is to be seen, in a sentence or two; below it.
    """

    name: str
    title: str
    x: Axis
    y: Axis
    layers: tuple[Layer, ...]
    says: str = ""
