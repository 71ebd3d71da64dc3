"""The zero-knob choice of a motion, and of tones beside it.

A causal filter is tuned by likelihood, orders 1 to 3; where even the likeliest does not describe the
signal, `risk` gives back what it took for motion. A smoother is tuned by cross-validation, orders 1 to 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.components import EVERY_ORDER, ORDERS
from becalm.noise.cross_validation import lasting, simplest, tune_smoother
from becalm.noise.likelihood import Evidence, Tuning, tune_motion
from becalm.noise.lines import add_lines
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
        The winner, of a "motion": perhaps retuned, perhaps with tones.
    motion : Tuning or None
        The winner without its tones.
    rivals : tuple of Tuning
        Every order that was tried, alone.
    """

    kind: Literal["motion", "constant", "untold"]
    tuning: Tuning | None = None
    motion: Tuning | None = None
    rivals: tuple[Tuning, ...] = ()


def orders_run(elapsed: Floats, causal: bool) -> tuple[int, ...]:
    """Return the orders whose kernels choosing runs, over a record of these steps (N,) of which none is missing."""
    if causal:
        return ORDERS
    even = Evidence.of(np.zeros(len(elapsed)), elapsed)
    return () if lasting(even) else EVERY_ORDER


def choose(readings: Floats, elapsed: Floats, causal: bool = True) -> Choice:
    """Identify the noise of one channel and choose its motion.

    Parameters
    ----------
    readings : (N,) float array
        In the channel's unit, NaN where missing.
    elapsed : (N,) float array
        Steps since the row before.
    causal : bool
        Whether the filter shall run causally; a smoother is tuned for smoothing.
    """
    seen = readings[np.isfinite(readings)]
    if len(seen) < FEWEST_READINGS:
        return Choice("untold")
    if np.all(seen == seen[0]):
        return Choice("constant")
    evidence = Evidence.of(readings, elapsed)
    smoothers = () if causal else tune_smoother(evidence)
    if smoothers:
        best = simplest(smoothers)
        return Choice("motion", add_lines(best, evidence), best, smoothers)
    rivals = tuple(tune_motion(order, evidence) for order in ORDERS)
    likeliest = max(rivals, key=lambda tuning: tuning.log_likelihood)
    best = retune(likeliest, evidence) if causal else likeliest
    return Choice("motion", add_lines(best, evidence), best, rivals)
