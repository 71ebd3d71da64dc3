"""Five banks of modes, each told by few numbers, and the search for them by likelihood.

resting   a still mode beside the fixed filter
jumping   random walks from still to abrupt, and leaps, for levels that hold and jump; wild readings are left out
noisy     the fixed filter with quiet and with loud noise
spiky     the fixed filter with wild readings, which are left out, and an abrupt mode, in which the level jumps and
          all else goes on, so that it never locks out
bursting  the fixed filter with calm and with violent motion; wild readings are left out
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.imm.modes import InteractingModels, Mode, numbered_steps
from becalm.core.model.components import motion, with_walking_level
from becalm.identification.likelihood import Evidence, Tuning
from becalm.identification.running_median import WINDOW, running_median
from becalm.native.imm import Steps, filter_rows, new_state

Kind = Literal["resting", "jumping", "noisy", "spiky", "bursting"]

STANDS_OUT = 8.0
"""Standard deviations of noise, beyond which a reading stands out among its neighbours."""

_PIECE, _PIECES = 1 << 14, 4  # readings of a long record that banks are compared on
_DIFFERENT_STEPS = 64  # lengths of steps that are told apart while searching

_GAIN, _SOME = 2.0, 0.1  # of a log-likelihood, for which a number leaves its default; for which a variance does
_MUCH = 10.0  # for which one of a bank of levels does: a record shows few of their jumps, the next may be another
_SWEEPS = 5
_SURPRISED = 0.03  # share of surprises of a moving sensor that say nothing of its mode
_RESTS, _MOVES = 1.6e5, 3e6  # steps that a level stays still, or moves, where the record does not tell
_UNMOVED = 1e8  # steps between jumps of what is only spiky
_WALKS = {"still": 1e-10, "gentle": 2e-3, "quick": 0.7, "abrupt": 40.0}  # q/r
_RANGES = ((1e-12, 1e-3), (1e-8, 1e0), (1e-3, 1e2), (1e1, 1e6))  # of them
_WILD = 1e-9  # share of readings that are wild, where the record shows none: a jump, or a burst, is far likelier
_APART = 100.0  # times the variance of the noise, by which wild readings are spread where none stands out
_FARTHER = 4.0  # times the variance of wild readings, which that of a leap is
_AT_ONCE = 0.7  # steps that an abrupt mode lasts
_FINEST = 1e-7  # of what most readings span, the noise of a bank: of less a jump leaves nothing but rounding
_LOST = 1e-13  # of what all of them span, so
_VIOLENT, _CALMS, _STORMS = 100.0, 3000.0, 20.0  # q/r of violent motion, which believes readings; steps of both
_LOUDEST = 1e15  # times the calm motion's density: of more the calm is lost to rounding where it is mixed
_BLOCK = 50  # readings, of which the variance of bends is taken


class Number(NamedTuple):
    """One number of a bank, searched by its logarithm."""

    default: float
    low: float
    high: float
    stride: float = 2.0  # of the logarithm, at first
    gain: float = _GAIN


class ImmFamily(NamedTuple):
    """A family of banks: its numbers, and how they make one."""

    numbers: list[Number]
    make: Callable[..., InteractingModels]


class EvidencePiece(NamedTuple):
    """A part of a record, laid out for the filter."""

    z: Floats  # (N,)
    lengths: Floats  # (u,) of steps
    steps: Steps  # (N,) which of them precedes each reading


def resting(tuning: Tuning, evidence: Evidence) -> ImmFamily:
    """Return banks of a still mode beside a fixed filter.

    A moving sensor now and then surprises its filter, which says nothing of whether it came to rest.
    """
    spread = float(np.ptp(evidence.z)) ** 2
    moving = Mode("moving", replace(tuning, damping=0.0).component, tuning.noise_variance, 1.0, wild_share=_SURPRISED)

    def make(r: float, ratio: float, rests: float, moves: float) -> InteractingModels:
        still = Mode("still", motion(1, ratio * r), r, rests)
        return InteractingModels((still, replace(moving, lasts=moves)), spread)

    return ImmFamily([_variance(evidence), Number(1e-6, 1e-12, 1e-3), *2 * [Number(300.0, 50.0, 1e6)]], make)


def jumping(evidence: Evidence, wild: float = _WILD) -> ImmFamily:
    """Return banks of random walks, from still to abrupt, and of leaps as far as readings reach, and farther.

    What is farther out than any wild reading is a leap: so a level is never lost for good. `wild` is the share of wild
    readings to begin with; with a *small* one the record has to show them, and a far reading is a jump.
    """
    spread = float(np.ptp(evidence.z)) ** 2

    def make(r: float, still: float, others: float, wild: float, *ratios: float) -> InteractingModels:
        lasts = (still, others, others, _AT_ONCE)
        walks = [
            Mode(name, motion(1, ratio * r), r, last, "quick" if name == "abrupt" else "", wild)
            for name, ratio, last in zip(_WALKS, ratios, lasts, strict=True)
        ]
        leap = Mode("leap", motion(1, _FARTHER * spread), r, _AT_ONCE, "quick")
        return InteractingModels((*walks, leap), spread, rejects=True)

    numbers = [
        _variance(evidence),
        *(Number(*told, gain=_MUCH) for told in ((_RESTS, 10.0, 1e7), (_MOVES, 0.5, 1e7), (wild, 1e-12, 0.2))),
    ]
    walks = [Number(ratio, *bounds, gain=_MUCH) for ratio, bounds in zip(_WALKS.values(), _RANGES, strict=True)]
    return ImmFamily([*numbers, *walks], make)


def noisy(tuning: Tuning) -> ImmFamily:
    """Return banks of a fixed filter with quiet and with loud noise: of Q and R, only R changes."""
    r = tuning.noise_variance

    def make(quiet: float, louder: float, calms: float, storms: float) -> InteractingModels:
        one = Mode("quiet", tuning.component, quiet, calms)
        return InteractingModels((one, replace(one, name="loud", noise_variance=quiet * louder, lasts=storms)))

    own = Number(r / 3, r * 1e-4, r * 20, 1.0, _SOME)
    return ImmFamily([own, Number(10.0, 1.5, 1e6), *2 * [Number(1000.0, 50.0, 1e6)]], make)


def bursting(tuning: Tuning, evidence: Evidence, like: InteractingModels | None = None) -> ImmFamily:
    """Return banks of a fixed filter with calm and with violent motion: of Q and R, only Q changes.

    With a bank that it is to be `like`, perhaps of another order, the calm motion is that of `tuning`; it stays.
    """
    r, ratio, first = tuning.noise_variance, tuning.ratio, (_VIOLENT, _WILD, _CALMS, _STORMS)
    own = [Number(r, r * 1e-4, r * 20, 1.0, _SOME), Number(ratio, 1e-14, 1e6, gain=_SOME)]
    apart = max(outstanding_variance(evidence.z[:, 0], r), _APART * r)

    def make(noise: float, ratio: float, violent: float, share: float, *lasts: float) -> InteractingModels:
        ratios = (ratio, max(violent, ratio))
        modes = (
            Mode(name, replace(tuning, ratio=q, noise_variance=noise).component, noise, last, wild_share=share)
            for name, q, last in zip(("calm", "burst"), ratios, lasts, strict=True)
        )
        return InteractingModels(tuple(modes), apart, rejects=True)

    if like is not None:
        own = [Number(one.default, one.default, one.default) for one in own]
        calm, burst = like.modes
        violent = float(burst.component.noise_density[0, 0]) / burst.noise_variance
        first = (violent, calm.wild_share, calm.lasts, burst.lasts)
    ranges = ((1e-9, min(1e12, _LOUDEST * ratio)), (1e-12, 0.2), (50.0, 1e7), (2.0, 1e4))
    gains = (_GAIN, _MUCH, _GAIN, _GAIN)
    others = zip(first, ranges, gains, strict=True)
    return ImmFamily([*own, *(Number(value, low, high, gain=gain) for value, (low, high), gain in others)], make)


def spiky(tuning: Tuning, evidence: Evidence) -> ImmFamily:
    """Return banks of a fixed filter, tuned anew, with wild readings; where they agree, it was a jump."""
    r, spread = max(middle_variance(evidence.z[:, 0]), _least(evidence)), float(np.ptp(evidence.z)) ** 2

    def make(noise: float, ratio: float, share: float, wild: float) -> InteractingModels:
        own = replace(tuning, ratio=ratio, noise_variance=noise).component
        steady = Mode("steady", own, noise, _UNMOVED, wild_share=share)
        abrupt = Mode("abrupt", with_walking_level(own, wild), noise, _AT_ONCE, "steady", share)
        return InteractingModels((steady, abrupt), wild, rejects=True)

    fastest = (1e-12, 1e6)
    return ImmFamily(
        [
            _about(r, 1e4, evidence),
            Number(tuning.ratio, *fastest, gain=_SOME),
            Number(0.03, 3e-3, 0.4),
            Number(max(outstanding_variance(evidence.z[:, 0], r), _APART * r), 9 * r, max(spread, _APART * r)),
        ],
        make,
    )


def _variance(evidence: Evidence) -> Number:
    """Return the variance of noise at rest as a number to search."""
    r = max(quiet_variance(evidence.z[:, 0]), _least(evidence))
    return _about(r, 1e2, evidence)


def _about(r: float, times: float, evidence: Evidence) -> Number:
    """Return a variance of noise to search about r."""
    return Number(r, max(r / times, _least(evidence)), r * times, 1.0, _SOME)


def _least(evidence: Evidence) -> float:
    """Return the least variance of noise: levels without any are infinitely likely, and lost where they jump."""
    low, high = np.quantile(evidence.z[:, 0], (0.05, 0.95))
    finest = max(_FINEST * float(high - low), _LOST * float(np.ptp(evidence.z)))
    return max(evidence.smallest_variance, finest**2)


def of_first_mode(tuning: Tuning, switching: InteractingModels) -> Tuning:
    """Return a tuning with the noise, and the process noise, of the first mode of a bank that was made of it."""
    first = switching.modes[0]
    ratio = float(first.component.noise_density[0, 0]) / first.noise_variance
    return replace(tuning, ratio=ratio, noise_variance=first.noise_variance)


def with_wild_share(switching: InteractingModels, share: float) -> InteractingModels:
    """Return a bank of which so many readings are wild in every mode; with a share of 0 it believes all of them."""
    modes = tuple(replace(mode, wild_share=share) for mode in switching.modes)
    return replace(switching, modes=modes, rejects=share > 0)


def searched(bank: ImmFamily, pieces: Sequence[EvidencePiece]) -> tuple[InteractingModels, float]:
    """Search a bank's numbers one after the other, with strides that halve; return it and its log-likelihood."""
    at, strides = [float(np.log(number.default)) for number in bank.numbers], [number.stride for number in bank.numbers]
    best = log_likelihood(_made(bank, at), pieces)
    for _ in range(_SWEEPS):
        for i in range(len(at)):
            moved, value = _best_move(bank, at, i, strides[i], best, pieces)
            strides[i] *= 1.0 if value > best else 0.5
            at, best = moved, value
    return _made(bank, at), best


