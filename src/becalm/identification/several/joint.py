"""Identify Q and R of any model with all its channels by maximum likelihood, with standard errors.

The likelihood is the filter's own: exact, with a known or a flat prior, and with missing readings. Nothing is
concentrated out, so every entry gets its standard error from the curvature. Sentences describe what the readings do not
determine. Sources: Schweppe, IEEE TIT-11 (1965) 61; Shumway and Stoffer, Time Series Analysis and Its Applications,
section 6.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Booleans, Floats
from becalm.core.filter.filtering import checked_readings, run_filter
from becalm.core.filter.likelihood import LIKELIHOOD_ONLY
from becalm.core.model.model import Model
from becalm.core.model.prior import arrived
from becalm.core.model.step_matrices import even_timeline
from becalm.errors import ModelError, RecordingError
from becalm.identification.several.autocovariances import Autocovariances, autocovariances
from becalm.identification.several.certainty import Certainty, judge
from becalm.identification.several.matrices import Freedom, FreeMatrix, Patterns, patterns_of
from becalm.identification.several.peak import climb, scale_variances

_LEAST_SHARE = 1e-3  # least effect of a starting variance on the readings, as a share of the largest effect


@dataclass(frozen=True, eq=False)
class TunedModel:
    """A model whose Q and R were identified from readings.

    Attributes
    ----------
    model : Model
        The likeliest model. An entry that the readings do not determine keeps its starting value.
    process_error : (p, p) float array
        Standard error of each entry of Q, in its unit; 0 where it was not free, inf where it is not determined.
    noise_error : (m, m) float array
        The same for R.
    log_likelihood : float
        Exact log-likelihood at the maximum; see `becalm.core.filter.filtering.Estimate`.
    used : int
        Number of readings used, each channel counted separately.
    not_identifiable : tuple of str
        A sentence for each quantity that the readings do not determine, with the reason; empty if there is none.
    """

    model: Model
    process_error: Floats
    noise_error: Floats
    log_likelihood: float
    used: int
    not_identifiable: tuple[str, ...]


def tune_model(
    model: Model, z: ArrayLike, free_process: Freedom = "diagonal", free_noise: Freedom = "diagonal"
) -> TunedModel:
    """Identify the process and measurement covariances of a model by maximum likelihood.

    Parameters
    ----------
    model : Model
        The model. F, G and H are fixed, and so are x0 and P0 or their absence. The search starts at its Q and R, or at
        an estimate by the readings' autocovariances if that is likelier.
    z : (N,) or (N, m) array_like
        Readings in the channels' units, one step per row; NaN where missing. The array is not modified.
    free_process, free_noise : {"full", "diagonal", "scale", "fixed"}
        Free entries of Q and of R. "full": all entries. "diagonal": the variances, with all other entries zero.
        "scale": one factor for each independent block, such as components joined by `+`. "fixed": none.

    Raises
    ------
    ModelError
        If z does not fit the model, nothing is free, or the model cannot start without x0 and P0.
    RecordingError
        If there are fewer readings than unknowns and states.

    Notes
    -----
    Standard errors come from the observed information by the delta method. Where a variance cannot be distinguished
    from zero, its error is the change at which the log-likelihood has fallen by one half.

    The prior of the states, `Model.known`, is fixed: the stationary prior of coloured noise is that for the Q of the
    given model.
    """
    readings = checked_readings(model, z)
    process, noise = patterns_of("Q", model.Q, free_process), patterns_of("R", model.R, free_noise)
    unknowns = len(process.names) + len(noise.names)
    if not unknowns:
        raise ModelError('Nothing of Q and R is free; give free_process or free_noise = "diagonal".')
    seen = arrived(readings)
    if seen.sum() <= unknowns + model.states:
        raise RecordingError(
            f"{seen.sum()} readings came; {unknowns} unknowns of Q and R and {model.states} states need more"
            f" than {unknowns + model.states}. Give a longer record, or free less of Q and R."
        )
    moments = autocovariances(model, process, noise, seen.T.astype(float) @ seen > 0, _sizes(readings, seen))
    free = Free((process, noise), (free_process == "full", free_noise == "full"))
    joint = _start(RecordLikelihood(model, readings), free, moments)
    peak = climb(joint, scale_variances(joint, np.zeros(unknowns), joint.variances & ~moments.unseen), joint.used)
    return _result(joint, judge(joint, peak, moments), peak.theta)


class Free(NamedTuple):
    """The free entries of Q and R."""

    patterns: tuple[Patterns, Patterns]  # of Q and of R
    full: tuple[bool, bool]  # True where every entry is free

    @property
    def variances(self) -> Booleans:
        """Return a mask (k,) of the amounts that are variances; their parameters are logarithms."""
        return np.concatenate([part.variances for part in self.patterns])

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the amounts."""
        return self.patterns[0].names + self.patterns[1].names

    def amounts(self, Q: Floats, R: Floats) -> Floats:
        """Return the amounts (k,) of the patterns in Q and R."""
        return np.concatenate([part.amounts(M) for part, M in zip(self.patterns, (Q, R), strict=True)])


class RecordLikelihood:
    """The log-likelihood of readings z (N, m), in the channels' units, as a function of Q and R."""

    def __init__(self, model: Model, z: Floats) -> None:
        self.model, self.z, self._timeline = model, z, even_timeline(model, len(z))

    def __call__(self, Q: Floats, R: Floats) -> tuple[float, int]:
        """Return the log-likelihood at Q and R, and its number of readings."""
        model, G = self.model, self.model.G
        timeline = self._timeline._replace(system=self._timeline.system._replace(Q=(G @ Q @ G.T)[np.newaxis], R=R))
        estimate = run_filter(model, timeline, self.z, LIKELIHOOD_ONLY).estimate
        return estimate.log_likelihood, estimate.used


