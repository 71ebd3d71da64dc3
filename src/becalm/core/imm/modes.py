"""Interacting multiple models: several modes, each a model of its own, one of which is in force at a time.

Still when it is still, quick when it moves: a fixed gain must trade noise against lag, a gain that follows
the mode need not. Each mode has its component, its measurement noise, and how long it lasts on average;
which mode is in force is told from the readings (interacting multiple models, Blom and Bar-Shalom 1988).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.components import Component
from becalm.core.model.magnitudes import largest_beside, largest_level
from becalm.core.steady.steady_gain import steady
from becalm.errors import ModelError
from becalm.native.imm import MOST_MODES, Bank, Steps

_WIDE = 1e6  # times the variance of a settled filter's slopes: what is known of them before the first readings
_ASLEEP = 1e-6  # times the process noise of one step, which a state has that sleeps
_MOST_BANKS = 16
_TERMS = 16  # of a series whose argument is below 1/4


@dataclass(frozen=True)
class Mode:
    """One way in which a signal may behave.

    Attributes
    ----------
    name : str
        As "still" or "moving".
    component : Component
        The signal, in steps. One of fewer states than the richest mode's has the first of its states, the others
        sleep: they are all but 0, and wake with the process noise of a step.
    noise_variance : float
        R, the variance of a reading's noise, in unit^2.
    lasts : float
        Mean number of steps before it ends; a *large* one trusts the mode to stay.
    then : str
        The mode that follows it; "" for any other, all alike.
    wild_share : float
        Share of readings, in this mode, that are wild: spread by `InteractingModels.wild_variance`. A *small* one
        believes in a switch sooner than in a wild reading.
    """

    name: str
    component: Component
    noise_variance: float
    lasts: float
    then: str = ""
    wild_share: float = 0.0


@dataclass(frozen=True)
class InteractingModels:
    """Interacting multiple models: the modes, and how wild measurements are treated.

    Attributes
    ----------
    modes : tuple of Mode
        One to eight, the calmest first.
    wild_variance : float
        By how much a wild reading's variance exceeds a tame one's, in unit^2.
    rejects : bool
        Whether a wild reading is left out of the estimate, or only told nothing of the mode.

    Raises
    ------
    ModelError
        If there are no modes or too many, two have one name, or a number is not finite or not possible.
    """

    modes: tuple[Mode, ...]
    wild_variance: float = 0.0
    rejects: bool = False

    def __post_init__(self) -> None:
        """Refuse what makes no bank."""
        names = [mode.name for mode in self.modes]
        if not 1 <= len(names) <= MOST_MODES or len(set(names)) != len(names):
            raise ModelError(f"The modes {names} make no bank; give 1 to {MOST_MODES} modes of different names.")
        for mode in self.modes:
            if not (0 < mode.noise_variance < np.inf and 0 < mode.lasts < np.inf and 0 <= mode.wild_share < 1):
                raise ModelError(
                    f"The mode {mode.name!r} has noise variance {mode.noise_variance:.3g}, lasts {mode.lasts:.3g} steps"
                    f" and has a wild share of {mode.wild_share:.3g}; give the first two above 0, the last from 0 to 1."
                )
            if mode.then and mode.then not in names:
                raise ModelError(f"After {mode.name!r} comes {mode.then!r}, which is none of the modes {names}.")
        if not 0 <= self.wild_variance < np.inf:
            raise ModelError(f"wild_variance = {self.wild_variance!r} is no variance; give 0 or a positive number.")

    @cached_property
    def component(self) -> Component:
        """The richest mode's component, whose states all share."""
        return max((mode.component for mode in self.modes), key=lambda component: len(component.drift))

    @property
    def states(self) -> int:
        """Number of states, n."""
        return len(self.component.drift)

    @property
    def least_noise_variance(self) -> float:
        """R of the mode that is read most finely, in unit^2."""
        return min(mode.noise_variance for mode in self.modes)

    @cached_property
    def start(self) -> Floats:
        """How modes begin with the first reading: each one's probability, and variances of its states, (M, 1 + n)."""
        lasts = np.array([mode.lasts for mode in self.modes])
        spread = _WIDE * self._settled_variances if self.states > 1 else np.empty(1)
        own = [
            [share, mode.noise_variance, *spread[1:]]
            for share, mode in zip(lasts / lasts.sum(), self.modes, strict=True)
        ]
        return np.array(own)

    @cached_property
    def _settled_variances(self) -> Floats:
        """Variances of the states of the richest mode, once settled."""
        mode = max(self.modes, key=lambda mode: len(mode.component.drift))
        try:
            variances = np.diag(steady(mode.component.to_model(1.0, mode.noise_variance)).predicted_cov)
        except ModelError:  # it never forgets its start
            variances = np.empty(0)
        return variances if len(variances) == self.states else np.full(self.states, mode.noise_variance)

    def bank(self, lengths: Floats) -> Bank:
        """Lay the modes out, for steps of several lengths (u,)."""
        key, known = lengths.tobytes(), self._banks
        if key not in known:
            if len(known) >= _MOST_BANKS:
                known.clear()
            known[key] = self._laid_out(lengths)
        return known[key]

    @cached_property
    def _banks(self) -> dict[bytes, Bank]:
        """What was laid out last, for lengths that come again."""
        return {}

    def _laid_out(self, lengths: Floats) -> Bank:
        F, Q = (
            np.stack(parts, axis=1) for parts in zip(*(self._over(mode, lengths) for mode in self.modes), strict=True)
        )
        n, count = self.states, len(lengths) * len(self.modes)
        return Bank(
            np.ascontiguousarray(F).reshape(count, n, n),
            np.ascontiguousarray(Q).reshape(count, n, n),
            self.transitions(lengths),
            self.component.output.copy(),
            self.component.signal_output.copy(),
            np.array([mode.noise_variance for mode in self.modes]),
            np.array([mode.wild_share if self.wild_variance > 0 else 0.0 for mode in self.modes]),
            np.array([self.wild_variance, float(self.rejects)]),
            self.start,
            np.array([largest_beside(self.least_noise_variance), largest_level(self.least_noise_variance)]),
        )

    def _over(self, mode: Mode, lengths: Floats) -> tuple[Floats, Floats]:
        """Integrate one mode over steps, (u, n, n) each; states that it has not are asleep."""
        own, n = len(mode.component.drift), self.states
        F, Q = mode.component.over(lengths)
        if own == n:
            return F, Q
        wide_F, wide_Q = np.zeros((2, len(lengths), n, n))
        wide_F[:, :own, :own], wide_Q[:, :own, :own] = F, Q
        asleep = np.arange(own, n)
        wide_Q[:, asleep, asleep] = _ASLEEP * np.diag(self.component.over(np.ones(1))[1][0])[own:]
        nothing = lengths == 0.0
        wide_F[nothing], wide_Q[nothing] = np.eye(n), 0.0
        return wide_F, wide_Q

    def transitions(self, lengths: Floats) -> Floats:
        """Return the probability of going from mode i to mode j over steps of several lengths, (u, M, M)."""
        return _exponentials(self._rates, lengths)

    @cached_property
    def _rates(self) -> Floats:
        """How often a step goes from mode i to mode j, (M, M); rows add up to 0."""
        names, count = [mode.name for mode in self.modes], len(self.modes)
        rates = np.zeros((count, count))
        for i, mode in enumerate(self.modes):
            others = [names.index(mode.then)] if mode.then else [j for j in range(count) if j != i]
            rates[i, others] = 1 / (mode.lasts * max(len(others), 1))
            rates[i, i] = -rates[i].sum()
        return rates