def _best_move(  # noqa: PLR0913
    bank: ImmFamily, at: list[float], i: int, stride: float, best: float, pieces: Sequence[EvidencePiece]
) -> tuple[list[float], float]:
    """Move one number as far as that pays, up or else down."""
    number = bank.numbers[i]
    for way in (stride, -stride):
        gained = False
        while np.log(number.low) <= at[i] + way <= np.log(number.high):
            moved = [*at[:i], at[i] + way, *at[i + 1 :]]
            value = log_likelihood(_made(bank, moved), pieces)
            if value == -np.inf or value < best + number.gain:  # from -inf to -inf is no gain
                break
            at, best, gained = moved, value, True
        if gained:
            break
    return at, best


def _made(bank: ImmFamily, logs: Sequence[float]) -> InteractingModels:
    return bank.make(*np.exp(logs).tolist())


def log_likelihood(switching: InteractingModels, pieces: Sequence[EvidencePiece]) -> float:
    """Return the log-likelihood of pieces of a record, each begun anew."""
    total = 0.0
    for piece in pieces:
        bank = switching.bank(piece.lengths)
        total += filter_rows(bank, new_state(bank, keeps_level=False), piece.z, piece.steps)
    return total if np.isfinite(total) else -np.inf


def pieces_of(evidence: Evidence, row: int) -> list[EvidencePiece]:
    """Return a record, or, of a long one, pieces that are spread over it, and one about a row."""
    parts, last = [slice(0, len(evidence.z))], len(evidence.z) - _PIECE
    if last > _PIECE * (_PIECES - 1):
        starts = [*np.linspace(0, last, _PIECES - 1).astype(int).tolist(), min(max(row - _PIECE // 2, 0), last)]
        parts = [slice(start, start + _PIECE) for start in starts]
    pieces = []
    for part in parts:
        elapsed = _few_lengths(evidence.elapsed[part])
        pieces.append(EvidencePiece(np.ascontiguousarray(evidence.z[part, 0]), *numbered_steps(elapsed)))
    return pieces


def _few_lengths(elapsed: Floats) -> Floats:
    """Round steps so that few are different."""
    if len(np.unique(elapsed)) <= _DIFFERENT_STEPS:
        return elapsed
    least = max(float(elapsed[elapsed > 0].min(initial=1.0)), 1e-6)
    edge = np.geomspace(least, max(float(elapsed.max()), 2 * least), _DIFFERENT_STEPS - 1)
    nearest = np.searchsorted(np.sqrt(edge[1:] * edge[:-1]), elapsed)
    return np.where(elapsed > 0, edge[nearest], 0.0)


def quiet_variance(z: Floats) -> float:
    """Return the variance of white noise as quiet as the quietest tenth of a record (N,), by its second differences."""
    bends = np.diff(z, 2)
    width = min(_BLOCK, max(len(bends) // 10, 1))
    blocks = bends[: len(bends) // width * width].reshape(-1, width)
    return float(np.quantile(np.mean(blocks**2, axis=1), 0.1)) / 6


def middle_variance(z: Floats) -> float:
    """Return the variance of white noise as the middle of the second differences of a record (N,) tells it."""
    return float(1.4826 * np.median(np.abs(np.diff(z, 2)))) ** 2 / 6


def outstanding_variance(z: Floats, r: float) -> float:
    """Return the mean square by which readings (N,) that stand out of noise of variance r do so; 0 where none does."""
    if len(z) < WINDOW:
        return 0.0
    apart = z - running_median(z)
    out = np.abs(apart) > STANDS_OUT * np.sqrt(r)
    return float(np.mean(apart[out] ** 2)) if out.any() else 0.0
