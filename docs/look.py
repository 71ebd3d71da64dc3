"""The style of the gallery's pictures, which are small SVG files with text as text, and the order of its pages."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
from sphinx_gallery.scrapers import matplotlib_scraper

LOOK = {
    "svg.hashsalt": "becalm",
    "svg.fonttype": "none",
    "font.size": 9,
    "lines.linewidth": 1,
    "figure.figsize": (8, 4.5),
    "figure.constrained_layout.use": True,
}


ORDER = (
    "drive",
    "low_pass",
    "gap",
    "hum",
    "spikes",
    "switching",
    "seams",
    "beside_a_classic",
    "nile",
    "alpha_beta",
    "imu_optimum",
)


class PageOrder:
    """The key by which sphinx-gallery sorts the pages: their order in `ORDER`."""

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def __call__(self, name: str) -> int:
        """Return the position of a script; raise a ValueError if it is not in `ORDER`."""
        return ORDER.index(name.removesuffix(".py"))


def as_svg(*args: Any, **options: Any) -> str:
    """Save the figures of a gallery page as SVG."""
    return str(matplotlib_scraper(*args, format="svg", metadata={"Date": None}, **options))


def same_look(*_: Any) -> None:
    """Reset the style before each gallery page, because the page before may have changed it."""
    mpl.rcdefaults()
    mpl.rcParams.update(LOOK)