def _exponentials(rates: Floats, lengths: Floats) -> Floats:
    """Return exp(rates t) for several t, (u, M, M): a Taylor series of a small part of the time, squared again."""
    most = float(np.abs(np.diag(rates)).max(initial=0.0)) * lengths
    halvings = np.maximum(np.ceil(np.log2(np.maximum(most, 1e-300))) + 2, 0)  # each its own: so alone, so in company
    part = np.multiply.outer(lengths / 2.0**halvings, rates)
    term = found = np.broadcast_to(np.eye(len(rates)), part.shape)
    for k in range(1, _TERMS):
        term = term @ part / k
        found = found + term
    for k in range(int(halvings.max(initial=0))):
        found[halvings > k] = found[halvings > k] @ found[halvings > k]
    found = np.maximum(found, 0.0)
    return np.ascontiguousarray(found / found.sum(axis=2, keepdims=True))


def numbered_steps(elapsed: Floats) -> tuple[Floats, Steps]:
    """Return the lengths of all steps (u,), and which of them precedes each row (N,)."""
    if len(elapsed) and (elapsed == elapsed[0]).all():  # no need to sort
        return elapsed[:1].copy(), np.zeros(len(elapsed), np.int32)
    lengths, steps = np.unique(elapsed, return_inverse=True)
    return lengths if len(lengths) else np.ones(1), steps.astype(np.int32)
