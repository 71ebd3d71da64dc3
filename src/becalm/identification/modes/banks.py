"""Define five families of interacting multiple models (IMM), and search the parameters of one by likelihood.

resting   the fixed filter and a still mode
jumping   random walks from still to abrupt, and leaps, for levels that stay constant and jump; outliers are rejected
noisy     the fixed filter with quiet and with loud noise
spiky     the fixed filter, which rejects outliers, and an abrupt mode, in which only the level jumps; without it, all
          readings after a jump would be rejected
bursting  the fixed filter with calm and with violent motion; outliers are rejected
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from becalm.core.arrays import Booleans, Floats
from becalm.core.filter.smoothed_flow import SmoothedFlow
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels, Mode, numbered_steps
from becalm.core.model.components import motion, with_walking_level
from becalm.identification.likelihood import Evidence, Tuning
from becalm.identification.risk import estimated_risk, long_pieces
from becalm.identification.spectrum import WINDOW, running_median
from becalm.native.imm import NO_BUFFERS, Steps, filter_rows, new_state

Kind = Literal["resting", "jumping", "noisy", "spiky", "bursting"]

OUTLIER_SIGMAS = 8.0
"""Distance from the running median, in standard deviations of noise, beyond which a reading is an outlier."""

_PIECE, _PIECES = 1 << 14, 4  # readings in a piece of a long record, and pieces, that IMMs are compared on
_DIFFERENT_STEPS = 64  # most lengths of steps that a search distinguishes

_GAIN = 2.0  # least gain in log-likelihood for each step of a parameter
_VARIANCE_GAIN = 0.1  # least gain for a step of a variance
_JUMP_GAIN = 10.0  # least gain for a step of jumping levels: a record shows few jumps, and later jumps may differ
_SWEEPS = 5  # sweeps over all parameters
_MOVING_WILD = 0.03  # share of outliers among the readings of a moving sensor
_REST_STEPS, _MOVE_STEPS = 1.6e5, 3e6  # default mean duration, in steps, of the still, and of gentle and quick modes
_SPIKY_STEPS = 1e8  # mean number of steps between two jumps of a signal with spikes
_WALKS = {"still": 1e-10, "gentle": 2e-3, "quick": 0.7, "abrupt": 40.0}  # default q/r of the random walks
_RANGES = ((1e-12, 1e-3), (1e-8, 1e0), (1e-3, 1e2), (1e1, 1e6))  # limits of these q/r
_WILD = 1e-9  # default share of outliers, so small that a jump or a burst is far likelier than an outlier
_OUTLIER_VARIANCE = 100.0  # variance of outliers over that of the noise, if the record shows no outliers
_LEAP_VARIANCE = 4.0  # variance of a leap over that of outliers
_ABRUPT_STEPS = 0.7  # mean duration of an abrupt mode, in steps
_FINEST = 1e-7  # least standard deviation of an IMM's noise, as a share of the span of 90 % of the readings, and ...
_LOST = 1e-13  # ... as a share of the span of all readings; with less noise, rounding at a jump exceeds the noise
_VIOLENT = 100.0  # default q/r of violent motion, with which the filter follows every reading
_CALM_STEPS, _BURST_STEPS = 3000.0, 20.0  # default mean duration, in steps, of calm and of violent motion
_LOUDEST = 1e15  # largest ratio of violent to calm density; at a larger one, mixing loses the calm mode to rounding
_BLOCK = 50  # readings in a block whose second differences are averaged


class Parameter(NamedTuple):
    """One parameter of an IMM family; the search is over its logarithm."""

    default: float
    low: float
    high: float
    stride: float = 2.0  # first step of the logarithm
    gain: float = _GAIN  # least gain in log-likelihood for each step


class ImmFamily(NamedTuple):
    """A family of IMMs: its parameters, and the function that makes an IMM from their values."""

    numbers: list[Parameter]
    make: Callable[..., InteractingModels]


class EvidencePiece(NamedTuple):
    """A part of a record, laid out for the filter."""

    z: Floats  # (N,) readings, in unit
    lengths: Floats  # (u,) different times between two readings, in steps
    steps: Steps  # (N,) index of the length before each reading


def resting(tuning: Tuning, evidence: Evidence) -> ImmFamily:
    """Return the family of IMMs with a still mode and a fixed filter.

    The moving mode has a share of outliers, so that a large innovation in motion is no evidence of rest.
    """
    spread = float(np.ptp(evidence.z)) ** 2
    moving = Mode("moving", replace(tuning, damping=0.0).component, tuning.noise_variance, 1.0, wild_share=_MOVING_WILD)

    def make(r: float, ratio: float, still_steps: float, moving_steps: float) -> InteractingModels:
        still = Mode("still", motion(1, ratio * r), r, still_steps)
        return InteractingModels((still, replace(moving, lasts=moving_steps)), spread)

    return ImmFamily([_variance(evidence), Parameter(1e-6, 1e-12, 1e-3), *2 * [Parameter(300.0, 50.0, 1e6)]], make)


def jumping(evidence: Evidence, wild: float = _WILD) -> ImmFamily:
    """Return the family of IMMs of random walks, from still to abrupt, and of leaps.

    A leap has a larger variance than an outlier, so a reading that is too far for an outlier is a leap, and the filter
    always finds a new level. `wild` is the starting value of the share of outliers; with a *small* one, a distant
    reading counts as a jump unless the record shows outliers.
    """
    spread = float(np.ptp(evidence.z)) ** 2

    def make(r: float, still: float, others: float, wild: float, *ratios: float) -> InteractingModels:
        lasts = (still, others, others, _ABRUPT_STEPS)
        walks = [
            Mode(name, motion(1, ratio * r), r, last, "quick" if name == "abrupt" else "", wild)
            for name, ratio, last in zip(_WALKS, ratios, lasts, strict=True)
        ]
        leap = Mode("leap", motion(1, _LEAP_VARIANCE * spread), r, _ABRUPT_STEPS, "quick")
        return InteractingModels((*walks, leap), spread, rejects=True)

    numbers = [
        _variance(evidence),
        *(
            Parameter(*limits, gain=_JUMP_GAIN)
            for limits in ((_REST_STEPS, 10.0, 1e7), (_MOVE_STEPS, 0.5, 1e7), (wild, 1e-12, 0.2))
        ),
    ]
    walks = [Parameter(ratio, *bounds, gain=_JUMP_GAIN) for ratio, bounds in zip(_WALKS.values(), _RANGES, strict=True)]
    return ImmFamily([*numbers, *walks], make)


def noisy(tuning: Tuning) -> ImmFamily:
    """Return the family of IMMs of a fixed filter with quiet and with loud noise: only R changes, not Q."""
    r = tuning.noise_variance

    def make(quiet: float, louder: float, quiet_steps: float, loud_steps: float) -> InteractingModels:
        one = Mode("quiet", tuning.component, quiet, quiet_steps)
        return InteractingModels((one, replace(one, name="loud", noise_variance=quiet * louder, lasts=loud_steps)))

    own = Parameter(r / 3, r * 1e-4, r * 20, 1.0, _VARIANCE_GAIN)
    return ImmFamily([own, Parameter(10.0, 1.5, 1e6), *2 * [Parameter(1000.0, 50.0, 1e6)]], make)


def bursting(tuning: Tuning, evidence: Evidence, like: InteractingModels | None = None) -> ImmFamily:
    """Return the family of IMMs of a fixed filter with calm and with violent motion: only Q changes, not R.

    `like` is an IMM of this family to start from, perhaps of another order. If it is given, the calm motion is that of
    `tuning` and is not searched.
    """
    r, ratio, first = tuning.noise_variance, tuning.ratio, (_VIOLENT, _WILD, _CALM_STEPS, _BURST_STEPS)
    own = [
        Parameter(r, r * 1e-4, r * 20, 1.0, _VARIANCE_GAIN),
        Parameter(ratio, 1e-14, 1e6, gain=_VARIANCE_GAIN),
    ]
    wild = max(outstanding_variance(evidence.z[:, 0], r), _OUTLIER_VARIANCE * r)

    def make(noise: float, ratio: float, violent: float, share: float, *lasts: float) -> InteractingModels:
        ratios = (ratio, max(violent, ratio))
        modes = (
            Mode(name, replace(tuning, ratio=q, noise_variance=noise).component, noise, last, wild_share=share)
            for name, q, last in zip(("calm", "burst"), ratios, lasts, strict=True)
        )
        return InteractingModels(tuple(modes), wild, rejects=True)

    if like is not None:
        own = [Parameter(one.default, one.default, one.default) for one in own]
        calm, burst = like.modes
        violent = float(burst.component.noise_density[0, 0]) / burst.noise_variance
        first = (violent, calm.wild_share, calm.lasts, burst.lasts)
    ranges = ((1e-9, min(1e12, _LOUDEST * ratio)), (1e-12, 0.2), (50.0, 1e7), (2.0, 1e4))
    gains = (_GAIN, _JUMP_GAIN, _GAIN, _GAIN)
    others = zip(first, ranges, gains, strict=True)
    return ImmFamily([*own, *(Parameter(value, low, high, gain=gain) for value, (low, high), gain in others)], make)


def spiky(tuning: Tuning, evidence: Evidence) -> ImmFamily:
    """Return the family of IMMs of a fixed filter with outliers; several outliers at the same level are a jump.

    The noise and the process noise of the filter are searched, too.
    """
    r, spread = max(middle_variance(evidence.z[:, 0]), _least(evidence)), float(np.ptp(evidence.z)) ** 2

    def make(noise: float, ratio: float, share: float, wild: float) -> InteractingModels:
        own = replace(tuning, ratio=ratio, noise_variance=noise).component
        steady = Mode("steady", own, noise, _SPIKY_STEPS, wild_share=share)
        abrupt = Mode("abrupt", with_walking_level(own, wild), noise, _ABRUPT_STEPS, "steady", share)
        return InteractingModels((steady, abrupt), wild, rejects=True)

    fastest = (1e-12, 1e6)
    return ImmFamily(
        [
            _about(r, 1e4, evidence),
            Parameter(tuning.ratio, *fastest, gain=_VARIANCE_GAIN),
            Parameter(0.03, 3e-3, 0.4),
            Parameter(
                max(outstanding_variance(evidence.z[:, 0], r), _OUTLIER_VARIANCE * r),
                9 * r,
                max(spread, _OUTLIER_VARIANCE * r),
            ),
        ],
        make,
    )


def _variance(evidence: Evidence) -> Parameter:
    """Return the variance of the noise at rest as a parameter to search."""
    r = max(quiet_variance(evidence.z[:, 0]), _least(evidence))
    return _about(r, 1e2, evidence)


def _about(r: float, times: float, evidence: Evidence) -> Parameter:
    """Return a noise variance as a parameter to search around r."""
    return Parameter(r, max(r / times, _least(evidence)), r * times, 1.0, _VARIANCE_GAIN)


def _least(evidence: Evidence) -> float:
    """Return the least noise variance, unit^2; without noise, a constant level would be infinitely likely."""
    low, high = np.quantile(evidence.z[:, 0], (0.05, 0.95))
    finest = max(_FINEST * float(high - low), _LOST * float(np.ptp(evidence.z)))
    return max(evidence.smallest_variance, finest**2)


def of_first_mode(tuning: Tuning, switching: InteractingModels) -> Tuning:
    """Return a tuning with the noise and the process noise of the first mode of an IMM that is based on the tuning."""
    first = switching.modes[0]
    ratio = float(first.component.noise_density[0, 0]) / first.noise_variance
    return replace(tuning, ratio=ratio, noise_variance=first.noise_variance)


def with_wild_share(switching: InteractingModels, share: float) -> InteractingModels:
    """Return an IMM with a given share of outliers in every mode; with a share of 0 it uses all readings."""
    modes = tuple(replace(mode, wild_share=share) for mode in switching.modes)
    return replace(switching, modes=modes, rejects=share > 0)


def search_imm(family: ImmFamily, pieces: Sequence[EvidencePiece]) -> tuple[InteractingModels, float]:
    """Search a family's parameters in turn, with steps that halve; return the best IMM and its log-likelihood."""
    at, strides = [float(np.log(one.default)) for one in family.numbers], [one.stride for one in family.numbers]
    best = log_likelihood(_make(family, at), pieces)
    for _ in range(_SWEEPS):
        for i in range(len(at)):
            moved, value = _best_move(family, at, i, strides[i], best, pieces)
            strides[i] *= 1.0 if value > best else 0.5
            at, best = moved, value
    return _make(family, at), best


