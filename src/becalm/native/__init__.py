"""Call the C99 filter of one channel, which is compiled when becalm is built.

`kernel.h` describes the structs, which are NumPy structured arrays here. The functions work on the caller's arrays;
only the function that `stepper` returns has arrays of its own.
"""

from __future__ import annotations

import ctypes
from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from becalm.errors import ModelError
from becalm.native.library import CONSTANTS, LIBRARY, checked, kernel, layout_of

kernel.channel_start.argtypes, kernel.channel_start.restype = [ctypes.c_void_p] * 2, None
kernel.channel_process.argtypes, kernel.channel_process.restype = [ctypes.c_void_p] * 5, None
kernel.channel_packed_size.argtypes, kernel.channel_packed_size.restype = [ctypes.c_int64], ctypes.c_int64
kernel.channel_pack.argtypes, kernel.channel_pack.restype = [ctypes.c_void_p] * 2, None
kernel.channel_unpack.argtypes, kernel.channel_unpack.restype = [ctypes.c_int64, *[ctypes.c_void_p] * 2], None
kernel.channel_begin_after.argtypes = [
    *[ctypes.c_void_p] * 3,
    ctypes.c_double,
    ctypes.c_int64,
    *[ctypes.c_double] * 3,
]
kernel.channel_begin_after.restype = None
kernel.channel_reduce.argtypes, kernel.channel_reduce.restype = [*[ctypes.c_void_p] * 2, ctypes.c_int], None
kernel.channel_forget_counts.argtypes, kernel.channel_forget_counts.restype = [ctypes.c_void_p], None
kernel.channel_is_sound.argtypes, kernel.channel_is_sound.restype = [ctypes.c_void_p] * 2, ctypes.c_int
kernel.likelihood_add.argtypes = [*[ctypes.c_void_p] * 3, ctypes.c_int64, ctypes.c_void_p]
kernel.likelihood_add.restype = None
_locked = ctypes.PyDLL(str(LIBRARY))  # calls keep Python's lock, because its release takes longer than one row
_locked.channel_call.restype = None

STATE, _SCORE = map(layout_of, ("state", "score"))
GATHERING, DETERMINED = CONSTANTS["GATHERING"], CONSTANTS["DETERMINED"]


def start(settings: NDArray[np.void]) -> NDArray[np.void]:
    """Return the state of a channel before its first row."""
    state = np.zeros((), STATE)
    kernel.channel_start(settings.ctypes.data, state.ctypes.data)
    return state


def set_history(  # noqa: PLR0913  (keyword arguments)
    settings: NDArray[np.void],
    coefficients: NDArray[np.void],
    state: NDArray[np.void],
    *,
    first: float,
    rows: int,
    steps: float,
    least: float,
    most: float,
) -> None:
    """Set the history before the first row: first, least and greatest measurement, in unit; rows and steps."""
    channel = settings.ctypes.data, coefficients.ctypes.data, state.ctypes.data
    kernel.channel_begin_after(*channel, first, rows, steps, least, most)


def reduced(settings: NDArray[np.void], state: NDArray[np.void], *, alive: bool) -> NDArray[np.void]:
    """Return a copy of the state, reduced to what later estimates depend on; without hops if the sensor is `alive`."""
    own = np.frombuffer(bytearray(state.tobytes()), STATE).reshape(())  # copy() would copy only the named fields
    kernel.channel_reduce(settings.ctypes.data, own.ctypes.data, alive)
    return own


def reset_counts(state: NDArray[np.void]) -> None:
    """Reset the counts of verdicts and faults."""
    kernel.channel_forget_counts(state.ctypes.data)


def process(settings: NDArray[np.void], coefficients: NDArray[np.void], state: NDArray[np.void], **rows: Any) -> None:
    """Process a block of rows.

    Parameters
    ----------
    settings, coefficients, state : () structured array
        The structs of the channel; the state changes.
    **rows : array
        z, elapsed, signal, sigma, innovation, deviation (B,), and F, Q (u, n, n), of float64; step (B,) of int32, with
        values below u; verdict (B,) of int8; optionally x (B, n) of float64. All are C-contiguous. See `block_t` and
        `estimate_t`.

    Raises
    ------
    ValueError
        If the arrays have other types, or do not fit each other; otherwise C would read beyond their ends.
    """
    block, estimate = checked(settings, rows)
    kernel.channel_process(
        settings.ctypes.data, coefficients.ctypes.data, state.ctypes.data, ctypes.byref(block), ctypes.byref(estimate)
    )


