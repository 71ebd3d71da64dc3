"""Does the model describe the signal? Judged by the size of the effect, said in a sentence."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.metrics.evenness import BlockCount
from becalm.metrics.lagged import LaggedSums
from becalm.metrics.running import PIECE, Running
from becalm.metrics.whiteness import Power, Whiteness, judge_whiteness

PREDICTABLE = 0.10
"""Share of the innovation power that may still be predictable: 10 % costs 5 % in rms prediction."""

DESCRIBED = "The model describes the signal."

NOTHING_REMOVED = 0.8
"""Noise gain above which a filter has found next to no noise to remove."""

UNEVEN = 0.10
"""Share of the record in which sigma may be wrong by more than a factor of two."""


@dataclass(frozen=True)
class ChannelReport:
    """What was found and done for one channel.

    Attributes
    ----------
    name, unit : str
        As in the recording.
    model : str
        "motion", "constant" or "untold".
    order : int or None
        Order of the motion.
    tones_hz : tuple of float
        Frequencies of the tones beside it.
    noise_std : float or None
        Standard deviation of one reading's noise, in unit.
    q_over_r : float or None
        Ratio of process to measurement noise, per step.
    bandwidth_hz, lag_s : float or None
        -3 dB bandwidth; delay of a slow ramp or of a step at half of its height, the longer one.
    log_likelihood : float or None
        Of the readings, given the recipe.
    settled_row : int or None
        The first row whose gain was the settled one.
    whiteness_p : float or None
        Ljung-Box, 20 lags.
    first_correlation : float or None
        Of neighbouring innovations; positive: sluggish, negative: nervous.
    predictable_share : float or None
        Share of the innovation power that is still predictable.
    loudest_hz : float or None
        Where the spectrum of the innovations is highest.
    uneven_share : float or None
        Share of the record whose innovations are half or twice as large as expected, or worse.
    nis_mean : float or None
        Mean squared normalised innovation; 1 is right.
    verdicts : dict
        How many readings were used, missing, and so on.
    describes : bool
        Whether the model describes the signal.
    says : str
        The judgement as a sentence, with what to do.
    """

    name: str = ""
    unit: str = ""
    model: str = ""
    order: int | None = None
    tones_hz: tuple[float, ...] = ()
    noise_std: float | None = None
    q_over_r: float | None = None
    bandwidth_hz: float | None = None
    lag_s: float | None = None
    log_likelihood: float | None = None
    settled_row: int | None = None
    whiteness_p: float | None = None
    first_correlation: float | None = None
    predictable_share: float | None = None
    loudest_hz: float | None = None
    uneven_share: float | None = None
    nis_mean: float | None = None
    verdicts: dict[str, int] = field(default_factory=dict)
    describes: bool = True
    says: str = ""

    def as_dict(self) -> dict[str, object]:
        """Return the report for JSON; what is unknown is None."""
        return {key: _finite(value) for key, value in asdict(self).items()}


@dataclass(frozen=True)
class Judgement:
    """What the innovations of one channel say of its model."""

    whiteness_p: float
    first_correlation: float
    predictable_share: float
    loudest_hz: float | None
    uneven_share: float
    nis_mean: float
    describes: bool
    says: str


class _Sums(NamedTuple):
    """What is summed of the normalised innovations."""

    lagged: LaggedSums = LaggedSums()
    blocks: BlockCount = BlockCount()
    power: Power = Power()

    def extended(self, piece: Floats) -> _Sums:
        return _Sums(self.lagged.extended(piece), self.blocks.extended(piece), self.power.extended(piece))


class InnovationJudge:
    """Judges one channel by its innovations, which come in blocks of any length; its memory is constant.

    Parameters
    ----------
    step_s : float
        Step between them, in seconds.

    Examples
    --------
    >>> judge = InnovationJudge()
    >>> for innovations in np.random.default_rng(1).normal(scale=0.2, size=(10, 500)):
    ...     judge.add(innovations, 0.2)
    >>> judge.judgement().says
    'The model describes the signal.'
    """

    def __init__(self, step_s: float = 1.0) -> None:
        self._running = Running(_Sums(), _Sums.extended)
        self._step_s = step_s

    def add(self, innovations: Floats, innovation_sigma: Floats | float) -> None:
        """Add a block.

        Parameters
        ----------
        innovations : (B,) float array
            Reading minus prediction, in order of time; NaN where there is none.
        innovation_sigma : (B,) float array or float
            Standard deviation expected of them, same unit; one number for a settled filter.
        """
        sigma = np.broadcast_to(innovation_sigma, innovations.shape)
        for start in range(0, len(innovations), PIECE):
            part = slice(start, start + PIECE)
            self._running.add(innovations[part] / sigma[part])

    def judgement(self) -> Judgement:
        """Judge all innovations so far; more may follow."""
        sums = self._running.sums()
        found, uneven = judge_whiteness(sums.lagged), sums.blocks.share()
        loudest_hz = None if found.loudest is None else found.loudest / self._step_s
        faults = _faults(found, loudest_hz, uneven)
        return Judgement(
            found.p_value,
            found.first_correlation,
            found.predictable_share,
            loudest_hz,
            uneven,
            sums.power.mean(),
            not faults,
            _sentence(faults),
        )


def _faults(found: Whiteness, loudest_hz: float | None, uneven: float) -> list[str]:
    faults = []
    if found.predictable_share > PREDICTABLE:
        character = "sluggish" if found.first_correlation > 0 else "nervous"
        faults.append(
            f"{found.predictable_share:.0%} of the innovation power is still predictable, most of it near"
            f" {loudest_hz:.3g} Hz (the filter is {character}: coloured noise or a vibration passes for signal)"
        )
    if uneven > UNEVEN:
        faults.append(
            f"noise or motion changes so much that sigma is wrong by more than a factor of two in {uneven:.0%} of"
            " the record"
        )
    return faults


def _sentence(faults: list[str]) -> str:
    if not faults:
        return DESCRIBED
    return f"The model does not describe this signal: {'; and '.join(faults)}."


def _finite(value: object) -> object:
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
