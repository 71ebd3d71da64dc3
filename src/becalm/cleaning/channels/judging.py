"""Judge from the innovations whether the model describes the signal, and compute the uncertainty of the signal.

The judgement depends on the size of effects (such as the excess of an rms error), not on their significance alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from becalm.cleaning.recipes.recipe_parts import CalibrationRecipe, LimitsRecipe
from becalm.core.arrays import Floats
from becalm.core.rows import EstimatedRows
from becalm.identification.trust.tuning_spread import Colour
from becalm.metrics.whiteness import (
    PIECE,
    BlockCount,
    LaggedSums,
    Power,
    Running,
    ScoreCount,
    Whiteness,
    judge_whiteness,
)

PREDICTABLE = 0.10
"""Largest predictable share of the innovation power: 10 % increases the rms error of the prediction by 5 %."""

DESCRIBED = "The model describes the signal."

COSTLY = 0.10
"""Largest `excess_error` of a smoother for which predictable innovations do not matter."""

MOST_EXCEPTED = 0.5
"""Largest `excess_error` for which a predictable narrow band counts as an exception ("fits except")."""

FEWEST_INNOVATIONS = 8
"""Least number of innovations for a judgement."""

UNEVEN = 0.10
"""Largest share of the record in which sigma may be wrong by more than a factor of two."""

MISPLACED = 0.15
"""Largest misplaced share of the probability of the normal scores; 0.16 is that for a sigma 1.4 times too small."""

_FAR_OFF = 8.0  # for a record too short for blocks: largest factor by which its mean NIS may differ from 1
_NARROW = 1 / 32  # cycles per reading: half the width of a narrow band, which is the resolution of 32 lags
_CHANCE = 0.01  # p-value from which on a predictable share counts as chance
_LEAST = 1e-12  # least unpredictable share of the innovation power, so that the excess error is finite

Decision = Literal["fits", "fits except", "does not fit", "constant", "untold"]


@dataclass(frozen=True)
class Judgement:
    """The judgement of one channel's model, from its innovations.

    Attributes
    ----------
    verdict : {"fits", "fits except", "does not fit", "constant", "untold"}
        "fits except": the model describes all but a narrow band near `loudest_hz`. "untold": too few readings.
    whiteness_p : float or None
        p-value of the Ljung-Box test with 20 lags.
    first_correlation : float or None
        Correlation of successive innovations; it is positive if the filter is too slow and negative if it is too fast.
    predictable_share : float or None
        Share of the innovation power that is predictable from earlier innovations.
    excess_error : float or None
        Cost of predictable innovations: the share by which the rms error exceeds the least possible rms error. For a
        smoother it is the error of the signal, for a causal filter that of the prediction.
    loudest_hz : float or None
        Frequency at which the spectrum of the innovations is highest.
    uneven_share : float or None
        Share of those blocks of 50 innovations whose rms is below half, or above twice, the expected rms.
    nis_mean : float or None
        Mean squared normalised innovation; 1 is expected.
    lagged : LaggedSums or None
        Lagged sums of the normalised innovations, for the whiteness test.
    says : str
        The judgement as text.
    """

    verdict: Decision = "untold"
    whiteness_p: float | None = None
    first_correlation: float | None = None
    predictable_share: float | None = None
    excess_error: float | None = None
    loudest_hz: float | None = None
    uneven_share: float | None = None
    nis_mean: float | None = None
    lagged: LaggedSums | None = field(default=None, repr=False, compare=False)
    says: str = ""

    @property
    def describes(self) -> bool:
        """Return whether the model describes the signal, possibly except a narrow band."""
        return self.verdict in ("fits", "fits except", "constant")


class _Sums(NamedTuple):
    """The sums of the normalised innovations that a judgement needs."""

    lagged: LaggedSums = LaggedSums()
    blocks: BlockCount = BlockCount()
    power: Power = Power()
    scores: ScoreCount | None = None  # for a filter with several modes

    def extended(self, piece: Floats) -> _Sums:
        """Return the sums with the next innovations, (B,), added."""
        lagged, blocks, power, scores = self
        scores = None if scores is None else scores.extended(piece)
        return _Sums(lagged.extended(piece), blocks.extended(piece), power.extended(piece), scores)


class InnovationJudge:
    """A judge of one channel's model: it takes innovations in blocks of any length, and needs constant memory.

    Parameters
    ----------
    step_s : float
        Time between two innovations, in seconds.
    scores : bool
        Whether the innovations are normal scores times sigma, as for a filter with several modes. If so, their
        distribution must be normal.

    Examples
    --------
    >>> judge = InnovationJudge()
    >>> for innovations in np.random.default_rng(1).normal(scale=0.2, size=(10, 500)):
    ...     judge.add(innovations, 0.2)
    >>> judge.judgement().says
    'The model describes the signal.'
    """

    def __init__(self, step_s: float = 1.0, *, scores: bool = False) -> None:
        self._running = Running(_Sums(scores=ScoreCount() if scores else None), _Sums.extended)
        self._step_s = step_s

    def add(self, innovations: Floats, innovation_sigma: Floats | float) -> None:
        """Add a block of innovations.

        Parameters
        ----------
        innovations : (B,) float array
            Readings minus predictions, in unit, in order of time; NaN in rows without one.
        innovation_sigma : (B,) float array or float
            Expected standard deviations, in unit; one number for a filter in steady state.
        """
        sigma = np.broadcast_to(innovation_sigma, innovations.shape)
        for start in range(0, len(innovations), PIECE):
            part = slice(start, start + PIECE)
            self._running.add(innovations[part] / sigma[part])

    def judgement(self, excess_of: Callable[[Colour], float] | None = None) -> Judgement:
        """Judge all innovations so far; more may be added later.

        Parameters
        ----------
        excess_of : callable, optional
            Function from the power spectrum of the normalised innovations to the excess of the rms error, such as
            `becalm.identification.trust.tuning_spread.excess_error` for a smoother. By default the excess is that of
            the prediction.
        """
        sums = self._running.sums()
        if sums.power.seen < FEWEST_INNOVATIONS:
            return Judgement(says=f"Only {sums.power.seen} readings have an innovation: too few to judge the model.")
        found, nis = judge_whiteness(sums.lagged), sums.power.mean()
        uneven = sums.blocks.share() if sums.blocks.blocks else float(not 1 / _FAR_OFF < nis < _FAR_OFF)
        loudest_hz = None if found.loudest is None else found.loudest / self._step_s
        if excess_of is None:
            excess = float(1 / np.sqrt(max(1 - found.predictable_share, _LEAST))) - 1
        else:
            excess = excess_of(lambda angle: nis * found.predictor.power(angle))
        fault = _predictable(found, excess, loudest_hz, limited=excess_of is not None)
        narrow = bool(fault) and excess <= MOST_EXCEPTED and _is_narrow(found)
        faults = ([] if narrow or not fault else [fault]) + _changes(uneven)
        faults += [] if sums.scores is None else _misplaced(sums.scores.share())
        return Judgement(
            verdict="does not fit" if faults else "fits except" if narrow else "fits",
            whiteness_p=found.p_value,
            first_correlation=found.first_correlation,
            predictable_share=found.predictable_share,
            excess_error=excess,
            loudest_hz=loudest_hz,
            uneven_share=uneven,
            nis_mean=nis,
            lagged=sums.lagged,
            says=_sentence(faults, fault if narrow else "", loudest_hz) + _remark(found, excess, bool(fault)),
        )


def _predictable(found: Whiteness, excess: float, loudest_hz: float | None, *, limited: bool) -> str:
    """Return a clause on the predictable share if it is too large, or ""; `limited`: only if it is also costly."""
    much = found.predictable_share > PREDICTABLE and found.p_value < _CHANCE
    if not much or (limited and excess <= COSTLY):
        return ""
    character = "sluggish" if found.first_correlation > 0 else "nervous"
    return (
        f"{found.predictable_share:.0%} of the innovation power is still predictable, most of it near"
        f" {loudest_hz:.3g} Hz, which costs {excess:.0%} in rms error (the filter is {character}: coloured noise or a"
        " vibration counts as signal, or as noise)"
    )


def _is_narrow(found: Whiteness) -> bool:
    """Return whether the innovations are predictable only in a narrow band around their loudest frequency."""
    middle = found.loudest or 0.0
    width = max(_NARROW, middle / 10)
    inside = width < middle < 0.5 - width
    return inside and found.predictor.share_outside(middle, width) <= PREDICTABLE


def _changes(uneven: float) -> list[str]:
    """Return a clause on innovations of uneven size, if their share of the record is too large."""
    if uneven <= UNEVEN:
        return []
    return [
        "noise or motion changes so much that sigma is wrong by more than a factor of two in"
        f" {uneven:.0%} of the record"
    ]


def _misplaced(share: float) -> list[str]:
    """Return a clause on scores that are not normal, if the misplaced share of their probability is too large."""
    if share <= MISPLACED:
        return []
    return [f"readings are not distributed as its modes predict: {share:.0%} of their probability is misplaced"]


def _remark(found: Whiteness, excess: float, at_fault: bool) -> str:
    """Return a sentence on a predictable share that is large but costs a smoother next to nothing, or ""."""
    if at_fault or found.predictable_share <= PREDICTABLE or found.p_value >= _CHANCE:
        return ""
    return (
        f" It does not predict the next reading well ({found.predictable_share:.0%} of the innovation power is"
        f" predictable), but a better one would lower the rms error of the smoothed signal by {excess:.1%} only."
    )


def _sentence(faults: list[str], exception: str, loudest_hz: float | None) -> str:
    """Return the judgement as a sentence, from clauses on faults and on a narrow band that is an exception."""
    if faults:
        return (
            f"The model does not describe this signal: {'; and '.join([*faults, exception] if exception else faults)}."
        )
    if exception:
        return f"The model describes the signal except near {loudest_hz:.3g} Hz: {exception}."
    return DESCRIBED


# Compute the standard uncertainty of the signal from sigma, tuning, calibration and quantisation.
#
#     u(x)^2 = ((1 + spread) sigma)^2 + (x relative_std)^2 + offset_std^2 + rounding_std^2
#
# Averaging reduces the first term, which is random. It does not reduce the other terms, which are systematic: all
# samples have the same error (JCGM 100:2008, 3.3 and 5.1).


class Uncertainty:
    """A widening of sigma for tuning, calibration and quantisation; it also averages the magnitude of the signal.

    Parameters
    ----------
    spread : float
        Relative increase of sigma because the tuning is uncertain.
    calibration : CalibrationRecipe or None
        Uncertainty of the sensor's calibration.
    limits : LimitsRecipe or None
        Limits of the channel, with the quantisation error that averaging does not remove.
    """

    def __init__(
        self, spread: float, calibration: CalibrationRecipe | None, limits: LimitsRecipe | None = None
    ) -> None:
        self._factor, self._calibration = 1.0 + spread, calibration
        self._systematic = systematic_std(calibration, limits)
        self._magnitudes, self._rows = 0.0, 0

    def widened(self, estimates: Sequence[EstimatedRows]) -> list[EstimatedRows]:
        """Return the rows with their full uncertainty as sigma."""
        if self._factor == 1.0 and self._systematic is None:
            return list(estimates)
        return [self._widened(rows) for rows in estimates]

    @property
    def calibration_std(self) -> float | None:
        """Return the standard uncertainty of the calibration, in unit, at the mean magnitude of the signal so far."""
        if self._calibration is None or not self._rows:
            return None
        mean = self._magnitudes / self._rows
        return float(np.hypot(mean * self._calibration.relative_std, self._calibration.offset_std))

    def add_magnitudes(self, signal: Floats) -> None:
        """Add the magnitudes of a signal (B,) to their mean."""
        if self._calibration is not None:
            magnitudes = np.abs(signal[np.isfinite(signal)])
            self._magnitudes, self._rows = self._magnitudes + float(magnitudes.sum()), self._rows + len(magnitudes)

    def _widened(self, rows: EstimatedRows) -> EstimatedRows:
        sigma = self._factor * rows.sigma
        self.add_magnitudes(rows.signal)
        if self._systematic is not None:
            relative_std, offset_std = self._systematic
            systematic = np.hypot(rows.signal * relative_std, offset_std)
            sigma = np.where(np.isfinite(systematic), np.hypot(sigma, systematic), sigma)
        return rows._replace(sigma=sigma)


def systematic_std(calibration: CalibrationRecipe | None, limits: LimitsRecipe | None) -> tuple[float, float] | None:
    """Return the std of the errors that averaging does not reduce: a share of the signal, and one in unit; or None."""
    rounding_std = None if limits is None else limits.rounding_std
    if calibration is None:
        return None if rounding_std is None else (0.0, rounding_std)
    return calibration.relative_std, float(np.hypot(calibration.offset_std, rounding_std or 0.0))
