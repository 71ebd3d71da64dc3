"""How the pictures of the gallery look: small SVG files whose text is text."""

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


class Shown:
    """In which order the gallery shows its pages."""

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def __call__(self, name: str) -> int:
        """Return the place of a script; raise a ValueError if it has none."""
        return ORDER.index(name.removesuffix(".py"))


def as_svg(*args: Any, **options: Any) -> str:
    """Keep the figures of a gallery page as SVG."""
    return str(matplotlib_scraper(*args, format="svg", metadata={"Date": None}, **options))


def same_look(*_: Any) -> None:
    """Begin each gallery page with the same look, whatever the one before did."""
    mpl.rcdefaults()
    mpl.rcParams.update(LOOK)
