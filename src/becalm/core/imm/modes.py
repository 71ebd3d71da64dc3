"""The modes of interacting multiple models (IMM): each mode is a model, and one mode is in force at a time.

A fixed gain must trade noise against lag. An IMM has little noise while the signal rests and little lag while it moves.
Each mode has its component, its measurement noise, and a mean duration. The filter estimates the probability of each
mode from the readings (Blom and Bar-Shalom 1988).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from becalm.core.arrays import Floats, frozen
from becalm.core.model.components import Component
from becalm.core.model.parts import largest_level, largest_magnitude_for_noise
from becalm.core.steady.steady_filter import steady
from becalm.errors import ModelError
from becalm.native.imm import MOST_MODES, ModeMatrices, Steps

_WIDE = 1e6  # initial variance of the slopes, over that of the steady-state filter
_ASLEEP = 1e-6  # variance of an inactive state, over the process noise of one step
_MOST_CACHED = 16  # largest number of `ModeMatrices` in the cache
_MOST_KEPT = 256  # results that the caches below keep; a search for modes needs the same ones many times
_FEW_LENGTHS = 64  # most step lengths of a result that is kept: a record in uneven time may have one for every row
_TERMS = 16  # terms of a series whose argument is at most 1/4


@dataclass(frozen=True)
class Mode:
    """One mode of an IMM: a model of the signal, and how long it stays in force.

    Attributes
    ----------
    name : str
        Name of the mode, such as "still" or "moving".
    component : Component
        The signal's model, in steps. If it has fewer states than the largest mode, they are the first states of that
        mode. The other states are inactive: almost 0, with a tiny variance, until a mode with these states comes.
    noise_variance : float
        R, the variance of a reading's noise, in unit^2.
    lasts : float
        Mean duration of the mode, in steps; a *large* one trusts the mode to stay.
    then : str
        Name of the mode that follows; "" if any other mode may follow, with equal probabilities.
    wild_share : float
        Share of wild readings, which are outliers, in this mode; their variance is larger by
        `InteractingModels.wild_variance`. With a *small* share the filter explains a large innovation by a change of
        mode rather than by a wild reading.
    """

    name: str
    component: Component
    noise_variance: float
    lasts: float
    then: str = ""
    wild_share: float = 0.0


@dataclass(frozen=True)
class InteractingModels:
    """Interacting multiple models: the modes, and the treatment of wild measurements.

    Attributes
    ----------
    modes : tuple of Mode
        One to eight modes, the calmest first.
    wild_variance : float
        Variance of a wild reading in excess of R, in unit^2.
    rejects : bool
        Whether wild readings are left out of the estimate; otherwise they enter it, but hardly change the
        probabilities of the modes.

    Raises
    ------
    ModelError
        If there are no modes or too many, two have the same name, or a number is not finite or not possible.
    """

    modes: tuple[Mode, ...]
    wild_variance: float = 0.0
    rejects: bool = False

    def __post_init__(self) -> None:
        """Raise a ModelError if a value is not possible."""
        given: object = self.modes
        if not isinstance(given, tuple) or not all(isinstance(mode, Mode) for mode in given):
            raise ModelError(f"modes = {given!r:.60} is not a tuple of modes; give 1 to {MOST_MODES} of them.")
        names = [mode.name for mode in self.modes]
        if not 1 <= len(names) <= MOST_MODES or len(set(names)) != len(names):
            raise ModelError(f"The modes {names} came; give 1 to {MOST_MODES} modes with different names.")
        for mode in self.modes:
            if not (0 < mode.noise_variance < np.inf and 0 < mode.lasts < np.inf and 0 <= mode.wild_share < 1):
                raise ModelError(
                    f"The mode {mode.name!r} has noise variance {mode.noise_variance:.3g}, lasts {mode.lasts:.3g} steps"
                    f" and has a wild share of {mode.wild_share:.3g}; give the first two above 0, the last from 0 to 1."
                )
            if mode.then and mode.then not in names:
                raise ModelError(f"After {mode.name!r} comes {mode.then!r}, which is not one of the modes {names}.")
        if not 0 <= self.wild_variance < np.inf:
            raise ModelError(f"wild_variance = {self.wild_variance!r} is not a variance; give 0 or a positive number.")

    @cached_property
    def component(self) -> Component:
        """Return the component with the most states; all modes share these states."""
        return max((mode.component for mode in self.modes), key=lambda component: len(component.drift))

    @property
    def states(self) -> int:
        """Return the number of states, n."""
        return len(self.component.drift)

    @property
    def least_noise_variance(self) -> float:
        """Return the smallest R of all modes, in unit^2."""
        return min(mode.noise_variance for mode in self.modes)

    @cached_property
    def start(self) -> Floats:
        """Return for each mode its probability and its states' variances at the first reading, (M, 1 + n)."""
        lasts = np.array([mode.lasts for mode in self.modes])
        spread = _WIDE * self._settled_variances if self.states > 1 else np.empty(1)
        own = [
            [share, mode.noise_variance, *spread[1:]]
            for share, mode in zip(lasts / lasts.sum(), self.modes, strict=True)
        ]
        return np.array(own)

    @property
    def _settled_variances(self) -> Floats:
        """Return the steady-state variances (n,) of the states of the largest mode; R if there are none."""
        mode = max(self.modes, key=lambda mode: len(mode.component.drift))
        return _settled_variances(mode.component, mode.noise_variance)

    def matrices(self, lengths: Floats) -> ModeMatrices:
        """Return the matrices of all modes for the C kernel, for steps of several lengths (u,)."""
        key, cache = lengths.tobytes(), self._matrix_cache
        if key not in cache:
            if len(cache) >= _MOST_CACHED:
                cache.clear()
            cache[key] = self._new_matrices(lengths)
        return cache[key]

    @cached_property
    def _matrix_cache(self) -> dict[bytes, ModeMatrices]:
        """Return the cache of matrices; its keys are the lengths of the steps, as bytes."""
        return {}

    def _new_matrices(self, lengths: Floats) -> ModeMatrices:
        over, key = _over if len(lengths) <= _FEW_LENGTHS else _over.__wrapped__, lengths.tobytes()
        F, Q = (
            np.stack(parts, axis=1)
            for parts in zip(*(over(mode.component, self.component, key) for mode in self.modes), strict=True)
        )
        n, count = self.states, len(lengths) * len(self.modes)
        return ModeMatrices(
            np.ascontiguousarray(F).reshape(count, n, n),
            np.ascontiguousarray(Q).reshape(count, n, n),
            self.transitions(lengths),
            self.component.output.copy(),
            self.component.signal_output.copy(),
            np.array([mode.noise_variance for mode in self.modes]),
            np.array([mode.wild_share if self.wild_variance > 0 else 0.0 for mode in self.modes]),
            np.array([self.wild_variance, float(self.rejects)]),
            self.start,
            np.array(
                [largest_magnitude_for_noise(self.least_noise_variance), largest_level(self.least_noise_variance)]
            ),
        )

    def transitions(self, lengths: Floats) -> Floats:
        """Return the probability of going from mode i to mode j over steps of several lengths, (u, M, M)."""
        return _exponentials(self._rates, lengths)

    @cached_property
    def _rates(self) -> Floats:
        """Return the transition rates from mode i to mode j, per step, (M, M); each row sums to 0."""
        names, count = [mode.name for mode in self.modes], len(self.modes)
        rates = np.zeros((count, count))
        for i, mode in enumerate(self.modes):
            others = [names.index(mode.then)] if mode.then else [j for j in range(count) if j != i]
            rates[i, others] = 1 / (mode.lasts * max(len(others), 1))
            rates[i, i] = -rates[i].sum()
        return rates