class _Call(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_void_p) for name in ("settings", "model", "state", "block", "estimate"))


def stepper(
    settings: NDArray[np.void],
    coefficients: NDArray[np.void],
    state: NDArray[np.void],
    F: NDArray[np.float64],
    Q: NDArray[np.float64],
) -> Callable[[float], tuple[float, float]]:
    """Return a fast function that takes the measurement of the next step and returns signal and sigma.

    Parameters
    ----------
    settings, coefficients, state : () structured array
        The structs of the channel; each call changes the state.
    F, Q : (1, n, n) float64 array
        Matrices of the step.

    Raises
    ------
    ValueError
        If the arrays do not fit the channel.
    """
    numbers = array("d", [0.0, 1.0, 0.0, 0.0, 0.0, 0.0])  # Python's array is faster than NumPy for single numbers
    names = "z", "elapsed", "signal", "sigma", "innovation", "deviation"
    rows = {name: np.frombuffer(numbers)[k : k + 1] for k, name in enumerate(names)}
    rows |= {"step": np.zeros(1, np.int32), "verdict": np.zeros(1, np.int8), "F": F, "Q": Q}
    block, estimate = checked(settings, rows)
    pointers = (struct.ctypes.data for struct in (settings, coefficients, state))
    call = ctypes.pointer(_Call(*pointers, ctypes.addressof(block), ctypes.addressof(estimate)))
    kept, run = (block, estimate, settings, coefficients, state, rows), _locked.channel_call

    def step(reading: float, _kept: Any = kept) -> tuple[float, float]:
        numbers[0] = reading
        run(call)
        return numbers[2], numbers[3]

    return step


def packed_size(states: int) -> int:
    """Return the number of bytes of a channel's state, without the unused part of its arrays."""
    return int(kernel.channel_packed_size(states))


def saved(settings: NDArray[np.void], state: NDArray[np.void]) -> NDArray[np.int8]:
    """Return the bytes of a channel's state, without the unused part of its arrays."""
    kept = np.empty(packed_size(int(settings["states"])), np.int8)
    kernel.channel_pack(state.ctypes.data, kept.ctypes.data)
    return kept


def loaded(settings: NDArray[np.void], kept: NDArray[np.int8]) -> NDArray[np.void]:
    """Return the state of a channel from its bytes.

    Raises
    ------
    ModelError
        If the bytes are not a state of this channel.
    """
    states = int(settings["states"])
    if kept.dtype != np.int8 or kept.shape != (packed_size(states),):
        raise ModelError(f"The state of a snapshot is {kept.dtype} of shape {kept.shape}, not that of a channel.")
    bytes_in_one_piece, state = kept.copy(), np.zeros((), STATE)
    kernel.channel_unpack(states, bytes_in_one_piece.ctypes.data, state.ctypes.data)
    if not kernel.channel_is_sound(settings.ctypes.data, state.ctypes.data):
        raise ModelError("The state of a snapshot has impossible values; pass what snapshot() returned.")
    return state


def score(
    settings: NDArray[np.void], coefficients: NDArray[np.void], scored_from: int, **rows: Any
) -> tuple[float, float, int]:
    """Return the sums of nu^2 / S and log S over a record's rows from `scored_from` on, and the number of measurements.

    Parameters
    ----------
    settings, coefficients : () structured array
        The structs of the channel.
    scored_from : int
        The first row that counts; earlier rows only start the filter.
    **rows : array
        z, elapsed, F, Q and step, as in `process`; z is NaN where no measurement may enter the filter.

    Raises
    ------
    ValueError
        If the arrays do not fit each other.
    """
    block, _ = checked(settings, rows, writes=False)
    sums = np.zeros((), _SCORE)
    sums["product"] = 1.0
    kernel.likelihood_add(
        settings.ctypes.data, coefficients.ctypes.data, ctypes.byref(block), scored_from, sums.ctypes.data
    )
    log_det = np.log(sums["product"]) + sums["exponent"] * np.log(2.0)
    return float(sums["squares"]), float(log_det), int(sums["used"])