def _best_move(  # noqa: PLR0913
    family: ImmFamily, at: list[float], i: int, stride: float, best: float, pieces: Sequence[EvidencePiece]
) -> tuple[list[float], float]:
    """Move one parameter up, or else down, as long as the log-likelihood gains enough."""
    number = family.numbers[i]
    for way in (stride, -stride):
        gained = False
        while np.log(number.low) <= at[i] + way <= np.log(number.high):
            moved = [*at[:i], at[i] + way, *at[i + 1 :]]
            value = log_likelihood(_make(family, moved), pieces)
            if value == -np.inf or value < best + number.gain:  # a step from -inf to -inf is no gain
                break
            at, best, gained = moved, value, True
        if gained:
            break
    return at, best


def _make(family: ImmFamily, logs: Sequence[float]) -> InteractingModels:
    return family.make(*np.exp(logs).tolist())


def log_likelihood(switching: InteractingModels, pieces: Sequence[EvidencePiece]) -> float:
    """Return the log-likelihood of pieces of a record; the filter starts anew in each."""
    total = 0.0
    for piece in pieces:
        bank = switching.matrices(piece.lengths)
        total += filter_rows(bank, new_state(bank, keeps_level=False), piece.z, piece.steps)
    return total if np.isfinite(total) else -np.inf


