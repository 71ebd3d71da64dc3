"""Many records of one model at once: gains, which do not depend on readings, are computed once for all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import BLOCK, Floats, Integers, read_only
from becalm.core.filtering import Estimate, Wanted, numbers, run_filter, sizes_of
from becalm.core.kernel_ahead import AHEAD
from becalm.core.kernel_batch import Results, Table, rehearse, run_together
from becalm.core.kernel_block import TAME
from becalm.core.kernel_settling import GAIN, new_memory
from becalm.core.kernels import Trace, forward
from becalm.core.model import Model
from becalm.core.sized import size
from becalm.core.starting import open_record, wide_prior
from becalm.core.system import Record
from becalm.core.timeline import even_timeline, model_system
from becalm.errors import ModelError

_GROUP = 8
"""Records that share a block of the table while it is near; enough that fetching it costs little."""


@dataclass(frozen=True)
class Batch:
    """What a filter found in B records of N readings, m channels, n states.

    Attributes
    ----------
    signal, sigma : (B, N, m) float array
        H x and its standard uncertainty, in the channels' units.
    innovations, innovation_sigma : (B, N, m) float array
        Reading minus its prediction, and the standard deviation expected of it; no rows if not asked for.
    mean : (B, N, n) float array or None
        States, on request.
    log_likelihood : (B,) float array
        Exact Gaussian log-likelihood of each record.
    used : (B,) int array
        Readings that entered it.

    Notes
    -----
    Complete records have the same `sigma` and `innovation_sigma`, which may share their memory: do not
    write to them.
    """

    signal: Floats
    sigma: Floats
    innovations: Floats
    innovation_sigma: Floats
    mean: Floats | None
    log_likelihood: Floats
    used: Integers


def filter_batch(model: Model, z: ArrayLike, *, states: bool = False, innovations: bool = True) -> Batch:
    """Filter many records causally, each as `kalman_filter` would.

    Parameters
    ----------
    model : Model
        The signal and its sensors, one step a row, the same for all records.
    z : (B, N, m) array_like
        Readings in the channels' units, NaN where one did not arrive. Never modified. Records in
        which all arrived share their gains and run side by side.
    states, innovations : bool
        Whether to return `mean`, and `innovations` with `innovation_sigma`.

    Raises
    ------
    ModelError
        If z does not fit the model, or the model cannot start without x0 and P0.
    """
    readings = np.ascontiguousarray(numbers(z))
    if readings.ndim != 3 or readings.shape[2] != model.channels:
        raise ModelError(f"z has shape {np.shape(z)}; (records, N, {model.channels}) is needed.")
    wanted = Wanted(states=states, innovations=innovations)
    together = wide_prior(model) is None and readings.size > 0
    room = _room(model, readings, wanted)
    alone = _filter_complete(model, readings, room, wanted) if together else range(len(readings))
    sigma, innovation_sigma = (np.broadcast_to(shared, (len(readings), *shared.shape)) for shared in room.shared)
    if len(alone):
        sigma, innovation_sigma = sigma.copy(), innovation_sigma.copy()
    for record in alone:
        sigma[record], innovation_sigma[record] = _filter_alone(model, readings[record], wanted, room, record)
    return Batch(
        signal=np.swapaxes(room.signal, 1, 2),
        sigma=np.swapaxes(sigma, 1, 2),
        innovations=np.swapaxes(room.innovation, 1, 2),
        innovation_sigma=np.swapaxes(innovation_sigma, 1, 2),
        mean=np.swapaxes(room.mean, 1, 2) if states else None,
        log_likelihood=-0.5 * (room.squares + room.log_det + room.used * np.log(2 * np.pi)),  # `Sums`' of all at once
        used=room.used,
    )


class _Room(NamedTuple):
    """Where results go; `shared` is what all complete records have in common."""

    signal: Floats  # (B, m, N)
    innovation: Floats  # (B, m, N), or no columns
    mean: Floats  # (B, n, N), or no columns
    shared: tuple[Floats, Floats]  # sigma (m, N) and innovation_sigma (m, N), or no columns
    squares: Floats  # (B,)
    log_det: Floats  # (B,)
    used: Integers  # (B,)


def _room(model: Model, z: Floats, wanted: Wanted) -> _Room:
    records, rows, m = z.shape
    told = rows if wanted.innovations else 0
    return _Room(
        signal=np.empty((records, m, rows)),
        innovation=np.empty((records, m, told)),
        mean=np.empty((records, model.states, rows if wanted.states else 0)),
        shared=(np.empty((m, rows)), np.empty((m, told))),
        squares=np.zeros(records),
        log_det=np.zeros(records),
        used=np.zeros(records, dtype=np.int64),
    )


def _filter_alone(model: Model, z: Floats, wanted: Wanted, room: _Room, record: int) -> tuple[Floats, Floats]:
    """Filter one record; return its sigma and innovation_sigma, (m, N) each."""
    found = run_filter(model, even_timeline(model, len(z)), z, wanted).estimate
    room.signal[record], room.innovation[record] = found.signal.T, found.innovations.T
    if found.mean is not None:
        room.mean[record] = found.mean.T
    room.used[record], room.log_det[record] = found.used, 0.0
    room.squares[record] = -2 * found.log_likelihood - found.used * np.log(2 * np.pi)
    return found.sigma.T, found.innovation_sigma.T


def _filter_complete(model: Model, z: Floats, room: _Room, wanted: Wanted) -> Integers:
    """Filter records as if all readings had arrived; return those in which some had not."""
    timeline, sizes = even_timeline(model, z.shape[1]), sizes_of(model)
    begun, x, P = _start(model, z, room, wanted)
    memory, table = new_memory(np.zeros(model.states), P, model.channels), _new_table(model, z.shape[1])
    stop = rehearse(sizes, timeline.system, timeline.record(z[0]), begun, memory, table)
    n, m = model.states, model.channels
    weights = size(n * (n + AHEAD) + m * (n + m))
    for first in range(0, len(z), _GROUP):
        group = slice(first, first + _GROUP)
        states = np.ascontiguousarray(x[:, group])
        results = Results(room.signal[group], room.innovation[group], room.mean[group], room.squares[group])
        run_together(sizes, weights, model.H, read_only(z[group]), begun, stop, table, states, results)
        x[:, group] = states
    room.log_det[: len(z)] = table.log_det[begun:stop].sum()
    room.used[: len(z)] = int(table.live[begun:stop].sum())
    for shared, scored in zip(room.shared, (table.sigma, table.innovation_sigma), strict=True):
        if shared.size:
            shared[:, begun:stop], shared[:, stop:] = scored[:, begun:stop], scored[:, stop - 1 : stop]
    if stop < z.shape[1]:
        for record in np.flatnonzero(room.squares[: len(z)] <= TAME):
            memory_of_one = memory.copy()
            memory_of_one[0, : model.states] = x[:, record]
            _finish(model, timeline.record(z[record]), stop, memory_of_one, room, int(record))
    complete = (room.squares[: len(z)] <= TAME) & (room.used[: len(z)] == (z.shape[1] - begun) * model.channels)
    return np.flatnonzero(~complete)


def _finish(model: Model, record: Record, begun: int, memory: Floats, room: _Room, at: int) -> None:  # noqa: PLR0913
    """Filter one record from where the gain has settled."""
    nothing = np.empty((model.channels, 0))
    cov = np.empty((model.states, model.states, 0))
    trace = Trace(room.signal[at], nothing, room.innovation[at], nothing, nothing, room.mean[at], cov)
    system = model_system(model)
    squares, log_det, used, _ = forward(sizes_of(model), system, record, begun, GAIN, memory, trace)
    room.squares[at] += squares
    room.log_det[at] += log_det
    room.used[at] += used


class _Start(NamedTuple):
    """Where complete records start: at row `begun`, each in a state of its own."""

    begun: int
    x: Floats  # (n, B)
    P: Floats  # (n, n)


def _start(model: Model, z: Floats, room: _Room, wanted: Wanted) -> _Start:
    """Start every record; an opening is linear in its readings, so that it is run once for each of them."""
    records = len(z)
    if model.x0 is not None and model.P0 is not None:
        return _Start(0, np.repeat(model.x0[:, np.newaxis], records, axis=1), model.P0)
    rows = min(z.shape[1], model.states)
    opening = open_record(even_timeline(model, rows), np.zeros((rows, model.channels)), model)
    begun = opening.rows
    readings = z[:, :begun].reshape(records, -1)
    told = [_opened(model, unit.reshape(begun, -1)) for unit in np.eye(readings.shape[1])]
    nothing = run_filter(model, even_timeline(model, begun), np.zeros((begun, model.channels)), wanted).estimate
    room.signal[:records, :, :begun] = np.einsum("bj,jck->bck", readings, np.array([one[0].signal.T for one in told]))
    if wanted.states:
        means = np.array([one[0].mean.T for one in told if one[0].mean is not None])
        room.mean[:records, :, :begun] = np.einsum("bj,jik->bik", readings, means)
    for target, found in zip(room.shared, (nothing.sigma, nothing.innovation_sigma), strict=True):
        if target.size:
            target[:, :begun] = found.T
    if wanted.innovations:
        room.innovation[:records, :, :begun] = np.nan
    return _Start(begun, np.array([one[1] for one in told]).T @ readings.T, opening.P)


def _opened(model: Model, z: Floats) -> tuple[Estimate, Floats]:
    """Return what an opening of readings (begun, m) tells, and the state at its end."""
    run = run_filter(
        model,
        even_timeline(model, len(z)),
        z,
        Wanted(states=True, sigma=False, innovations=False),
    )
    return run.estimate, run.memory[0, : model.states]


def _new_table(model: Model, rows: int) -> Table:
    """Make room for what all records have in common, with a block to spare; rows not needed take no memory."""
    n, m, rows = model.states, model.channels, rows + 2 * BLOCK
    return Table(
        A=np.empty((n, n, rows)),
        K=np.empty((n, m, rows)),
        C=np.empty((m, n, rows)),
        W=np.empty((m, m, rows)),
        A4=np.empty((n, n, rows)),
        K4=np.empty((n, AHEAD, rows)),
        sigma=np.empty((m, rows)),
        innovation_sigma=np.empty((m, rows)),
        log_det=np.empty(rows),
        live=np.empty(rows),
    )
