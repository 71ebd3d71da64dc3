"""The opening of a fixed lag: rows before the readings determine the state, told once the rows after them have come.

Each is regressed on the first row whose state is known, as `smoothing` does, while that state itself is
smoothed by the readings that follow it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model import Model
from becalm.core.starting import (
    Information,
    arrived,
    carry_on,
    estimable,
    is_determined,
    is_narrow,
    known_before,
    known_state,
    learn,
    regress,
    wide_prior,
)
from becalm.core.system import Step, System


class Early(NamedTuple):
    """A row of the opening."""

    told: Floats  # (p,) its outputs as a filter knows them; NaN where it does not
    variance: Floats  # (p,)
    Y: Floats  # (n, n) information after it
    y: Floats  # (n,)
    F: Floats  # (n, n) of the step before it
    Q: Floats  # (n, n)


class Reach(NamedTuple):
    """The outputs of a row, given the state of a later one: C x + c, variance w."""

    C: Floats  # (p, n)
    c: Floats  # (p,)
    w: Floats  # (p,)


class Known(NamedTuple):
    """The first state that is known, with what later readings tell of it."""

    x: Floats  # (n,)
    P: Floats  # (n, n)
    B: Floats  # (n, n) its covariance with the state of the newest row


class Taken(NamedTuple):
    """How a row was taken, and what it read."""

    F: Floats  # (n, n) of the step before it
    H: Floats  # (m, n) 0 where a channel is missing
    K: Floats  # (n, m)
    S: Floats  # (m, m)
    nu: Floats  # (m,)


class LagOpening:
    """Gathers the readings of the opening, and holds its rows until they may be told.

    Parameters
    ----------
    model : Model
        The signal and its sensors.
    C : (p, n) float array
        What makes the outputs from the states.
    lag : int
        Later rows that are waited for.
    """

    def __init__(self, model: Model, C: Floats, lag: int) -> None:
        self._model, self._C, self._lag = model, C, lag
        self._prior = wide_prior(model)
        self._now: Information | None = None  # once a reading came
        self._rows: deque[Early] = deque()  # until the state is known
        self._reaches: deque[Reach] = deque()  # the same rows from then on
        self._known: Known | None = None

    @property
    def waiting(self) -> int:
        """Rows that were not told yet."""
        return len(self._rows) + len(self._reaches)

    @property
    def blank(self) -> bool:
        """Whether nothing at all is known."""
        return self._now is None and self._prior is None

    def take(self, step: Step, system: System, reading: Floats) -> tuple[Floats, Floats] | None:
        """Take a row (m,); return the state and its covariance where it is the one that determines them."""
        F, Q, H, R = step
        if self.blank and not arrived(reading).any():
            unknown = np.full(len(self._C), np.nan), np.full(len(self._C), np.inf)
            self._rows.append(Early(*unknown, *known_before(self._model), F, Q))
            return None
        before = self._prior or known_before(self._model)
        before = before if self._now is None else carry_on(self._now, F, Q, self._model)
        now = self._now = learn(before, H, R, reading)
        if is_determined(now.Y) and (self._prior is None or is_narrow(now, system)):
            x, P = known_state(now)
            self._reaches.extend(_reaches(self._rows, self._C, F, Q))
            self._rows.clear()
            self._known = Known(x, P, P)
            return x, P
        self._rows.append(Early(*estimable(now, self._C), *now, F, Q))
        return None

    def forget_surplus(self) -> None:
        """Leave only as many rows as wait; those before are told as unknown."""
        while len(self._rows) > self._lag:
            self._rows.popleft()

    def tell(self, later: int) -> tuple[Floats, Floats] | None:
        """Tell the oldest row, outputs and variances (p,), if it has waited; `later` rows followed the opening."""
        if not self.waiting or self.waiting + later <= self._lag:
            return None
        if self._known is not None:
            return _tell(self._reaches.popleft(), self._known)
        told = self._tell_unsettled(0)
        self._rows.popleft()
        return told

    def tell_all(self) -> list[tuple[Floats, Floats]]:
        """Tell what waits, with what there is after it."""
        if self._known is not None:
            return [_tell(reach, self._known) for reach in self._reaches]
        return [self._tell_unsettled(number) for number in range(len(self._rows))]

    def _tell_unsettled(self, number: int) -> tuple[Floats, Floats]:
        """Tell a row while the state is not known: as a filter does, or, where a prior tells the rest, smoothed."""
        if self._prior is None or self._now is None:
            return self._rows[number].told, self._rows[number].variance
        x, P = known_state(self._now)
        if number == len(self._rows) - 1:
            return self._C @ x, np.einsum("ai,ij,aj->a", self._C, P, self._C)
        newest = self._rows[-1]
        between = list(self._rows)[number:-1]
        return _tell(_reaches(between, self._C, newest.F, newest.Q)[0], Known(x, P, P))

    def learn_later(self, row: Taken) -> None:
        """Let a row after the opening tell of its last state: (13) to (16) of `kernel_lag`, for all states."""
        assert self._known is not None, "rows follow an opening whose state is known"
        x, P, B = self._known
        B = B @ row.F.T  # (13)
        E = B @ row.H.T
        Gamma = np.linalg.solve(row.S, E.T).T  # (14)
        self._known = Known(x + Gamma @ row.nu, P - Gamma @ E.T, B - E @ row.K.T)  # (15), (16)

    def snapshot(self) -> dict[str, Floats]:
        """Return what moves, as arrays."""
        found = _packed("early", self._rows) | _packed("reach", self._reaches)
        if self._known is not None:
            found |= _packed("known", [self._known])
        return found | ({} if self._now is None else _packed("now", [self._now]))

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Take over what moves."""
        self._rows = deque(Early(*row) for row in _unpacked(Early._fields, "early", arrays))
        self._reaches = deque(Reach(*row) for row in _unpacked(Reach._fields, "reach", arrays))
        for row in _unpacked(Known._fields, "known", arrays):
            self._known = Known(*row)
        for row in _unpacked(Information._fields, "now", arrays):
            self._now = Information(*row)


def _reaches(rows: Sequence[Early], C: Floats, F: Floats, Q: Floats) -> list[Reach]:
    """Regress rows, in order of time, on the state of the row after them, which follows a step F, Q."""
    n = C.shape[1]
    J, c, W, found = np.eye(n), np.zeros(n), np.zeros((n, n)), []
    for row in reversed(rows):
        one = regress(Information(row.Y, row.y), F, Q)
        J, c, W = one.J @ J, one.J @ c + one.c, one.J @ W @ one.J.T + one.W
        found.append(Reach(C @ J, C @ c, np.einsum("ai,ij,aj->a", C, W, C)))
        F, Q = row.F, row.Q
    return found[::-1]


def _tell(reach: Reach, known: Known) -> tuple[Floats, Floats]:
    return reach.C @ known.x + reach.c, np.einsum("ai,ij,aj->a", reach.C, known.P, reach.C) + reach.w


def _packed(name: str, rows: Sequence[NamedTuple]) -> dict[str, Floats]:
    """Lay rows out as one array for each of their fields; nothing if there are none."""
    fields = rows[0]._fields if rows else ()
    return {f"{name}_{field}": np.array([getattr(row, field) for row in rows]) for field in fields}


def _unpacked(fields: Sequence[str], name: str, arrays: Mapping[str, Floats]) -> list[tuple[Floats, ...]]:
    found = [arrays[f"{name}_{field}"] for field in fields if f"{name}_{field}" in arrays]
    return list(zip(*found, strict=True))
