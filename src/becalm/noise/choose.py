"""The zero-knob choice: motions of order 1, 2 and 3, each tuned by likelihood; the likeliest wins.

Where even the likeliest does not describe the signal, `risk` gives a causal filter back what it took for motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.components import ORDERS
from becalm.noise.likelihood import Evidence, Tuning, tune_motion
from becalm.noise.risk import retune

FEWEST_READINGS = 8
"""Fewer readings than this cannot tell noise from signal."""


@dataclass(frozen=True)
class Choice:
    """What was found for one channel.

    Attributes
    ----------
    kind : {"motion", "constant", "untold"}
        "constant": all readings are equal. "untold": too few readings to tell noise from signal.
    tuning : Tuning or None
        The winner, of a "motion"; retuned where it does not describe the signal.
    rivals : tuple of Tuning
        Every order that was tried.
    """

    kind: Literal["motion", "constant", "untold"]
    tuning: Tuning | None = None
    rivals: tuple[Tuning, ...] = ()


def choose(readings: Floats, elapsed: Floats, causal: bool = True) -> Choice:
    """Identify the noise of one channel and choose its motion.

    Parameters
    ----------
    readings : (N,) float array
        In the channel's unit, NaN where missing.
    elapsed : (N,) float array
        Steps since the row before.
    causal : bool
        Whether the filter shall run causally; where no motion fits, its risk then sets the tuning.
    """
    seen = readings[np.isfinite(readings)]
    if len(seen) < FEWEST_READINGS:
        return Choice("untold")
    if np.all(seen == seen[0]):
        return Choice("constant")
    evidence = Evidence.of(readings, elapsed)
    rivals = tuple(tune_motion(order, evidence) for order in ORDERS)
    likeliest = max(rivals, key=lambda tuning: tuning.log_likelihood)
    return Choice("motion", retune(likeliest, evidence) if causal else likeliest, rivals)
