"""Draw the picture of README: two seconds of the simulated drive, measured and cleaned.

python docs/picture.py    # update docs/picture-light.svg and docs/picture-dark.svg
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from look import LOOK
from matplotlib import pyplot as plt

import becalm
from becalm.studies.drive import simulate

FOLDER = Path(__file__).parent
SHOWN_S = (20.0, 22.0)
CHANNEL, QUANTITY = "acceleration_z (m/s^2)", "vertical acceleration (m/s²)"
INKED = ("axes.edgecolor", "axes.labelcolor", "text.color", "xtick.color", "ytick.color")
COLOURS = {
    "light": {"ink": "#1f2328", "readings": "#9aa4ae", "clean": "#0969da", "paper": "#ffffff"},
    "dark": {"ink": "#e6edf3", "readings": "#6e7681", "clean": "#58a6ff", "paper": "#0d1117"},
}


def draw(colours: dict[str, str], file: Path) -> None:
    """Draw readings, signal and two sigma to a file."""
    recording = simulate().measured
    out = becalm.clean(recording, channels=[CHANNEL])
    times = recording.timebase.times_s
    shown = slice(*np.searchsorted(times, SHOWN_S))
    signal, sigma = (one.channel(CHANNEL)[shown] for one in (out.signal, out.sigma))
    style = LOOK | {
        "figure.figsize": (8, 3),
        "svg.fonttype": "path",  # the reader of README may not have the font
        "axes.spines.top": False,
        "axes.spines.right": False,
        **dict.fromkeys(INKED, colours["ink"]),
        **dict.fromkeys(("axes.facecolor", "figure.facecolor", "savefig.facecolor"), colours["paper"]),
    }
    with mpl.rc_context(style):
        figure, axes = plt.subplots()
        axes.plot(
            times[shown], recording.channel(CHANNEL)[shown], ".", ms=2.5, color=colours["readings"], label="readings"
        )
        band = {"color": colours["clean"], "alpha": 0.3, "lw": 0, "label": "two standard uncertainties"}
        axes.fill_between(times[shown], signal - 2 * sigma, signal + 2 * sigma, **band)
        axes.plot(times[shown], signal, color=colours["clean"], lw=1.5, label="signal")
        axes.set(xlabel="time (s)", ylabel=QUANTITY, xlim=SHOWN_S)
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)
        figure.savefig(file, metadata={"Date": None})
        plt.close(figure)


if __name__ == "__main__":
    for name, colours in COLOURS.items():
        draw(colours, FOLDER / f"picture-{name}.svg")