def pieces_of(evidence: Evidence, row: int) -> list[EvidencePiece]:
    """Return a record as one piece; a long record as three pieces spread over it and one around a row."""
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
    """Round the lengths of steps so that there are at most 64 different ones."""
    if len(np.unique(elapsed)) <= _DIFFERENT_STEPS:
        return elapsed
    least = max(float(elapsed[elapsed > 0].min(initial=1.0)), 1e-6)
    edge = np.geomspace(least, max(float(elapsed.max()), 2 * least), _DIFFERENT_STEPS - 1)
    nearest = np.searchsorted(np.sqrt(edge[1:] * edge[:-1]), elapsed)
    return np.where(elapsed > 0, edge[nearest], 0.0)


def quiet_variance(z: Floats) -> float:
    """Return the variance, unit^2, of the noise in the quietest tenth of a record (N,), from second differences."""
    bends = np.diff(z, 2)
    width = min(_BLOCK, max(len(bends) // 10, 1))
    blocks = bends[: len(bends) // width * width].reshape(-1, width)
    return float(np.quantile(np.mean(blocks**2, axis=1), 0.1)) / 6


def middle_variance(z: Floats) -> float:
    """Return the variance, unit^2, of the noise of a record (N,), from its median second difference."""
    return float(1.4826 * np.median(np.abs(np.diff(z, 2)))) ** 2 / 6


def outstanding_variance(z: Floats, r: float) -> float:
    """Return the mean squared distance of outliers from the running median of z (N,), given r; 0 if there are none."""
    if len(z) < WINDOW:
        return 0.0
    apart = z - running_median(z)
    out = np.abs(apart) > OUTLIER_SIGMAS * np.sqrt(r)
    return float(np.mean(apart[out] ** 2)) if out.any() else 0.0


# Compare the errors of an IMM smoother and a fixed smoother without the truth.

_LESS = 0.05  # relative reduction of the estimated risk that an IMM smoother needs
_CLEARLY = 3.0  # standard errors by which an IMM smoother that errs less at hidden readings is clearly better
_FAR_LESS = 0.1  # share of the fixed smoother's risk below which an IMM may err more at hidden readings, by at most ...
_BY_CHANCE = 2.0  # ... this number of standard errors; one unpredictable reading of a shock causes one of them
_HIDDEN = 10  # every tenth reading is hidden from the smoothers
_PROBE = 0.02  # size of the probe, in standard deviations of the noise
_LIKELY = 0.5  # probability above which a reading counts as an outlier
_ROWS_AT_ONCE = 1 << 15  # rows that are filtered in one call


def find_outliers(switching: InteractingModels, readings: Floats, elapsed: Floats) -> Booleans:
    """Return which readings (N,) are outliers according to the causal IMM filter."""
    wild = np.zeros(len(readings))
    state = new_state(switching.matrices(np.ones(1)), keeps_level=False)
    for start in range(0, len(readings), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        lengths, steps = numbered_steps(elapsed[rows])
        trace = NO_BUFFERS._replace(wild=wild[rows])
        filter_rows(switching.matrices(lengths), state, np.ascontiguousarray(readings[rows]), steps, trace)
    outliers: Booleans = wild > _LIKELY
    return outliers


def _without_outliers(switching: InteractingModels, evidence: Evidence) -> Evidence:
    """Return evidence with each outlier replaced by the IMM smoother's estimate plus a draw of the noise."""
    if not switching.rejects:
        return evidence
    z, noise = evidence.z[:, 0].copy(), switching.least_noise_variance
    wild = find_outliers(switching, z, evidence.elapsed)
    if not wild.any():
        return evidence
    smooth = _smoothed(ImmFlow(switching, causal=False), z, evidence.elapsed)
    z[wild] = smooth[wild] + np.sqrt(noise) * np.random.default_rng(len(z)).normal(size=int(wild.sum()))
    return Evidence.of(z, evidence.elapsed)


def errs_less(switching: InteractingModels, tuning: Tuning, evidence: Evidence) -> bool:
    """Return whether an IMM smoother errs less than the fixed one, clearly at hidden readings or by its estimated risk.

    Where a record rests, the gain is small compared with the noise of hidden readings. Then the risk decides, and the
    hidden readings may contradict it only within chance: by one standard error, or by two if the gain in risk is large.
    The risk requires a noise variance, for which the smaller one of the two models is used. Outliers would distort the
    risk and the errors at hidden readings, so they are replaced first.
    """
    evidence = _without_outliers(switching, evidence)
    fixed_flow = SmoothedFlow(tuning.component, tuning.noise_variance)
    more = hidden_errors(ImmFlow(switching, causal=False), evidence) - hidden_errors(fixed_flow, evidence)
    if not len(more):
        return False
    chance = float(more.std()) / np.sqrt(len(more))
    if more.mean() < -_CLEARLY * chance:
        return True
    R = min(tuning.noise_variance, switching.least_noise_variance)
    fixed = estimated_risk(tuning, evidence, R, causal=False).error
    share = _FAR_LESS if more.mean() > chance else 1 - _LESS
    return bool(more.mean() <= _BY_CHANCE * chance and _risk(switching, evidence, R) < share * fixed)


def hidden_errors(flow: SmoothedFlow | ImmFlow, evidence: Evidence) -> Floats:
    """Return the squared errors (k,), unit^2, of a smoother at readings that are hidden from it.

    Every tenth reading of the longest piece is hidden; none is if the piece has fewer than six readings.
    """
    part = max(long_pieces(evidence), key=lambda piece: piece.stop - piece.start)
    z, elapsed = evidence.z[part, 0], evidence.elapsed[part]
    hidden = np.arange(len(z)) % _HIDDEN == _HIDDEN // 2
    return np.asarray((_smoothed(flow, np.where(hidden, np.nan, z), elapsed) - z)[hidden] ** 2)


def _risk(switching: InteractingModels, evidence: Evidence, noise_variance: float) -> float:
    """Estimate the mean squared error of an IMM smoother from its response to a small probe."""
    squares, responses, count = 0.0, 0.0, 0
    size = _PROBE * float(np.sqrt(noise_variance))
    for part in long_pieces(evidence):
        z, elapsed = evidence.z[part, 0], evidence.elapsed[part]
        probe = np.random.default_rng(len(z)).choice([-1.0, 1.0], len(z))
        smooth, response = (
            _smoothed(ImmFlow(switching, causal=False), read, elapsed) for read in (z, z + size * probe)
        )
        squares += float(np.sum((z - smooth) ** 2))
        responses += float(np.sum(probe * (response - smooth))) / size
        count += len(z)
    return squares / count + noise_variance * (2 * responses / count - 1)


def _smoothed(flow: SmoothedFlow | ImmFlow, z: Floats, elapsed: Floats) -> Floats:
    return np.concatenate([estimate.signal for estimate in [*flow.push(z, elapsed), *flow.finish()]])


# Decide whether rejected readings are outliers or motion.
#
# An outlier is much farther from its neighbours than they are from each other.

LEAST_OUTLYING = 0.75
"""Least share of the rejected readings that must stand out from their neighbours."""

_LEAST_DISTANCE = 1.5  # over the local RMS of second differences, which is 2.4 standard deviations of white noise
_NEAR, _FEWEST = 8, 4  # readings on each side; least number of second differences among them


def rejects_stand_out(readings: Floats, rejected: Booleans, *, at_jumps: bool = False) -> bool:
    """Return whether at least 75 % of the rejected readings stand out from their neighbours on both sides.

    Parameters
    ----------
    readings : (N,) float array
        Measurements in the channel's unit, NaN where missing.
    rejected : (N,) bool array
        True where a filter rejected the reading.
    at_jumps : bool
        True if the first reading after a jump may be rejected, as by a filter that waits for the next reading.

    Notes
    -----
    The distance of each rejected reading from the line between the nearest accepted readings is compared with the
    second differences of the accepted readings near it. In a shock, a reversal or an impact the second
    differences are as large as that distance. At a jump the nearest accepted readings are farther from each other than
    the rejected reading is from one of them.
    """
    seen = np.isfinite(readings)
    z, out = readings[seen], rejected[seen]
    if not out.any():
        return True
    rows, kept = np.flatnonzero(out), np.flatnonzero(~out)
    if len(kept) < 2:
        return False
    after = np.searchsorted(kept, rows)
    last, following = z[kept[np.maximum(after - 1, 0)]], z[kept[np.minimum(after, len(kept) - 1)]]
    nearest = np.minimum(np.abs(z[rows] - last), np.abs(z[rows] - following))
    distance = np.abs(z[rows] - np.interp(rows, kept, z[kept]))
    outlying = at_jumps | (nearest > np.abs(following - last))
    return bool(np.mean(outlying & (distance > _LEAST_DISTANCE * _roughness(z, out)[rows])) >= LEAST_OUTLYING)


def _roughness(z: Floats, out: Booleans) -> Floats:
    """Return the RMS (N,) of second differences of accepted readings near each reading; inf for fewer than four."""
    bends, valid = np.zeros(len(z)), np.zeros(len(z))
    if len(z) > 2:
        valid[1:-1] = ~(out[:-2] | out[1:-1] | out[2:])
        bends[1:-1] = np.where(valid[1:-1] > 0, np.diff(z, 2) ** 2, 0.0)
    around = [sliding_window_view(np.pad(part, _NEAR), 2 * _NEAR + 1).sum(axis=1) for part in (bends, valid)]
    mean = np.divide(around[0], around[1], out=np.full(len(z), np.inf), where=around[1] >= _FEWEST)
    roughness: Floats = np.sqrt(mean)
    return roughness
