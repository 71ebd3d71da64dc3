"""Start from the first readings alone: a flat prior, carried as information until the state is known.

Information is Y = P^-1 and y = P^-1 x; nothing known is Y = 0, exactly. Rows up to the one where the
readings determine the state are the *opening*; from there on the covariance form runs. Going back,
each opening row is regressed on the one after it, which needs no inverse of Q. Source of the
information form: Fraser and Potter, IEEE TAC-14 (1969) 387; Anderson and Moore 1979, section 6.3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.core.model import Model
from becalm.core.system import System
from becalm.core.timeline import Timeline
from becalm.core.verdict import BEYOND_ANY_SENSOR
from becalm.errors import ModelError

_WELL_DETERMINED = 1e-6  # smallest eigenvalue of the information, scaled to a unit diagonal
_IN_RANGE = 1e-9
_FAR_MORE = 1e6  # of what readings tell to what the next state tells
WIDE = 1e9  # of P0 over R: P - K S K' keeps less than seven digits
_INVERTIBLE = 1e14
_STRETCH = 4096


class Information(NamedTuple):
    """What is known of the state, possibly nothing in some directions."""

    Y: Floats  # (n, n) inverse covariance
    y: Floats  # (n,)


class Opening(NamedTuple):
    """The first rows of a record, until the state is known."""

    known: bool  # whether the readings, with the prior if there is one, determine the state
    rows: int  # rows in the opening; the last of them is the first with a known state
    information: list[Information]  # after each row from the first reading on
    first: int  # the row of the first reading
    x: Floats  # (n,) state at the last row of the opening
    P: Floats  # (n, n)


def open_record(timeline: Timeline, z: Floats, model: Model, prior: Information | None = None) -> Opening:
    """Gather information from z (N, m) until the state is known.

    Parameters
    ----------
    timeline : Timeline
        Step matrices and sensors, and the step before each row.
    z : (N, m) float array
        Readings, NaN where missing.
    model : Model
        What it knows before any reading, and which directions no reading sees.
    prior : Information, optional
        What is known before the first reading, in the place of that.

    Raises
    ------
    ModelError
        If F or R has no inverse; such a model needs x0 and P0.
    """
    system = timeline.system
    refuse_singular(system)
    n = len(system.F[0])
    now = known_before(model) if prior is None else prior
    first = 0 if prior is not None else first_reading(z)
    gathered: list[Information] = []
    for k in range(first, len(z)):
        if gathered:
            step = timeline.step_before(k)
            now = carry_on(now, system.F[step], system.Q[step], model)
        now = learn(now, system.H, system.R, z[k])
        gathered.append(now)
        if is_determined(now.Y) and (prior is None or is_narrow(now, system)):
            return Opening(True, k + 1, gathered, first, *known_state(now))
    if prior is not None and gathered:
        return Opening(True, len(z), gathered, first, *known_state(now))
    return Opening(False, len(z), gathered, first, np.zeros(n), np.zeros((n, n)))


def first_reading(z: Floats) -> int:
    """Return the first row of z (N, m) in which a channel arrived; N if there is none."""
    for begin in range(0, len(z), _STRETCH):
        rows = arrived(z[begin : begin + _STRETCH]).any(axis=1)
        if rows.any():
            return begin + int(rows.argmax())
    return len(z)


def arrived(readings: Floats) -> Booleans:
    """Tell which readings can be used: what is NaN or infinite, or what no sensor reads, did not arrive."""
    with np.errstate(invalid="ignore"):
        usable: Booleans = np.abs(readings) <= BEYOND_ANY_SENSOR
    return usable


def known_before(model: Model) -> Information:
    """Return a flat prior, but for what the model knows; what no reading sees starts at zero, with unit variance."""
    Y = model.unobservable @ model.unobservable.T
    return Information(Y if model.known is None else Y + model.known, np.zeros(len(Y)))


def known_state(now: Information) -> tuple[Floats, Floats]:
    """Return the state (n,) and covariance (n, n) of information without a weak direction."""
    P = _symmetric_inverse(now.Y)
    return P @ now.y, P


def carry(now: Information, F: Floats, Q: Floats) -> Information:
    """Predict one step: Y becomes (I + M Q)^-1 M with M = F^-T Y F^-1.

    With M = L L', that is L (I + L' Q L)^-1 L', which is no covariance's inverse by mistake, however long the step.
    """
    back = np.linalg.inv(F)
    M, b = back.T @ now.Y @ back, back.T @ now.y
    scale = np.sqrt(np.maximum(np.diag(M), 0.0))
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh((M + M.T) / (2 * np.outer(scale, scale)))
    live = values > len(M) * np.finfo(float).eps * values[-1]
    root = np.sqrt(values[live])
    L = scale[:, np.newaxis] * vectors[:, live] * root
    kept = np.linalg.inv(np.eye(len(root)) + L.T @ Q @ L)
    Y = L @ kept @ L.T
    return Information((Y + Y.T) / 2, L @ kept @ (vectors[:, live].T @ (b / scale) / root))


def carry_on(now: Information, F: Floats, Q: Floats, model: Model) -> Information:
    """Predict one step; after one so long that F has lost its inverse only what the model knows anyway is left."""
    try:
        return carry(now, F, Q)
    except np.linalg.LinAlgError:  # what fades has become 0
        return known_before(model)


def learn(now: Information, H: Floats, R: Floats, reading: Floats) -> Information:
    """Add the information of the channels that arrived."""
    seen = arrived(reading)
    if not seen.any():
        return now
    H = H[seen]
    weighted = H.T @ np.linalg.inv(R[np.ix_(seen, seen)])
    return Information(now.Y + weighted @ H, now.y + weighted @ reading[seen])


def is_determined(Y: Floats) -> bool:
    """Whether the information, scaled to a unit diagonal, has no weak direction."""
    diagonal = np.diag(Y)
    if not (diagonal > 0).all():
        return False
    scale = 1 / np.sqrt(diagonal)
    return bool(np.linalg.eigvalsh(Y * np.outer(scale, scale))[0] > _WELL_DETERMINED)


def is_narrow(now: Information, system: System) -> bool:
    """Whether the next reading is predicted well enough for the covariance form to keep its digits."""
    ahead = system.F[0] @ known_state(now)[1] @ system.F[0].T + system.Q[0]
    return bool((np.diag(system.H @ ahead @ system.H.T) <= WIDE * np.diag(system.R)).all())


def wide_prior(model: Model) -> Information | None:
    """Return x0 and P0 as information where P0 is so wide that covariances would lose the readings' digits."""
    if model.x0 is None or model.P0 is None or model.unobservable.size:
        return None
    told = np.diag(model.H @ model.P0 @ model.H.T)
    gathered = np.zeros_like(model.P0)
    for _ in range(model.states):
        gathered = model.F @ gathered @ model.F.T + model.process_covariance
    moves = np.diag(model.H @ gathered @ model.H.T)
    if not (told > WIDE * np.diag(model.R)).any() or (moves > 0.1 * WIDE * np.diag(model.R)).any():
        return None
    if any(not np.linalg.cond(matrix) < _INVERTIBLE for matrix in (model.P0, model.F, model.R)):
        return None
    Y = _symmetric_inverse(model.P0)
    return Information(Y, Y @ model.x0)


