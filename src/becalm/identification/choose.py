"""Choose the motion model of a channel, and its tones, without any setting.

The tuning of a causal filter maximises the likelihood, for orders 1 to 3. If even the likeliest model does not describe
the signal, `risk.retune` raises R to the noise floor of the spectrum. The tuning of a smoother minimises a
cross-validation criterion, for orders 1 to 5. If no order can be tuned by that criterion, the tuning maximises the
likelihood.
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
from becalm.identification.known_noise import tune_with_known_noise
from becalm.identification.likelihood import FEWEST_READINGS, UNSCORED, Evidence, Tuning, tune_motion
from becalm.identification.risk import choose_by_risk, retune
from becalm.identification.tones import add_tones

__all__ = ["FEWEST_READINGS", "NOTHING_KNOWN", "Choice", "PriorKnowledge", "choose"]


@dataclass(frozen=True)
class Choice:
    """The identified model of one channel, and the models it was compared with.

    Attributes
    ----------
    kind : {"motion", "constant", "untold"}
        "constant": all readings are equal. "untold": undetermined; there are too few readings to separate noise from
        signal, or gaps cut them into stretches that are too short for a motion model.
    tuning : Tuning or None
        The chosen model where `kind` is "motion": damped, perhaps with tones and coloured noise.
    motion : Tuning or None
        The chosen model without damping, tones and coloured noise.
    rivals : tuple of Tuning
        The tunings of all orders that were compared, each without damping, tones and coloured noise; empty if the noise
        was known.
    """

    kind: Literal["motion", "constant", "untold"]
    tuning: Tuning | None = None
    motion: Tuning | None = None
    rivals: tuple[Tuning, ...] = ()

    def counted_in(self, steps: float) -> Choice:
        """Return the same choice in a new time step that is `steps` old steps long."""
        if steps == 1.0 or self.tuning is None or self.motion is None:
            return self
        rivals = tuple(rival.counted_in(steps) for rival in self.rivals)
        return Choice(self.kind, self.tuning.counted_in(steps), self.motion.counted_in(steps), rivals)


@dataclass(frozen=True)
class PriorKnowledge:
    """What the caller already knows about one channel.

    Attributes
    ----------
    noise : NoiseModel or None
        Noise of the channel, measured at rest. With it, only the motion is tuned, without a search for tones.
    removed : tuple of float
        Angles, in radians per step, of tones that are disturbances and are removed from the signal.
    """

    noise: NoiseModel | None = None
    removed: tuple[float, ...] = ()

    def counted_in(self, steps: float) -> PriorKnowledge:
        """Return the same knowledge in a new time step that is `steps` old steps long."""
        return self if steps == 1.0 else PriorKnowledge(self.noise, tuple(angle * steps for angle in self.removed))


NOTHING_KNOWN = PriorKnowledge()


def choose(readings: Floats, elapsed: Floats, causal: bool = True, known: PriorKnowledge = NOTHING_KNOWN) -> Choice:
    """Identify the noise of one channel and choose its motion.

    Parameters
    ----------
    readings : (N,) float array
        Measurements in the channel's unit, NaN where missing.
    elapsed : (N,) float array
        Time since the previous row, in steps.
    causal : bool
        True tunes a causal filter, False a smoother.
    known : PriorKnowledge
        Noise and tones that are known, and therefore not identified.

    Raises
    ------
    RecordingError
        If the noise is known, and gaps cut the readings into stretches that are too short for a motion model.
    ModelError
        If coloured noise is known, and a reading lies between two steps of that noise.
    """
    seen = readings[np.isfinite(readings)]
    if len(seen) < FEWEST_READINGS:
        return Choice("untold")
    if np.all(seen == seen[0]):
        return Choice("constant")
    evidence = Evidence.of(readings, elapsed)
    own_step = 1.0 if known.noise is not None else evidence.own_step
    choice = _choose_in_own_step(evidence.counted_in(own_step), causal, known.counted_in(own_step))
    return choice.counted_in(1 / own_step)


def _choose_in_own_step(evidence: Evidence, causal: bool, known: PriorKnowledge) -> Choice:
    """Choose a motion model; the time step is such that most readings are one step apart."""
    if known.noise is not None:
        tuning = tune_with_known_noise(evidence, known.noise.white_variance, known.noise.coloured, causal=causal)
        return Choice("motion", damped(tuning, evidence), replace(tuning, coloured=None))
    smoothers = () if causal else tune_smoother(evidence)
    if smoothers:
        best = simplest(smoothers)
        return _choose_damped(best, evidence, causal, known.removed, smoothers)
    rivals = tuple(tune_motion(order, evidence) for order in ORDERS)
    if max(tuning.count for tuning in rivals) < FEWEST_READINGS - UNSCORED:
        return Choice("untold")
    likeliest = max(rivals, key=lambda tuning: tuning.log_likelihood)
    best = retune(likeliest, evidence) if causal else likeliest
    return _choose_damped(best, evidence, causal, known.removed, rivals)


def _choose_damped(
    best: Tuning, evidence: Evidence, causal: bool, removed: tuple[float, ...], rivals: tuple[Tuning, ...]
) -> Choice:
    """Add tones to a motion model and damp it, so that its spread equals that of the record."""
    toned = _add_tones(best, evidence, causal, removed)
    return Choice("motion", damped(toned, evidence), best, rivals)


def _add_tones(plain: Tuning, evidence: Evidence, causal: bool, removed: tuple[float, ...]) -> Tuning:
    """Add tones to a motion model if they reduce the estimated risk of the filter, or of the smoother.

    The spectrum alone may mislead: it is an average over the whole record, even if the frequency changes as in a chirp.
    """
    toned = add_tones(plain, evidence, removed)
    if not toned.tones or any(tone.disturbance for tone in toned.tones):
        return toned
    return choose_by_risk(toned, plain, evidence, causal)
