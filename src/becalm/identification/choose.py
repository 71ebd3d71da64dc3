"""The zero-knob choice of a motion, and of tones beside it.

A causal filter is tuned by likelihood, orders 1 to 3; where even the likeliest does not describe the
signal, `risk` gives back what it took for motion. A smoother is tuned by cross-validation, orders 1 to 5.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.components import ORDERS
from becalm.identification.coloured import NoiseModel
from becalm.identification.cross_validation import simplest, tune_smoother
from becalm.identification.damping import damped
from becalm.identification.known_noise import tune_beside
from becalm.identification.likelihood import FEWEST_READINGS, UNSCORED, Evidence, Tuning, tune_motion
from becalm.identification.lines import add_lines
from becalm.identification.risk import less_risky, retune

__all__ = ["FEWEST_READINGS", "NOTHING_KNOWN", "Choice", "PriorKnowledge", "choose"]


@dataclass(frozen=True)
class Choice:
    """What was found for one channel.

    Attributes
    ----------
    kind : {"motion", "constant", "untold"}
        "constant": all readings are equal. "untold": too few readings to tell noise from signal, or
        gaps part them into stretches that tell no motion.
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

    def counted_in(self, steps: float) -> Choice:
        """Return the same where a step is so many of its own long."""
        if steps == 1.0 or self.tuning is None or self.motion is None:
            return self
        rivals = tuple(rival.counted_in(steps) for rival in self.rivals)
        return Choice(self.kind, self.tuning.counted_in(steps), self.motion.counted_in(steps), rivals)


@dataclass(frozen=True)
class PriorKnowledge:
    """What is known of one channel before it is looked at.

    Attributes
    ----------
    noise : NoiseModel or None
        Its noise, told at rest; a motion is tuned beside it, and no tones are looked for.
    removed : tuple of float
        Angles, radians a step, of tones that are disturbances.
    """

    noise: NoiseModel | None = None
    removed: tuple[float, ...] = ()

    def counted_in(self, steps: float) -> PriorKnowledge:
        """Return the same where a step is so many of its own long."""
        return self if steps == 1.0 else PriorKnowledge(self.noise, tuple(angle * steps for angle in self.removed))


NOTHING_KNOWN = PriorKnowledge()


def choose(readings: Floats, elapsed: Floats, causal: bool = True, known: PriorKnowledge = NOTHING_KNOWN) -> Choice:
    """Identify the noise of one channel and choose its motion.

    Parameters
    ----------
    readings : (N,) float array
        In the channel's unit, NaN where missing.
    elapsed : (N,) float array
        Steps since the row before.
    causal : bool
        Whether the filter shall run causally; a smoother is tuned for smoothing.
    known : PriorKnowledge
        What need not be found.

    Raises
    ------
    RecordingError
        If noise is known, and gaps part the readings into stretches that tell no motion.
    ModelError
        If coloured noise is known, and is to be told between its steps.
    """
    seen = readings[np.isfinite(readings)]
    if len(seen) < FEWEST_READINGS:
        return Choice("untold")
    if np.all(seen == seen[0]):
        return Choice("constant")
    every = Evidence.of(readings, elapsed)
    own = 1.0 if known.noise is not None else every.own_step
    return _chosen(every.counted_in(own), causal, known.counted_in(own)).counted_in(1 / own)


def _chosen(evidence: Evidence, causal: bool, known: PriorKnowledge) -> Choice:
    """Choose a motion for readings most of which lie a step apart."""
    if known.noise is not None:
        beside = tune_beside(evidence, known.noise.white_variance, known.noise.coloured, causal=causal)
        return Choice("motion", damped(beside, evidence), replace(beside, coloured=None))
    smoothers = () if causal else tune_smoother(evidence)
    if smoothers:
        best = simplest(smoothers)
        return _returning(best, evidence, causal, known.removed, smoothers)
    rivals = tuple(tune_motion(order, evidence) for order in ORDERS)
    if max(tuning.count for tuning in rivals) < FEWEST_READINGS - UNSCORED:
        return Choice("untold")
    likeliest = max(rivals, key=lambda tuning: tuning.log_likelihood)
    best = retune(likeliest, evidence) if causal else likeliest
    return _returning(best, evidence, causal, known.removed, rivals)


def _returning(
    best: Tuning, evidence: Evidence, causal: bool, removed: tuple[float, ...], rivals: tuple[Tuning, ...]
) -> Choice:
    """Choose a motion with its tones, bounded by the record's own spread."""
    toned = _toned(best, evidence, causal, removed)
    return Choice("motion", damped(toned, evidence), best, rivals)


def _toned(alone: Tuning, evidence: Evidence, causal: bool, removed: tuple[float, ...]) -> Tuning:
    """Put tones beside a motion, if the filter, or the smoother, is better for it over the record itself.

    A spectrum is that of the whole record; where the record is no one thing, as a chirp, it deceives.
    """
    toned = add_lines(alone, evidence, removed)
    if not toned.lines or any(line.disturbance for line in toned.lines):
        return toned
    return less_risky(toned, alone, evidence, causal)