def estimable(now: Information, H: Floats) -> tuple[Floats, Floats]:
    """Return H x and its variance, (m,) each; NaN and inf where the readings do not tell yet."""
    scale = np.sqrt(np.diag(now.Y))
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh(now.Y / np.outer(scale, scale))
    live = values > _IN_RANGE
    basis = vectors[:, live] / scale[:, np.newaxis]
    inverse = (basis / values[live]) @ basis.T
    signal, variance = H @ inverse @ now.y, np.einsum("ai,ij,aj->a", H, inverse, H)
    hidden = (H / scale) @ vectors[:, ~live]
    unknown = np.abs(hidden).max(axis=1, initial=0.0) > 1e-6 * np.abs(H / scale).max(axis=1)
    return np.where(unknown, np.nan, signal), np.where(unknown, np.inf, variance)


class Regression(NamedTuple):
    """The state of one row, given the state of the row after it: x = J x' + c, covariance W."""

    J: Floats
    c: Floats
    W: Floats


def regress(now: Information, F: Floats, Q: Floats) -> Regression:
    """Find what the next state says of this one, beside what this one's own readings say.

    With M = F^-T Y F^-1 the noise of the step has covariance W = (M + Q^-1)^-1 = Q (I + M Q)^-1, given both, which is
    near Q where readings tell little, and needs no inverse of Q. Where they tell far more than the next state, as
    across a long gap, nothing would be left of it in float64; then F' Q^-1 F is put beside Y.
    """
    try:
        back = np.linalg.inv(F)
    except np.linalg.LinAlgError:  # what fades has become 0: the next state says nothing of it
        pull = F.T @ _pseudo_inverse(Q)
        W = _pseudo_inverse(now.Y + pull @ F)
        return Regression(W @ pull, W @ now.y, W)
    M, b = back.T @ now.Y @ back, back.T @ now.y
    if np.trace(M @ Q) > _FAR_MORE and is_determined(Q):
        pull = F.T @ _symmetric_inverse(Q)
        W = _symmetric_inverse(now.Y + pull @ F)
        return Regression(W @ pull, W @ now.y, W)
    W = Q @ np.linalg.inv(np.eye(len(M)) + M @ Q)
    return Regression(back @ (np.eye(len(M)) - W @ M), back @ W @ b, back @ W @ back.T)


def root_of(Y: Floats) -> Floats:
    """Return the upper triangular root of a semidefinite matrix, whatever the scales of its rows."""
    scale = np.sqrt(np.diag(Y))
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh(Y / np.outer(scale, scale))
    root = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0))).T, mode="r") * scale
    return np.asarray(root * np.where(np.diag(root) < 0, -1.0, 1.0)[:, np.newaxis])


def _symmetric_inverse(Y: Floats) -> Floats:
    scale = 1 / np.sqrt(np.diag(Y))
    P = np.linalg.inv(Y * np.outer(scale, scale)) * np.outer(scale, scale)
    return (P + P.T) / 2


def _pseudo_inverse(Y: Floats) -> Floats:
    return np.asarray(np.linalg.pinv(Y, hermitian=True), dtype=np.float64)


def refuse_singular(system: System) -> None:
    """Raise a ModelError if F or R has no inverse, which a flat start needs."""
    for name, matrix in (("F", system.F[0]), ("R", _unit_diagonal(system.R))):
        if not (np.linalg.cond(matrix) < _INVERTIBLE):
            raise ModelError(
                f"{name} has no inverse, so the filter cannot start from the first readings alone. "
                "Give x0 and P0, the state expected before the first reading and its covariance."
            )


def _unit_diagonal(R: Floats) -> Floats:
    """Return R as correlations, which no choice of units changes; a reading without noise stays a row of zeros."""
    sigma = np.sqrt(np.diag(R))
    scale = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0)
    return R * scale[:, np.newaxis] * scale
