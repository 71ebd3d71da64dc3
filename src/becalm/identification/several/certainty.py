"""How well a likelihood's maximum is known, and what the readings do not tell, in sentences."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.identification.several.autocovariances import Autocovariances, Confounded
from becalm.identification.several.peak import AT_REST, FAR, Peak, reach

_FLAT = 1.0  # information in the logarithm of a standard deviation, below which no parabola is trusted
_CHANGED = 0.5  # of what changes most
_GROWN = 100.0  # times what it could be
_ENDLESS = (
    "No maximum was reached: the likelihood still rises, and no errors can be told. A channel may be constant, a copy"
    ' of another, free of noise or full of spikes; leave it out, or hold its noise with "fixed".'
)


class Certainty(NamedTuple):
    """What is known of k amounts."""

    errors: Floats  # (k,) standard errors; inf where an amount cannot be told
    sentences: tuple[str, ...]


class Amounts(Protocol):
    """A log-likelihood whose numbers stand for amounts of patterns in Q and R."""

    @property
    def names(self) -> tuple[str, ...]:
        """What the amounts are called."""

    @property
    def variances(self) -> Booleans:
        """Which amounts are of variances, (k,)."""

    def __call__(self, theta: Floats, /) -> float:
        """Return the log-likelihood at theta (k,)."""

    def amounts(self, theta: Floats) -> Floats:
        """Return the amounts (k,) at theta (k,)."""

    def scales(self, theta: Floats) -> Floats:
        """Return how large they could be, (k,)."""

    def slopes(self, theta: Floats) -> Floats:
        """Return their derivatives by theta, (k, k)."""


def judge(likelihood: Amounts, peak: Peak, told: Autocovariances) -> Certainty:
    """Find standard errors of amounts, and what cannot be told.

    Parameters
    ----------
    likelihood : Amounts
        The log-likelihood.
    peak : Peak
        Its maximum.
    told : Autocovariances
        What the readings can tell at all: along other directions the likelihood is flat for certain.
    """
    at_end = np.abs(peak.theta[likelihood.variances]).max() >= FAR
    if at_end or not peak.rising < AT_REST:
        return Certainty(np.full(len(peak.theta), np.inf), (_ENDLESS,))
    slopes, untold = likelihood.slopes(peak.theta), told.untold()
    sentences = [_unseen(likelihood.names[which]) for which in np.flatnonzero(told.unseen)]
    sentences += [_confounded(likelihood.names, one, told.rank) for one in told.confounded]
    errors = np.zeros(len(slopes))
    for information, direction in _directions(peak.information, slopes, untold):
        if information >= _FLAT:
            errors = np.hypot(errors, slopes @ direction / np.sqrt(information))
        else:
            spread, sentence = _explore(likelihood, peak, direction)
            errors = np.hypot(errors, spread)
            sentences += sentence
    hidden = np.abs(untold).max(axis=1, initial=0.0) > 0
    return Certainty(np.where(hidden, np.inf, errors), tuple(dict.fromkeys(sentences)))


def _directions(information: Floats, slopes: Floats, untold: Floats) -> list[tuple[float, Floats]]:
    """Return principal directions of the information, and how much of it, beside what is not told."""
    hidden = np.linalg.lstsq(slopes, untold, rcond=None)[0]
    basis, _, _ = np.linalg.svd(hidden, full_matrices=True) if untold.size else (np.eye(len(slopes)), 0, 0)
    open_to_readings = basis[:, untold.shape[1] :]
    values, vectors = np.linalg.eigh(open_to_readings.T @ information @ open_to_readings)
    return list(zip(values.tolist(), (open_to_readings @ vectors).T, strict=True))


def _explore(likelihood: Amounts, peak: Peak, direction: Floats) -> tuple[Floats, list[str]]:
    """Follow a flat direction both ways; return how far it leads each amount (k,), and what to say of it."""
    here, scales = likelihood.amounts(peak.theta), likelihood.scales(peak.theta)
    spread, lost, grown = np.zeros(len(here)), np.zeros(len(here), dtype=bool), np.zeros(len(here), dtype=bool)
    for way in (direction, -direction):
        far = reach(likelihood, peak, way)
        change = np.abs(likelihood.amounts(peak.theta + min(far, FAR) * way) - here) / scales
        if np.isinf(far):
            lost |= change > _CHANGED * change.max()
            grown |= change > _GROWN
        spread = np.maximum(spread, change * scales)
    return np.where(grown, np.inf, spread), _flat(likelihood, lost, grown)


def _unseen(name: str) -> str:
    return (
        f"{name} is not identifiable: the readings' autocovariances do not depend on it."
        ' Its value here says nothing; leave it out, or hold it with "fixed".'
    )


def _confounded(names: tuple[str, ...], one: Confounded, rank: int) -> str:
    return (
        f"{names[one.which]} is not identifiable: one unit of it looks to the readings like"
        f" {_mixture(names, one.others)}, and their autocovariances tell {rank} of {len(names)} unknowns."
        ' Free less, with "diagonal", "scale" or "fixed".'
    )


def _flat(likelihood: Amounts, lost: Booleans, grown: Booleans) -> list[str]:
    if grown.any():
        return [f"{_listed(likelihood.names, grown)} cannot be told: the likelihood does not fall as it grows."]
    if not lost.any():
        return []
    mixture = "" if lost.sum() == 1 and likelihood.variances[lost].all() else "A mixture of "
    listed = _listed(likelihood.names, lost)
    return [f"{mixture}{listed} cannot be told from zero: the likelihood does not fall as it shrinks."]


def _listed(names: tuple[str, ...], chosen: Booleans) -> str:
    return " and ".join(name for name, take in zip(names, chosen, strict=True) if take)


def _mixture(names: tuple[str, ...], weights: Floats) -> str:
    parts = [f"{weight:+.3g} {name}" for name, weight in zip(names, weights, strict=True) if weight]
    return " ".join(parts) or "nothing"
