"""Call the C filter and smoothers of interacting multiple models (IMM); see `imm.h`.

The functions work on the caller's arrays; only a `Stepper` has arrays of its own.
"""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.native.library import CONSTANTS, kernel, layout_of

Floats = NDArray[np.float64]
Steps = NDArray[np.int32]
State = NDArray[np.void]

MOST_STATES, MOST_MODES, BLOCK = (CONSTANTS[name] for name in ("N_MAX", "MODES_MAX", "IMM_BLOCK"))

_SCORE = layout_of("score")
_POINTER, _COUNT, _REAL = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
for _name in ("beliefs_size", "note_size", "later_size", "filter_room", "smooth_room"):
    _size = getattr(kernel, f"imm_{_name}")
    _size.argtypes, _size.restype = [_COUNT] * 2, _COUNT
kernel.imm_is_sound.argtypes, kernel.imm_is_sound.restype = [_POINTER] * 2, ctypes.c_int
kernel.imm_filter.argtypes, kernel.imm_filter.restype = [_POINTER] * 7, None
kernel.imm_smooth.argtypes, kernel.imm_smooth.restype = [_POINTER, _REAL, *[_POINTER] * 5], None
kernel.imm_smooth_late.argtypes = [_POINTER, _REAL, *[_POINTER] * 2, *[_COUNT] * 4, *[_POINTER] * 2]
kernel.imm_smooth_late.restype = None


class ModeMatrices(NamedTuple):
    """The matrices of M modes for steps of u lengths; outliers (`wild`) have noise of a larger variance."""

    F: Floats  # (u M, n, n) transitions; the M modes of one length follow each other
    Q: Floats  # (u M, n, n) process noise
    T: Floats  # (u, M, M) probability of going from mode i to mode j over the step
    H: Floats  # (1, n) measurement matrix
    C: Floats  # (1, n) output of the signal
    R: Floats  # (M,) measurement variance, in unit^2
    tail: Floats  # (M,) share of outliers among the measurements
    wild: Floats  # (2,) extra variance of outliers, in unit^2; 1 if outliers are rejected, else 0
    start: Floats  # (M, 1 + n) for each mode, its probability and its states' variances at the first measurement
    largest: Floats  # (2,) largest magnitude of a measurement, and largest magnitude of a level, in unit


class ImmBuffers(NamedTuple):
    """Output arrays, written for each row from the first measurement on; an array without columns is not written."""

    signal: Floats  # (N,) in unit
    sigma: Floats  # (N,) in unit
    innovation: Floats  # (N,) normal score of the measurement under the mixture, times innovation_sigma, in unit
    innovation_sigma: Floats  # (N,) standard deviation of the predicted mixture, in unit
    probability: Floats  # (M, N) probability of each mode
    wild: Floats  # (N,) probability that the measurement is an outlier
    mean: Floats  # (n, N) mean state of the mixture, without the level


_WRITTEN = {*ImmBuffers._fields, "before", "notes", "later"}  # arrays that C writes
_NONE: Floats = np.empty(0)
NO_BUFFERS = ImmBuffers(_NONE, _NONE, _NONE, _NONE, np.empty((0, 0)), _NONE, np.empty((0, 0)))
"""Output arrays without columns, so that nothing is written."""


class _Matrices(ctypes.Structure):
    _fields_ = (
        ("states", _COUNT),
        ("modes", _COUNT),
        *((name, _POINTER) for name in ("F", "Q", "T", "h", "c", "R", "tail", "start")),
        ("V", _REAL),
        ("rejects", _COUNT),
        ("largest", _REAL),
        ("largest_level", _REAL),
    )


class _Block(ctypes.Structure):
    _fields_ = (("z", _POINTER), ("step", _POINTER), ("rows", _COUNT))


class _Estimate(ctypes.Structure):
    _fields_ = (*((name, _POINTER) for name in ImmBuffers._fields), ("rows", _COUNT))


class _Passed(ctypes.Structure):
    _fields_ = (("before", _POINTER), ("notes", _POINTER))


