"""The gains of a causal filter of one channel before it has run: from nothing known to where they have settled.

Gains depend on no reading, so that a filter whose readings all arrive can be written down as numbers: the weights of
the first readings, by which a state is known at all, a gain for each row after them, and the one that stays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.kernel_online import live_kernels, new_live
from becalm.core.kernel_settling import gain_in, has_settled
from becalm.core.model import Model
from becalm.core.sized import size
from becalm.core.starting import (
    Information,
    carry_on,
    is_determined,
    known_before,
    known_state,
    learn,
    refuse_singular,
)
from becalm.core.timeline import model_system
from becalm.errors import ModelError

_LONGEST_OPENING = 4096
_ONE = size(1)


class Opening(NamedTuple):
    """What is known once the first readings, none of them missing, have told the state."""

    weights: Floats  # (o, n): the state after o readings z is weights.T @ z
    P: Floats  # (n, n) its covariance, in unit^2


def open_at(model: Model) -> Opening:
    """Find how the first readings of a model of one channel tell its state.

    Parameters
    ----------
    model : Model
        One channel, one step a reading, without x0 and P0.

    Raises
    ------
    ModelError
        If F or R has no inverse, or thousands of readings do not tell the state.

    Notes
    -----
    The information of `starting` is linear in the readings: y[k] = M[k] y[k-1] + H' z[k] / R, and x = P y.
    """
    refuse_singular(model_system(model))
    F, Q, H, R, n = model.F, model.process_covariance, model.H, model.R, model.states
    told = H.T @ np.linalg.inv(R)
    maps: Floats = told[np.newaxis, :, 0]  # (k, n): what each reading has become of y
    now = learn(known_before(model), H, R, np.zeros(1))
    while not is_determined(now.Y):
        if len(maps) == _LONGEST_OPENING:
            raise ModelError(f"{_LONGEST_OPENING} readings do not tell the state of this model; leave a tone out.")
        onward = [carry_on(Information(now.Y, unit), F, Q, model).y for unit in np.eye(n)]
        maps = np.vstack([maps @ np.array(onward), told.T])
        now = learn(carry_on(now, F, Q, model), H, R, np.zeros(1))
    P = known_state(now)[1]
    return Opening(maps @ P, P)


class Gains(NamedTuple):
    """The gains of rows that follow an opening."""

    K: Floats  # (r, n) the last of them is the one that stays, where the gain has settled
    settled: bool


def gains_after(opening: Opening, model: Model, most: int) -> Gains:
    """Return the gains of the rows after an opening, those of `becalm.Online`, until they settle.

    Parameters
    ----------
    opening : Opening
        Of the same model.
    model : Model
        One channel, one step a reading.
    most : int
        Rows after which it is given up.
    """
    n = model.states
    live = new_live(model, np.zeros(n), opening.P, fresh=False)
    step = live_kernels(size(n), _ONE).step
    found: list[Floats] = []
    while len(found) < most and not has_settled(live, n):
        step(live, 0.0)
        found.append(gain_in(live, n))
    return Gains(np.array(found).reshape(len(found), n), has_settled(live, n))


class Leap(NamedTuple):
    """What L steps do to a covariance: P becomes Q + A (P^-1 + G)^-1 A', here for P before the update."""

    A: Floats
    G: Floats
    Q: Floats

    def over(self, P: Floats) -> Floats:
        """Return the covariance (n, n) L steps later."""
        after = self.Q + self.A @ np.linalg.solve(np.eye(len(P)) + P @ self.G, P) @ self.A.T
        return (after + after.T) / 2

    def twice(self) -> Leap:
        """Return the leap of twice as many steps (Anderson, Int. J. Control 28 (1978) 295)."""
        A, G, Q = self
        W = np.linalg.inv(np.eye(len(A)) + Q @ G)
        return Leap(A @ W @ A, G + A.T @ G @ W @ A, Q + A @ W @ Q @ A.T)


def leap_of(model: Model) -> Leap:
    """Return the leap of one step of a model of one channel."""
    return Leap(model.F, model.H.T @ model.H / model.R[0, 0], model.process_covariance)


def gain_before(P: Floats, model: Model) -> Floats:
    """Return the gain (n,) of a reading before which the covariance is P (n, n)."""
    S = float((model.H @ P @ model.H.T)[0, 0]) + float(model.R[0, 0])
    gain: Floats = (P @ model.H.T)[:, 0] / S
    return gain