@lru_cache(maxsize=_MOST_KEPT)
def _settled_variances(component: Component, noise_variance: float) -> Floats:
    """Return the steady-state variances (n,) of a component's states; the noise variance where there are none."""
    n = len(component.drift)
    try:
        variances = np.diag(steady(component.to_model(1.0, noise_variance)).predicted_cov)
    except ModelError:  # the mode has no steady state
        variances = np.empty(0)
    return frozen(variances if len(variances) == n else np.full(n, noise_variance))


@lru_cache(maxsize=_MOST_KEPT)
def _over(component: Component, largest: Component, length_bytes: bytes) -> tuple[Floats, Floats]:
    """Return F and Q of one mode over steps, (u, n, n) each; states that it does not have are inactive."""
    lengths = np.frombuffer(length_bytes)
    own, n = len(component.drift), len(largest.drift)
    F, Q = component.over(lengths)
    if own == n:
        return F, Q
    wide_F, wide_Q = np.zeros((2, len(lengths), n, n))
    wide_F[:, :own, :own], wide_Q[:, :own, :own] = F, Q
    asleep = np.arange(own, n)
    wide_Q[:, asleep, asleep] = _ASLEEP * np.diag(largest.over(np.ones(1))[1][0])[own:]
    no_time = lengths == 0.0
    wide_F[no_time], wide_Q[no_time] = np.eye(n), 0.0
    return wide_F, wide_Q


def _exponentials(rates: Floats, lengths: Floats) -> Floats:
    """Return exp(rates t) for several t, (u, M, M), by scaling and squaring of a Taylor series."""
    most = float(np.abs(np.diag(rates)).max(initial=0.0)) * lengths
    halvings = np.maximum(np.ceil(np.log2(np.maximum(most, 1e-300))) + 2, 0)  # per t: other lengths have no effect
    part = np.multiply.outer(lengths / 2.0**halvings, rates)
    term = result = np.broadcast_to(np.eye(len(rates)), part.shape)
    for k in range(1, _TERMS):
        term = term @ part / k
        result = result + term
    for k in range(int(halvings.max(initial=0))):
        result[halvings > k] = result[halvings > k] @ result[halvings > k]
    result = np.maximum(result, 0.0)
    return np.ascontiguousarray(result / result.sum(axis=2, keepdims=True))


def numbered_steps(elapsed: Floats) -> tuple[Floats, Steps]:
    """Return the different lengths of the steps (u,), and the index of the step before each row (N,)."""
    if len(elapsed) and (elapsed == elapsed[0]).all():  # no need to sort
        return elapsed[:1].copy(), np.zeros(len(elapsed), np.int32)
    lengths, steps = np.unique(elapsed, return_inverse=True)
    return lengths if len(lengths) else np.ones(1), steps.astype(np.int32)
