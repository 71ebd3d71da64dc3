"""Compute standard errors at a likelihood's maximum, and describe what the readings do not determine."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.identification.several.autocovariances import Autocovariances, Confounded
from becalm.identification.several.peak import FAR, NEGLIGIBLE_GAIN, Peak, half_drop_distance

_FLAT = 1.0  # least information about the log of a standard deviation for which a parabola describes the likelihood
_CHANGED = 0.5  # change from which on an amount counts as changed, as a share of the largest change
_GROWN = 100.0  # change from which on an amount counts as growing without bound, in units of its scale
_ENDLESS = (
    "No maximum was reached: the likelihood still rises, and there are no standard errors. A channel may be constant, a"
    ' copy of another, free of noise or full of spikes; leave it out, or hold its noise with "fixed".'
)


class Certainty(NamedTuple):
    """The standard errors of k amounts, and what the readings do not determine."""

    errors: Floats  # (k,) standard errors; inf where an amount is not determined
    sentences: tuple[str, ...]  # one for each finding about what is not determined


class Amounts(Protocol):
    """A log-likelihood whose parameters represent the amounts of patterns in Q and R."""

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the amounts."""

    @property
    def variances(self) -> Booleans:
        """Return a mask (k,) of the amounts that are variances."""

    def __call__(self, theta: Floats, /) -> float:
        """Return the log-likelihood at theta (k,)."""

    def amounts(self, theta: Floats) -> Floats:
        """Return the amounts (k,) at theta (k,)."""

    def scales(self, theta: Floats) -> Floats:
        """Return the scale (k,) of each amount: how large it could be."""

    def slopes(self, theta: Floats) -> Floats:
        """Return the derivatives (k, k) of the amounts with respect to theta."""


def judge(likelihood: Amounts, peak: Peak, moments: Autocovariances) -> Certainty:
    """Compute the standard errors of amounts, and describe those that are not determined.

    Parameters
    ----------
    likelihood : Amounts
        The log-likelihood.
    peak : Peak
        Its maximum.
    moments : Autocovariances
        The linear map that shows which amounts the readings can determine.
    """
    at_end = np.abs(peak.theta[likelihood.variances]).max() >= FAR
    if at_end or not peak.possible_gain < NEGLIGIBLE_GAIN:
        return Certainty(np.full(len(peak.theta), np.inf), (_ENDLESS,))
    slopes, undetermined = likelihood.slopes(peak.theta), moments.undetermined_amounts()
    sentences = [_unseen(likelihood.names[which]) for which in np.flatnonzero(moments.unseen)]
    sentences += [_confounded(likelihood.names, one, moments.rank) for one in moments.confounded]
    errors = np.zeros(len(slopes))
    for information, direction in _directions(peak.information, slopes, undetermined):
        if information >= _FLAT:
            errors = np.hypot(errors, slopes @ direction / np.sqrt(information))
        else:
            spread, sentence = _explore(likelihood, peak, direction)
            errors = np.hypot(errors, spread)
            sentences += sentence
    hidden = np.abs(undetermined).max(axis=1, initial=0.0) > 0
    return Certainty(np.where(hidden, np.inf, errors), tuple(dict.fromkeys(sentences)))


def _directions(information: Floats, slopes: Floats, undetermined: Floats) -> list[tuple[float, Floats]]:
    """Return the information along each of its principal directions (k,), orthogonal to the `undetermined` ones."""
    hidden = np.linalg.lstsq(slopes, undetermined, rcond=None)[0]
    basis, _, _ = np.linalg.svd(hidden, full_matrices=True) if undetermined.size else (np.eye(len(slopes)), 0, 0)
    determined = basis[:, undetermined.shape[1] :]
    values, vectors = np.linalg.eigh(determined.T @ information @ determined)
    return list(zip(values.tolist(), (determined @ vectors).T, strict=True))


def _explore(likelihood: Amounts, peak: Peak, direction: Floats) -> tuple[Floats, list[str]]:
    """Follow a flat direction both ways; return the change of each amount (k,), and sentences about the direction."""
    here, scales = likelihood.amounts(peak.theta), likelihood.scales(peak.theta)
    spread, lost, grown = np.zeros(len(here)), np.zeros(len(here), dtype=bool), np.zeros(len(here), dtype=bool)
    for way in (direction, -direction):
        distance = half_drop_distance(likelihood, peak, way)
        change = np.abs(likelihood.amounts(peak.theta + min(distance, FAR) * way) - here) / scales
        if np.isinf(distance):
            lost |= change > _CHANGED * change.max()
            grown |= change > _GROWN
        spread = np.maximum(spread, change * scales)
    return np.where(grown, np.inf, spread), _flat(likelihood, lost, grown)


def _unseen(name: str) -> str:
    return (
        f"{name} is not identifiable: the readings' autocovariances do not depend on it."
        ' Its value here is meaningless; leave it out, or hold it with "fixed".'
    )


def _confounded(names: tuple[str, ...], one: Confounded, rank: int) -> str:
    return (
        f"{names[one.which]} is not identifiable: one unit of it looks to the readings like"
        f" {_mixture(names, one.others)}, and their autocovariances determine {rank} of {len(names)} unknowns."
        ' Free less, with "diagonal", "scale" or "fixed".'
    )


def _flat(likelihood: Amounts, lost: Booleans, grown: Booleans) -> list[str]:
    if grown.any():
        return [f"{_listed(likelihood.names, grown)} cannot be determined: the likelihood does not fall as it grows."]
    if not lost.any():
        return []
    mixture = "" if lost.sum() == 1 and likelihood.variances[lost].all() else "A mixture of "
    listed = _listed(likelihood.names, lost)
    return [f"{mixture}{listed} cannot be distinguished from zero: the likelihood does not fall as it shrinks."]


def _listed(names: tuple[str, ...], chosen: Booleans) -> str:
    return " and ".join(name for name, take in zip(names, chosen, strict=True) if take)


def _mixture(names: tuple[str, ...], weights: Floats) -> str:
    parts = [f"{weight:+.3g} {name}" for name, weight in zip(names, weights, strict=True) if weight]
    return " ".join(parts) or "nothing"