def new_state(matrices: ModeMatrices, *, keeps_level: bool) -> State:
    """Return the state before the first row; it has the fields mu (M,), x (M, n) and P (M, n, n) of the modes.

    Parameters
    ----------
    matrices : ModeMatrices
        The matrices of the modes.
    keeps_level : bool
        Whether to subtract the first measurement from all measurements. This is possible if a constant in the
        measurements is a constant in the signal.
    """
    state = np.zeros((), _layout(matrices))
    state["layout"], state["states"], state["modes"] = CONSTANTS["IMM_LAYOUT"], *_sizes(matrices)
    state["has_level"] = not keeps_level
    return state


def restored(matrices: ModeMatrices, kept: NDArray[np.int8]) -> State | None:
    """Return a state from its bytes (B,); None if they are not a valid state of these modes."""
    layout = _layout(matrices)
    if kept.dtype != np.int8 or kept.shape != (layout.itemsize,):
        return None
    state = np.frombuffer(bytearray(kept.tobytes()), layout).reshape(())
    return state if kernel.imm_is_sound(ctypes.byref(_pointed(matrices)), state.ctypes.data) else None


def note_size(states: int, modes: int) -> int:
    """Return the number of floats in the note on a row: states after the row, and likelihoods of its measurement."""
    return int(kernel.imm_note_size(states, modes))