class JointLikelihood:
    """The log-likelihood of readings as a function of parameters theta (k,) of the free entries of Q and R.

    All parameters are zero at the covariances that it is created with.
    """

    def __init__(self, record: RecordLikelihood, free: Free, Q: Floats, R: Floats) -> None:
        self.record, self.free = record, free
        self.process, self.noise = (
            FreeMatrix(part, M, full) for part, M, full in zip(free.patterns, (Q, R), free.full, strict=True)
        )
        self.used = record(Q, R)[1]

    @property
    def variances(self) -> Booleans:
        """Return a mask (k,) of the amounts that are variances; their parameters are logarithms."""
        return self.free.variances

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the amounts."""
        return self.free.names

    def __call__(self, theta: Floats) -> float:
        """Return the log-likelihood at theta (k,); -inf where it uses other readings than at the start."""
        try:
            value, used = self.record(*self.at(theta))
        except (ModelError, np.linalg.LinAlgError):
            return -np.inf
        return value if used == self.used else -np.inf

    def at(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return Q and R at theta (k,)."""
        cut = self.process.count
        return self.process.at(theta[:cut]), self.noise.at(theta[cut:])

    def amounts(self, theta: Floats) -> Floats:
        """Return the amounts (k,) of the patterns of Q and R at theta (k,)."""
        return self.free.amounts(*self.at(theta))

    def scales(self, theta: Floats) -> Floats:
        """Return the scale of each amount, (k,), for the variances at theta (k,)."""
        return np.concatenate([part.scales(M) for part, M in zip(self.free.patterns, self.at(theta), strict=True)])

    def slopes(self, theta: Floats) -> Floats:
        """Return the derivatives (k, k) of the amounts with respect to theta."""
        cut, slopes = self.process.count, np.zeros((len(theta), len(theta)))
        for i, slope in enumerate(self.process.slopes(theta[:cut])):
            slopes[:cut, i] = self.free.patterns[0].amounts(slope)
        for i, slope in enumerate(self.noise.slopes(theta[cut:])):
            slopes[cut:, cut + i] = self.free.patterns[1].amounts(slope)
        return slopes


def _sizes(z: Floats, seen: Booleans) -> Floats:
    """Return the RMS (m,) of each channel's readings (N, m), relative to the largest reading; 1 where all are zero."""
    largest = np.abs(np.where(seen, z, 0.0)).max()
    shares = np.where(seen, z, 0.0) / (largest if largest > 0 else 1.0)
    sizes = np.sqrt((shares**2).sum(axis=0) / np.maximum(seen.sum(axis=0), 1))
    return np.where(sizes > 0, sizes, 1.0)


def _start(record: RecordLikelihood, free: Free, moments: Autocovariances) -> JointLikelihood:
    """Return the likelihood with the likelier start: the model's own Q and R, or the estimate by autocovariances."""
    own = free.amounts(record.model.Q, record.model.R)
    starts = [_positive(free, moments, own)]
    estimate = moments.estimate(np.where(arrived(record.z), record.z, np.nan))
    if estimate is not None:
        starts.append(_positive(free, moments, np.where(moments.unseen, own, estimate)))
    return JointLikelihood(record, free, *max(starts, key=lambda matrices: record(*matrices)[0]))


def _positive(free: Free, moments: Autocovariances, amounts: Floats) -> tuple[Floats, Floats]:
    """Return Q and R for amounts (k,), with each free variance that affects the readings raised above zero."""
    strongest = (amounts * moments.lengths)[free.variances].max(initial=0.0)
    least = _LEAST_SHARE * (strongest if strongest > 0 else 1.0) / np.where(moments.unseen, np.inf, moments.lengths)
    amounts = np.where(free.variances, np.maximum(amounts, least), amounts)
    process, noise = free.patterns
    cut = len(process.names)
    Q, R = process.covariance(amounts[:cut]), noise.covariance(amounts[cut:])
    return _definite(Q) if free.full[0] else Q, _definite(R) if free.full[1] else R


def _definite(covariance: Floats) -> Floats:
    """Return a covariance with about the same variances, and correlations well below one."""
    sigma = np.sqrt(np.diag(covariance))
    sigma = np.where(sigma > 0, sigma, sigma[sigma > 0].min(initial=1.0))
    values, vectors = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    clipped = (vectors * np.maximum(values, 0.05)) @ vectors.T
    return np.asarray(clipped * np.outer(sigma, sigma))


def _result(joint: JointLikelihood, certainty: Certainty, theta: Floats) -> TunedModel:
    """Return the identified model with the standard errors of its Q and R."""
    given, (Q, R) = joint.record.model, joint.at(theta)
    tuned = Model(F=given.F, H=given.H, Q=Q, R=R, G=given.G, x0=given.x0, P0=given.P0, known=given.known)
    cut = len(joint.free.patterns[0].names)
    process_error, noise_error = (
        (np.where(part.shapes != 0, each[:, np.newaxis, np.newaxis], 0.0) * np.abs(part.shapes)).sum(axis=0)
        for part, each in zip(joint.free.patterns, (certainty.errors[:cut], certainty.errors[cut:]), strict=True)
    )
    return TunedModel(tuned, process_error, noise_error, joint(theta), joint.used, certainty.sentences)
