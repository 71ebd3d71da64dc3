"""Modes found from a recording: a filter that switches, where it foretells the readings better than a fixed one.

Three banks are tried, each with few numbers, which are searched by likelihood. Resting: a still mode beside the
fixed filter that was tuned. Jumping: random walks from still to abrupt, for levels that hold and jump. Noisy: the
fixed filter with quiet and loud noise. A number leaves its default only where the record clearly says so, so that
a record that shows no switch still gets a bank that follows one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.components import ORDERS, motion
from becalm.core.kernel_switching import SwitchingTrace, memory_length, switch_forward
from becalm.core.switching import Mode, Switching, numbered_steps
from becalm.noise.likelihood import Evidence, Tuning, tune_motion

_NONE: Floats = np.empty(0)
_NOTHING = SwitchingTrace(_NONE, _NONE, _NONE, _NONE, np.empty((0, 0)), _NONE, np.empty((0, 0)))

_FEWEST = 256  # readings, below which no switch can be told from noise
_PIECE, _PIECES = 1 << 14, 4  # readings of a long record that banks are compared on
_SURPRISING = 6.0  # standard deviations: a difference of means that Gaussian noise and motion do not make
_DIFFERENT_STEPS = 64  # lengths of steps that are told apart while searching

_GAIN = 2.0  # of a log-likelihood, for which a number may leave its default
_BETTER = 12.0  # of a log-likelihood, for which a filter that switches is taken
_SWEEPS = 5
_WILD = 0.01  # share of surprises of a moving sensor that say nothing of its mode

_SELDOM = 1e6 / 3  # steps, between two switches of a jumping level
_WALKS = (1e-10, 1e-3, 1e-1, 1e2)  # q/r of still, gentle, quick and abrupt
_NAMES = ("still", "gentle", "quick", "abrupt")
_AT_ONCE = 1.4  # steps that an abrupt mode lasts


@dataclass(frozen=True)
class Switched:
    """A bank, and how well it foretells.

    Attributes
    ----------
    kind : {"resting", "jumping", "noisy"}
        See above.
    switching : Switching
        The modes, in steps.
    log_likelihood : float
        Of the readings that banks were compared on.
    fixed_log_likelihood : float
        Of the best fixed filter, on the same readings.
    """

    kind: str
    switching: Switching
    log_likelihood: float
    fixed_log_likelihood: float


class Number(NamedTuple):
    """One number of a bank, by its logarithm."""

    at: float
    low: float
    high: float
    stride: float = 2.0
    gain: float = _GAIN


class _Piece(NamedTuple):
    z: Floats
    lengths: Floats
    steps: np.ndarray[tuple[int], np.dtype[np.int64]]


def find_switching(tuning: Tuning, evidence: Evidence) -> Switched | None:
    """Find the bank that foretells a record best; None where a fixed filter does as well.

    Parameters
    ----------
    tuning : Tuning
        The fixed filter that was chosen, perhaps with tones.
    evidence : Evidence
        The readings it was tuned on.
    """
    if len(evidence.z) < _FEWEST or not is_surprising(evidence.z[:, 0]):
        return None
    pieces = _pieces(evidence)
    fixed = _fixed_likelihood(tuning, evidence, pieces)
    found = [search(pieces) for search in (_resting(tuning, evidence), _jumping(tuning, evidence), _noisy(tuning))]
    best = max(found, key=lambda one: one.log_likelihood)
    if best.log_likelihood < fixed + _BETTER:
        return None
    return replace(best, fixed_log_likelihood=fixed)


def is_surprising(z: Floats) -> bool:
    """Whether differences of neighbouring means, over some length, are far larger than most of them.

    Noise, motion of one character and tones make none; a jump, rest between motions, outliers and noise that
    changes do. It only spares a search: the likelihood decides.
    """
    total, width = np.concatenate([[0.0], np.cumsum(z - z.mean())]), 1
    while 8 * width <= len(z):
        ends = total[:: max(width // 2, 1)]
        stride = width // max(width // 2, 1)
        means = ends[stride:] - ends[:-stride]
        details = np.abs(means[stride:] - means[:-stride])
        middle = float(np.median(details))
        if float(details.max()) > _SURPRISING * 1.4826 * middle:
            return True
        width *= 2
    return False


Search = Callable[[Sequence[_Piece]], Switched]


def _pieces(evidence: Evidence) -> list[_Piece]:
    parts = [slice(0, len(evidence.z))]
    if len(evidence.z) > _PIECE * _PIECES:
        starts = np.linspace(0, len(evidence.z) - _PIECE, _PIECES).astype(int)
        parts = [slice(start, start + _PIECE) for start in starts.tolist()]
    pieces = []
    for part in parts:
        elapsed = _few_lengths(evidence.elapsed[part])
        pieces.append(_Piece(np.ascontiguousarray(evidence.z[part, 0]), *numbered_steps(elapsed, goes_on=False)))
    return pieces


def _few_lengths(elapsed: Floats) -> Floats:
    """Round steps so that few are different."""
    if len(np.unique(elapsed)) <= _DIFFERENT_STEPS:
        return elapsed
    least = max(float(elapsed[elapsed > 0].min(initial=1.0)), 1e-6)
    edge = np.geomspace(least, max(float(elapsed.max()), 2 * least), _DIFFERENT_STEPS - 1)
    nearest = np.searchsorted(np.sqrt(edge[1:] * edge[:-1]), elapsed)
    return np.where(elapsed > 0, edge[nearest], 0.0)


def log_likelihood(switching: Switching, pieces: Sequence[_Piece]) -> float:
    """Return the log-likelihood of pieces of a record, each begun anew."""
    total = 0.0
    for piece in pieces:
        memory = np.zeros((1, memory_length(switching.states, len(switching.modes))))
        bank = switching.bank(piece.lengths)
        total += switch_forward(switching.sizes, bank, piece.z, piece.steps, switching.start, memory, _NOTHING)[0]
    return total if np.isfinite(total) else -np.inf


def _fixed_likelihood(tuning: Tuning, evidence: Evidence, pieces: Sequence[_Piece]) -> float:
    """Return the likelihood of the best fixed filter: the one chosen, or a motion that foretells better."""
    rivals = [tuning, *(tune_motion(order, evidence) for order in ORDERS)]
    return max(log_likelihood(_alone(rival), pieces) for rival in rivals if rival.noise_variance > 0)


def _alone(tuning: Tuning) -> Switching:
    """Return a fixed filter as a bank: two modes that are alike, so that no other kernel is compiled."""
    one = Mode("fixed", tuning.component, tuning.noise_variance, 1.0)
    return Switching((one, replace(one, name="the same")))


def _resting(tuning: Tuning, evidence: Evidence) -> Search:
    """Search a still mode beside the fixed filter."""
    spread = float(np.ptp(evidence.z)) ** 2
    moving = Mode("moving", tuning.component, tuning.noise_variance, 1.0, wild_share=_WILD)
    quiet = np.log(max(quiet_variance(evidence.z[:, 0]), evidence.smallest_variance))
    numbers = [
        Number(quiet, quiet - 5, quiet + 5, 1.0, 0.1),
        Number(np.log(1e-6), np.log(1e-12), np.log(1e-3)),
        Number(np.log(300.0), np.log(10.0), np.log(1e6)),
        Number(np.log(300.0), np.log(10.0), np.log(1e6)),
    ]

    def bank(logs: Sequence[float]) -> Switching:
        r, ratio, rests, moves = np.exp(logs).tolist()
        still = Mode("still", motion(1, ratio * r), r, rests)
        return Switching((still, replace(moving, lasts=moves)), spread)

    return lambda pieces: _searched("resting", bank, numbers, pieces)


def _jumping(tuning: Tuning, evidence: Evidence) -> Search:
    """Search random walks, from still to abrupt."""
    r = np.log(max(quiet_variance(evidence.z[:, 0]), evidence.smallest_variance))
    bounds = ((1e-12, 1e-3), (1e-8, 1e0), (1e-4, 1e2), (1e1, 1e6))
    numbers = [
        Number(r, r - 5, r + 5, 0.2, 0.1),
        *(Number(np.log(ratio), np.log(low), np.log(high)) for ratio, (low, high) in zip(_WALKS, bounds, strict=True)),
        Number(np.log(_SELDOM), np.log(10.0), np.log(1e7)),
        Number(np.log(_SELDOM), np.log(0.5), np.log(1e7)),
    ]

    def bank(logs: Sequence[float]) -> Switching:
        r, *ratios, still, others = np.exp(logs).tolist()
        lasts = (still, others, others, _AT_ONCE)
        walks = [
            Mode(name, motion(1, ratio * r), r, last, "quick" if name == "abrupt" else "")
            for name, ratio, last in zip(_NAMES, ratios, lasts, strict=True)
        ]
        return Switching(tuple(walks))

    return lambda pieces: _searched("jumping", bank, numbers, pieces)


def _noisy(tuning: Tuning) -> Search:
    """Search quiet and loud noise for the fixed filter: of Q and R, one at a time."""
    r = np.log(tuning.noise_variance)
    numbers = [
        Number(r - 1, r - 9, r + 3, 1.0, 0.1),
        Number(np.log(10.0), np.log(1.5), np.log(1e6)),
        Number(np.log(1000.0), np.log(10.0), np.log(1e6)),
        Number(np.log(1000.0), np.log(10.0), np.log(1e6)),
    ]

    def bank(logs: Sequence[float]) -> Switching:
        quiet, louder, calms, storms = np.exp(logs).tolist()
        one = Mode("quiet", tuning.component, quiet, calms)
        return Switching((one, replace(one, name="loud", noise_variance=quiet * louder, lasts=storms)))

    return lambda pieces: _searched("noisy", bank, numbers, pieces)


def _searched(
    kind: str, bank: Callable[[Sequence[float]], Switching], numbers: Sequence[Number], pieces: Sequence[_Piece]
) -> Switched:
    """Search a bank's numbers one after the other, with strides that halve."""
    at, strides = [number.at for number in numbers], [number.stride for number in numbers]
    best = log_likelihood(bank(at), pieces)
    for _ in range(_SWEEPS):
        for i, number in enumerate(numbers):
            gained = False
            for stride in (strides[i], -strides[i]):
                while number.low <= at[i] + stride <= number.high:
                    moved = [*at[:i], at[i] + stride, *at[i + 1 :]]
                    value = log_likelihood(bank(moved), pieces)
                    if value < best + number.gain:
                        break
                    at, best, gained = moved, value, True
                if gained:
                    break
            strides[i] *= 1.0 if gained else 0.5
    return Switched(kind, bank(at), best, np.nan)


def quiet_variance(z: Floats) -> float:
    """Return the variance of white noise as quiet as the quietest tenth of a record, by its second differences."""
    bends = np.diff(z, 2)
    width = min(50, max(len(bends) // 10, 1))
    blocks = bends[: len(bends) // width * width].reshape(-1, width)
    return float(np.quantile(np.mean(blocks**2, axis=1), 0.1)) / 6