def blocks_before(matrices: ModeMatrices, rows: int) -> Floats:
    """Return an output array (blocks, K) for the states before each block of rows, of K floats each."""
    return np.empty((-(-rows // BLOCK), kernel.imm_beliefs_size(*_sizes(matrices))))


def nothing_later(matrices: ModeMatrices) -> Floats:
    """Return the information of later rows (K,) at the end of a record, where there are no later rows."""
    return np.zeros(kernel.imm_later_size(*_sizes(matrices)))


def filter_rows(  # noqa: PLR0913  (rows, modes and outputs)
    matrices: ModeMatrices,
    state: State,
    z: Floats,
    steps: Steps,
    buffers: ImmBuffers = NO_BUFFERS,
    *,
    before: Floats | None = None,
    notes: Floats | None = None,
) -> float:
    """Filter rows; the state changes.

    Parameters
    ----------
    matrices : ModeMatrices
        The matrices of the modes.
    state : () structured array
        The state of the modes, from `new_state`.
    z : (N,) float array
        Measurements, in unit; NaN where missing.
    steps : (N,) int32 array
        Index of the step before each row.
    buffers : ImmBuffers
        Output arrays.
    before : (blocks, K) float array, optional
        Output array for the states before each block of rows, see `blocks_before`.
    notes : (N, K) float array, optional
        Output array for the notes on each row, see `note_size`.

    Returns
    -------
    float
        The log-likelihood of all measurements; the very first measurement of a stream does not count.

    Raises
    ------
    ValueError
        If the arrays do not fit each other: C would read beyond their ends.
    """
    if state.dtype != _layout(matrices):
        raise ValueError(
            f"The state of {state.dtype.itemsize} bytes is not one of {_sizes(matrices)} states and modes."
        )
    block, estimate = _pointed_rows(matrices, z, steps), _pointed_buffers(matrices, buffers, len(z))
    if before is not None:
        _check(before=(before, "f8", (-(-len(z) // BLOCK), kernel.imm_beliefs_size(*_sizes(matrices)))))
    if notes is not None:
        _check(notes=(notes, "f8", (len(z), note_size(*_sizes(matrices)))))
    passed = _Passed(*(None if array is None else array.ctypes.data for array in (before, notes)))
    room, score = np.empty(kernel.imm_filter_room(*_sizes(matrices))), np.zeros((), _SCORE)
    score["product"] = 1.0
    places = *map(ctypes.byref, (block, estimate, passed)), room.ctypes.data, score.ctypes.data
    kernel.imm_filter(ctypes.byref(_pointed(matrices)), state.ctypes.data, *places)
    log_density = np.log(score["product"]) + score["exponent"] * np.log(2.0) - 0.5 * score["squares"]
    return float(log_density - 0.5 * np.log(2 * np.pi) * score["used"])


def smooth_rows(  # noqa: PLR0913  (rows, modes and outputs)
    matrices: ModeMatrices, state: State, z: Floats, steps: Steps, before: Floats, later: Floats, buffers: ImmBuffers
) -> None:
    """Smooth filtered rows with the rows after them.

    Parameters
    ----------
    matrices, z, steps, before
        The arguments of `filter_rows`; `before` is an output of `filter_rows`.
    state : () structured array
        The state after these rows, or after later ones.
    later : (K,) float array
        The information of all rows after these rows, see `nothing_later`; afterwards it includes these rows.
    buffers : ImmBuffers
        Output arrays; innovations are not written.

    Raises
    ------
    ValueError
        If the arrays do not fit each other.
    """
    block, estimate = _pointed_rows(matrices, z, steps), _pointed_buffers(matrices, buffers, len(z))
    sizes = _sizes(matrices)
    _check(
        before=(before, "f8", (-(-len(z) // BLOCK), kernel.imm_beliefs_size(*sizes))),
        later=(later, "f8", (kernel.imm_later_size(*sizes),)),
    )
    room = np.empty(kernel.imm_smooth_room(*sizes))
    places = ctypes.byref(block), before.ctypes.data, ctypes.byref(estimate), later.ctypes.data, room.ctypes.data
    kernel.imm_smooth(ctypes.byref(_pointed(matrices)), float(state["level"]), *places)


def smooth_late(  # noqa: PLR0913  (rows, modes and outputs)
    matrices: ModeMatrices,
    state: State,
    steps: Steps,
    notes: Floats,
    buffers: ImmBuffers,
    *,
    turn: int,
    every: int,
    lag: int,
) -> None:
    """Smooth filtered rows with a fixed lag: pass back from row `turn` - 1, then from every `every`-th row after it.

    Parameters
    ----------
    matrices, steps, notes
        The arguments of `filter_rows`; `notes` is an output of `filter_rows`.
    state : () structured array
        The state after these rows.
    buffers : ImmBuffers
        Output arrays; innovations are not written. A row may be written more than once; its last estimate uses at most
        `lag` and at least `lag` - `every` + 1 rows after it.
    turn, every, lag : int
        Numbers of rows, 1 or more.

    Raises
    ------
    ValueError
        If the arrays do not fit each other, or a number is below 1.
    """
    if not (turn > 0 and every > 0 and lag > 0):
        raise ValueError(f"turn = {turn}, every = {every} and lag = {lag} came; all must be 1 or more.")
    sizes, estimate = _sizes(matrices), _pointed_buffers(matrices, buffers, len(notes))
    _check(notes=(notes, "f8", (len(notes), note_size(*sizes))))
    _check_steps(matrices, steps, len(notes))
    room = np.empty(kernel.imm_smooth_room(*sizes))
    rows = steps.ctypes.data, notes.ctypes.data, len(notes), turn, every, lag
    level = float(state["level"])
    kernel.imm_smooth_late(ctypes.byref(_pointed(matrices)), level, *rows, ctypes.byref(estimate), room.ctypes.data)


class Stepper:
    """A fast filter of one measurement at a time, one step apart.

    Parameters
    ----------
    matrices : ModeMatrices
        The matrices of the modes, for one step.
    state : () structured array
        The state of the modes; it changes in place.
    """

    def __init__(self, matrices: ModeMatrices, state: State) -> None:
        self._row, self._estimate = np.empty(1), np.array([np.nan, np.inf])  # C writes from the first measurement on
        step, score, room = (
            np.zeros(1, np.int32),
            np.zeros((), _SCORE),
            np.empty(kernel.imm_filter_room(*_sizes(matrices))),
        )
        buffers = NO_BUFFERS._replace(signal=self._estimate[:1], sigma=self._estimate[1:])
        self._kept_alive = matrices, state, step, score, room  # the structs have pointers to these arrays
        self._structs = (
            _pointed(matrices),
            _pointed_rows(matrices, self._row, step),
            _pointed_buffers(matrices, buffers, 1),
            _Passed(),
        )
        matrices_at, *others = map(ctypes.addressof, self._structs)
        self._places = matrices_at, state.ctypes.data, *others, room.ctypes.data, score.ctypes.data

    def step(self, z: float) -> tuple[float, float]:
        """Take a measurement, in unit; return signal and sigma, or NaN and inf before the first measurement."""
        self._row[0] = z
        kernel.imm_filter(*self._places)
        signal, sigma = self._estimate.tolist()
        return signal, sigma


def _sizes(matrices: ModeMatrices) -> tuple[int, int]:
    return matrices.H.shape[-1], len(matrices.R)


def _layout(matrices: ModeMatrices) -> np.dtype[np.void]:
    """Return the NumPy dtype of `imm_state_t`."""
    n, modes = _sizes(matrices)
    fields: Any = [(name, "i8") for name in ("layout", "states", "modes", "has_level")]
    fields += [("level", "f8"), ("mu", "f8", (modes,)), ("x", "f8", (modes, n)), ("P", "f8", (modes, n, n))]
    layout: np.dtype[np.void] = np.dtype(fields)
    return layout


def _pointed(matrices: ModeMatrices) -> _Matrices:
    """Return C's struct; it points to the arrays of `matrices`, which must live as long as the struct."""
    (n, modes), steps = _sizes(matrices), len(matrices.T)
    if not (1 <= n <= MOST_STATES and 1 <= modes <= MOST_MODES):
        raise ValueError(f"{modes} modes of {n} states came; 1 to {MOST_MODES} of 1 to {MOST_STATES} are needed.")
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("F", "Q"), (steps * modes, n, n))
    shapes |= dict.fromkeys(("H", "C"), (1, n))
    shapes |= dict.fromkeys(("R", "tail"), (modes,)) | dict.fromkeys(("wild", "largest"), (2,))
    shapes |= {"T": (steps, modes, modes), "start": (modes, 1 + n)}
    _check(**{name: (getattr(matrices, name), "f8", shape) for name, shape in shapes.items()})
    (V, rejects), (largest, largest_level) = matrices.wild.tolist(), matrices.largest.tolist()
    arrays = matrices.F, matrices.Q, matrices.T, matrices.H, matrices.C, matrices.R, matrices.tail, matrices.start
    places = (array.ctypes.data for array in arrays)
    return _Matrices(n, modes, *places, V, int(rejects), largest, largest_level)


def _pointed_rows(matrices: ModeMatrices, z: Floats, steps: Steps) -> _Block:
    _check(z=(z, "f8", (len(z),)))
    _check_steps(matrices, steps, len(z))
    return _Block(z.ctypes.data, steps.ctypes.data, len(z))


def _pointed_buffers(matrices: ModeMatrices, buffers: ImmBuffers, rows: int) -> _Estimate:
    n, modes = _sizes(matrices)
    leading = {"probability": (modes,), "mean": (n,)}
    wanted = {name: array for name, array in buffers._asdict().items() if array.size}
    _check(**{name: (array, "f8", (*leading.get(name, ()), rows)) for name, array in wanted.items()})
    for one, other in (("signal", "sigma"), ("innovation", "innovation_sigma")):
        if (one in wanted) != (other in wanted):
            raise ValueError(f"{one} and {other} are written together; give arrays for both, or for neither.")
    return _Estimate(*(wanted[name].ctypes.data if name in wanted else None for name in ImmBuffers._fields), rows)


def _check_steps(matrices: ModeMatrices, steps: Steps, rows: int) -> None:
    _check(steps=(steps, "i4", (rows,)))
    if rows and not (steps.min() >= 0 and steps.max() < len(matrices.T)):
        raise ValueError(f"steps go from {steps.min()} to {steps.max()}; there are {len(matrices.T)} steps.")


def _check(**arrays: tuple[NDArray[Any], str, tuple[int, ...]]) -> None:
    """Raise a ValueError if arrays do not fit; otherwise C would read or write beyond their ends."""
    for name, (array, kind, shape) in arrays.items():
        in_place = array.flags.c_contiguous and array.flags.aligned and (name not in _WRITTEN or array.flags.writeable)
        if array.dtype != kind or array.shape != shape or not in_place:
            raise ValueError(f"{name} is {array.dtype} of shape {array.shape}, not {kind} of {shape} in one piece.")
