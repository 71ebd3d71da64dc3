"""The timed jobs, each with its model, its readings, and becalm and its rivals."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy import signal

import becalm
from becalm.core.filter.batch import filter_batch
from becalm.core.filter.likelihood import log_likelihood
from becalm.core.steady.steady_filter import steady
from peers_adapters import (
    BATCH_PEERS,
    PEERS,
    Floats,
    Peer,
    dynamax_log_likelihood,
    fast_kalman_filter,
    filterpy_filter,
    installed,
    present,
    statsmodels_log_likelihood,
)
from peers_models import car, gyroscope, readings, strain
from peers_timing import Asked, Rival, Row, at_most, faster, race, within

CUTOFF = 0.01  # cut-off of Butterworth filters as a share of half the rate; their time does not depend on it
BLOCK = 100


@dataclass(frozen=True)
class Scale:
    """The sizes of the jobs."""

    samples: int  # samples of one record
    batch: tuple[int, int]  # number of records, and samples of each
    million: int  # samples for the likelihood, for tuning and for blocks
    calls: int  # number of calls with one sample
    peers: int  # largest number of samples of a peer's record
    growth: tuple[int, ...]  # samples of the records of different length
    widths: tuple[int, ...]  # numbers of channels
    repeats: int  # number of turns


FULL = Scale(
    10_000_000, (1000, 10_000), 1_000_000, 100_000, 1_000_000, (10**4, 10**5, 10**6, 10**7), (1, 10, 100, 1000), 7
)
QUICK = Scale(20_000, (50, 1000), 20_000, 2000, 2000, (10**4, 2 * 10**4), (1, 10), 2)


def states(model: becalm.Model, z: Floats) -> Floats:
    """Filter a record (N, m), or a batch (B, N, m), with becalm; return the states."""
    if z.ndim == 3:
        mean = filter_batch(model, z, states=True, innovations=False).mean
    else:
        mean = becalm.kalman_filter(model, z, states=True, sigma=False, innovations=False).mean
    assert mean is not None, "states=True gives the mean"
    return mean


def gap(found: Floats, wanted: Floats) -> float:
    """Return the largest difference, over the largest value."""
    if found.shape != wanted.shape:
        raise SystemExit(f"A rival gave shape {found.shape}; becalm gives {wanted.shape}.")
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


def copies(z: Floats, count: int) -> list[Floats]:
    """Copy one channel (N,) or one batch into `count` new arrays, as many as a filter returns."""
    return [z.copy() for _ in range(count)]


def same_states(model: becalm.Model, z: Floats) -> Callable[[Any], float]:
    """Return a function that compares a rival's states with becalm's."""
    return lambda found: gap(found, states(model, z))


def rivals_of(peers: Iterable[Peer], model: becalm.Model, z: Floats, most: int, asked: Asked | None) -> list[Rival]:
    """Return libraries as rivals on the first rows of z (N, m) or (B, N, m)."""
    rivals = []
    for peer in peers:
        part = np.ascontiguousarray(z[..., : min(peer.count, most), :])
        run = partial(peer.means, model, part)
        rivals.append(Rival(peer.name, part.size // model.channels, run, asked, same_states(model, part)))
    return rivals


def classic(model: becalm.Model, z: Floats, asked: Asked | None) -> list[Rival]:
    """Return rivals by SciPy on one channel z (N,): `lfilter` with the settled gain for one state, and Butterworth."""
    loop = steady(model)
    A, K, C = loop.closed_loop, loop.gain, model.H
    b, a = signal.ss2tf(A, K, C @ A, C @ K)
    sections = signal.butter(4, CUTOFF, output="sos")
    return [
        Rival("scipy `lfilter`, its gain settled, one state", len(z), partial(signal.lfilter, b[0], a, z), asked),
        Rival("scipy `sosfilt`, order 4", len(z), partial(signal.sosfilt, sections, z)),
    ]


def one_record(name: str, model: becalm.Model, scale: Scale, copying: float, all_asked: bool) -> list[Row]:
    """Time filtering of one record: the signal and all states into new arrays."""
    z, arrays = readings(model, scale.samples), model.channels + model.states
    column = np.ascontiguousarray(z[:, 0])
    rivals = [
        Rival("**becalm**", len(z), partial(states, model, z)),
        Rival(
            f"copying a channel into {arrays} fresh arrays", len(z), partial(copies, column, arrays), at_most(copying)
        ),
    ]
    if model.channels == 1:
        rivals += classic(model, column, faster(5) if all_asked else None)
    rivals += rivals_of(present(PEERS), model, z, scale.peers, faster(400) if all_asked else None)
    return race(name, rivals, scale.repeats)


def many_records(scale: Scale) -> list[Row]:
    """Time filtering of a batch of records of one model."""
    model, (records, count) = gyroscope(), scale.batch
    z = readings(model, records * count).reshape(records, count, 1)
    arrays = 1 + model.states
    rivals = [
        Rival("**becalm**", z.size, partial(states, model, z)),
        Rival(f"copying it into {arrays} fresh arrays", z.size, partial(copies, z, arrays), at_most(1.5)),
        *rivals_of(present(BATCH_PEERS), model, z, scale.peers, faster(10)),
    ]
    return race(f"filter, {records} records at once, 2 states", rivals, scale.repeats)


def smoothing(scale: Scale) -> list[Row]:
    """Time smoothing of one record, without and with sigma."""
    model = gyroscope()
    z = readings(model, scale.samples)
    column, sections = np.ascontiguousarray(z[:, 0]), signal.butter(4, CUTOFF, output="sos")
    rows: list[Row] = []
    for name, sigma, times in (("signal only", False, 4), ("signal and sigma", True, 3)):
        rivals = [
            Rival("**becalm**", len(z), partial(becalm.kalman_smoother, model, z, sigma=sigma, innovations=False)),
            Rival("scipy `sosfiltfilt`, order 4", len(z), partial(signal.sosfiltfilt, sections, column), faster(times)),
        ]
        rows += race(f"smoother, 2 states, {name}", rivals, scale.repeats)
    return rows


def likelihood(scale: Scale) -> list[Row]:
    """Time the log-likelihood of one record."""
    model = gyroscope()
    z = readings(model, scale.million)
    wanted: float = log_likelihood(model, z)

    def difference(found: float) -> float:
        return abs(found / wanted - 1)

    rivals = [Rival("**becalm**", len(z), partial(log_likelihood, model, z))]
    if installed("statsmodels"):
        run = partial(statsmodels_log_likelihood, model, z)
        rivals.append(Rival("statsmodels", len(z), run, faster(150), difference))
    if installed("dynamax"):
        rivals.append(Rival("dynamax", len(z), partial(dynamax_log_likelihood, model, z), None, difference))
    return race("log-likelihood, 2 states", rivals, scale.repeats)


def step_by_step(model: becalm.Model, values: list[float]) -> float:
    """Filter with becalm, one reading per call; return the last signal."""
    step = becalm.Online(model).step
    for value in values:
        last = step(value)
    return float(np.ravel(last[0])[0])


def block_by_block(model: becalm.Model, blocks: list[Floats]) -> float:
    """Filter with becalm, one block per call; return the last signal."""
    run = becalm.Online(model).run
    for block in blocks:
        last = run(block)
    return float(np.ravel(last[0])[-1])


def filterpy_steps(model: becalm.Model, values: list[float]) -> float:
    """Filter with filterpy, one reading at a time; return the last signal."""
    one = filterpy_filter(model)
    one.update(values[0])
    for value in values[1:]:
        one.predict()
        one.update(value)
    return float(one.x[0])


def fast_kalman_steps(model: becalm.Model, values: list[float]) -> float:
    """Filter with fast-kalman, one reading per call, and read the state each time; return the last signal."""
    one = fast_kalman_filter(model)
    one.correct([values[0]])
    for value in values[1:]:
        one.update([value])
        last = one.x
    return float(last[0])


def online(scale: Scale) -> list[Row]:
    """Time a stream: one reading per call, and one block per call."""
    model = gyroscope()
    z = readings(model, scale.million)
    values = z[: scale.calls, 0].tolist()
    blocks = [z[k : k + BLOCK] for k in range(0, len(z), BLOCK)]

    def same(count: int) -> Callable[[Any], float]:
        wanted = states(model, z[:count])[:, 0]
        return lambda found: float(abs(found - wanted[-1]) / np.abs(wanted).max())

    calls, tenth = same(len(values)), max(len(values) // 10, 2)
    rivals = [Rival("**becalm**, `step`", len(values), partial(step_by_step, model, values), within(400), calls)]
    if installed("fast-kalman"):
        rivals.append(
            Rival("fast-kalman, `update`", len(values), partial(fast_kalman_steps, model, values), None, calls)
        )
    if installed("filterpy"):
        run = partial(filterpy_steps, model, values[:tenth])
        rivals.append(Rival("filterpy, `predict` and `update`", tenth, run, None, same(tenth)))
    rows = race("one reading a call, 2 states", rivals, scale.repeats)
    run_blocks = partial(block_by_block, model, blocks)
    whole = Rival("**becalm**, `run`", len(z), run_blocks, within(15), same(len(z)))
    return rows + race(f"blocks of {BLOCK}, 2 states", [whole], scale.repeats)


def growing(scale: Scale) -> list[Row]:
    """Time longer and more records; the ratio is that to the smallest one."""
    model = gyroscope()
    rivals = []
    z = readings(model, max(scale.growth))
    for count in scale.growth:
        times = max(1, scale.million // count)
        rivals.append(Rival(f"becalm, {count:.0e} samples", count * times, partial(repeat, model, z[:count], times)))
    rows = race("growth with length, 2 states", rivals, scale.repeats)
    rivals = []
    for width in scale.widths:
        batch = np.ascontiguousarray(np.broadcast_to(z[: min(10_000, len(z))], (width, min(10_000, len(z)), 1)))
        times = max(1, scale.million // batch.size)
        run = partial(repeat, model, batch, times)
        rivals.append(Rival(f"becalm, {width} x {batch.shape[1]} samples", batch.size * times, run))
    return rows + race("growth with channels, 2 states", rivals, scale.repeats)


def repeat(model: becalm.Model, z: Floats, times: int) -> None:
    """Filter the same readings several times, so that short records can be timed."""
    for _ in range(times):
        states(model, z)


def tuning(scale: Scale) -> list[Row]:
    """Time the tuning of one channel, which compares three orders."""
    count = scale.million
    recording = becalm.Recording(readings(gyroscope(), count), rate_hz=10_000.0)
    asked = Asked("<= 2000 ns (2 s a million)", most_ns=2000)
    rival = Rival("**becalm**, `tune`, three orders", count, partial(becalm.tune, recording), asked)
    return race("tuning one channel", [rival], scale.repeats)


JOBS: dict[str, Callable[[Scale], list[Row]]] = {
    "gyroscope": lambda scale: one_record("filter, 2 states, 1 channel", gyroscope(), scale, 1.5, True),
    "strain": lambda scale: one_record("filter, 3 states, 1 channel", strain(), scale, 2, False),
    "car": lambda scale: one_record("filter, 3 states, 3 channels", car(), scale, 3, False),
    "batch": many_records,
    "smoother": smoothing,
    "likelihood": likelihood,
    "online": online,
    "growth": growing,
    "tuning": tuning,
}
