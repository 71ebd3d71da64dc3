"""The filter in C99, compiled when becalm is built, and the door to it.

`becalm.h` describes the structs; here they are NumPy's. Buffers go in and out; nothing is kept.
"""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.native.library import CONSTANTS, kernel, layout_of

_ROWS = ("z", "elapsed", "step", "F", "Q")
_ESTIMATES = ("signal", "sigma", "verdict", "innovation", "deviation", "x")


class _Block(ctypes.Structure):
    _fields_ = (*((name, ctypes.c_void_p) for name in _ROWS), ("rows", ctypes.c_int64))


class _Estimate(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_void_p) for name in _ESTIMATES)


kernel.channel_start.argtypes, kernel.channel_start.restype = [ctypes.c_void_p] * 2, None
kernel.channel_process.argtypes, kernel.channel_process.restype = [ctypes.c_void_p] * 5, None
kernel.channel_begin_after.argtypes = [
    *[ctypes.c_void_p] * 3,
    ctypes.c_double,
    ctypes.c_int64,
    *[ctypes.c_double] * 3,
]
kernel.channel_begin_after.restype = None
kernel.channel_reduce.argtypes, kernel.channel_reduce.restype = [*[ctypes.c_void_p] * 2, ctypes.c_int], None
kernel.channel_forget_counts.argtypes, kernel.channel_forget_counts.restype = [ctypes.c_void_p], None
kernel.smoother_start.argtypes, kernel.smoother_start.restype = [ctypes.c_void_p] * 2, None
kernel.smoother_forward.argtypes = [*[ctypes.c_void_p] * 7, ctypes.c_int]
kernel.smoother_forward.restype = ctypes.c_int64
kernel.smoother_backward.argtypes = [*[ctypes.c_void_p] * 7, ctypes.c_int]
kernel.smoother_backward.restype = None
kernel.channel_is_sound.argtypes, kernel.channel_is_sound.restype = [ctypes.c_void_p] * 2, ctypes.c_int
kernel.smoother_room.argtypes, kernel.smoother_room.restype = [ctypes.c_int64] * 2, ctypes.c_int64
kernel.likelihood_add.argtypes = [*[ctypes.c_void_p] * 3, ctypes.c_int64, ctypes.c_void_p]
kernel.likelihood_add.restype = None


SETTINGS, COEFFICIENTS, STATE = map(layout_of, ("settings", "coefficients", "state"))
_FORWARD, _FUTURE, _SCORE = map(layout_of, ("forward", "future", "score"))
DETERMINED, MOST_STATES = CONSTANTS["DETERMINED"], CONSTANTS["N_MAX"]


def start(settings: NDArray[np.void]) -> NDArray[np.void]:
    """Return the state of a channel before its first row."""
    state = np.zeros((), STATE)
    kernel.channel_start(settings.ctypes.data, state.ctypes.data)
    return state


def begin_after(  # noqa: PLR0913  (each by its name)
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
    """Say what went before the first row: the first measurement, rows, steps, and between what they lay, in unit."""
    channel = settings.ctypes.data, coefficients.ctypes.data, state.ctypes.data
    kernel.channel_begin_after(*channel, first, rows, steps, least, most)


def reduced(settings: NDArray[np.void], state: NDArray[np.void], *, alive: bool) -> NDArray[np.void]:
    """Return a state with only what later estimates depend on; of a sensor that is alive, but for its hops."""
    own = np.frombuffer(bytearray(state.tobytes()), STATE).reshape(())  # copy() would copy the fields alone
    kernel.channel_reduce(settings.ctypes.data, own.ctypes.data, alive)
    return own


def forget_counts(state: NDArray[np.void]) -> None:
    """Count verdicts and faults from 0 again."""
    kernel.channel_forget_counts(state.ctypes.data)


def is_sound(settings: NDArray[np.void], state: NDArray[np.void]) -> bool:
    """Return whether a state, which may come from a file, is one that this channel can have."""
    return bool(kernel.channel_is_sound(settings.ctypes.data, state.ctypes.data))


def process(settings: NDArray[np.void], coefficients: NDArray[np.void], state: NDArray[np.void], **rows: Any) -> None:
    """Process a block of rows.

    Parameters
    ----------
    settings, coefficients, state : () structured array
        Of the channel; the state changes.
    **rows : array
        z, elapsed, signal, sigma, innovation, deviation (B,), F, Q (u, n, n) of float64; step (B,) of int32, each below
        u; verdict (B,) of int8; x (B, n) of float64, or none. All are C-contiguous. See `block_t` and `estimate_t`.

    Raises
    ------
    ValueError
        If they are not of these types, or do not fit each other: C would read beyond their ends.
    """
    block, estimate = _checked(settings, rows)
    kernel.channel_process(
        settings.ctypes.data, coefficients.ctypes.data, state.ctypes.data, ctypes.byref(block), ctypes.byref(estimate)
    )


class Passed(NamedTuple):
    """What a pass forward leaves for the way back."""

    taken: int  # rows
    room: NDArray[np.float64]
    starts: NDArray[np.int8]
    rows: dict[str, Any]  # all that came in


class Smoother:
    """A filter that passes over blocks of rows, and comes back with what later rows say.

    Parameters
    ----------
    settings, coefficients : () structured array
        Of the channel.

    Attributes
    ----------
    state : () structured array
        After the rows that were taken forward.
    """

    def __init__(self, settings: NDArray[np.void], coefficients: NDArray[np.void]) -> None:
        self._settings, self._coefficients = settings, coefficients
        self.state, self._nothing = np.zeros((), _FORWARD), np.zeros((), _FUTURE)
        kernel.smoother_start(self.state.ctypes.data, self._nothing.ctypes.data)

    def forward(self, *, ends: bool, **rows: Any) -> Passed:
        """Filter the next block, or as much of it as is decided; the rest has to come again.

        Parameters
        ----------
        ends : bool
            Whether the record ends with it; else it is of a multiple of 64 rows, and so is what is taken.
        **rows : array
            As of `process`; z holds NaN where no measurement may enter, and verdict 0.

        Raises
        ------
        ValueError
            If the arrays do not fit each other.
        """
        block, estimate = _checked(self._settings, rows)
        room = np.empty(kernel.smoother_room(int(self._settings["states"]), block.rows))
        starts = np.empty(block.rows, np.int8)
        memory = room.ctypes.data, starts.ctypes.data
        taken = kernel.smoother_forward(
            *self._channel, self.state.ctypes.data, ctypes.byref(block), ctypes.byref(estimate), *memory, ends
        )
        return Passed(taken, room, starts, rows)

    def nothing(self) -> NDArray[np.void]:
        """Return what is known of the future at the end of a record."""
        return np.frombuffer(bytearray(self._nothing.tobytes()), _FUTURE).reshape(())

    def backward(self, passed: Passed, future: NDArray[np.void]) -> None:
        """Come back over a block with what all rows after it say, which changes; signal and sigma become smoothed.

        Parameters
        ----------
        passed : Passed
            Of this smoother; what `forward` returned.
        future : () structured array
            What all later rows say; afterwards its own rows, too.
        """
        self._come_back(passed, future, passed.taken, only_future=False)

    def look_back(self, passed: Passed, future: NDArray[np.void], count: int) -> None:
        """Take into a future what the first rows of a block say: a multiple of 64, or all. Nothing is smoothed."""
        self._come_back(passed, future, count, only_future=True)

    def _come_back(self, passed: Passed, future: NDArray[np.void], count: int, *, only_future: bool) -> None:
        if count != passed.taken and count % CONSTANTS["SMOOTHED"]:
            raise ValueError(f"{count} rows are wanted; of {passed.taken} that were taken give all, or whole blocks.")
        block, estimate = _checked(self._settings, passed.rows)
        block.rows = count
        memory = passed.room.ctypes.data, passed.starts.ctypes.data
        kernel.smoother_backward(
            *self._channel, future.ctypes.data, ctypes.byref(block), ctypes.byref(estimate), *memory, only_future
        )

    @property
    def _channel(self) -> tuple[int, int]:
        return self._settings.ctypes.data, self._coefficients.ctypes.data


def score(
    settings: NDArray[np.void], coefficients: NDArray[np.void], scored_from: int, **rows: Any
) -> tuple[float, float, int]:
    """Return what makes the likelihood of a record's rows from `scored_from` on: sums of nu^2 / S and log S; how many.

    Parameters
    ----------
    settings, coefficients : () structured array
        Of the channel.
    scored_from : int
        Rows before only start the filter.
    **rows : array
        z, elapsed, F, Q and step, as of `process`; z holds NaN where no measurement may enter.

    Raises
    ------
    ValueError
        If they do not fit each other.
    """
    block, _ = _checked(settings, rows, writes=False)
    found = np.zeros((), _SCORE)
    found["product"] = 1.0
    kernel.likelihood_add(
        settings.ctypes.data, coefficients.ctypes.data, ctypes.byref(block), scored_from, found.ctypes.data
    )
    log_det = np.log(found["product"]) + found["exponent"] * np.log(2.0)
    return float(found["squares"]), float(log_det), int(found["used"])


def _checked(settings: NDArray[np.void], rows: dict[str, Any], *, writes: bool = True) -> tuple[_Block, _Estimate]:
    """Return rows as C takes them, and where it writes to, if it does."""
    n, count = int(settings["states"]), len(rows["z"])
    if settings.dtype != SETTINGS or not 1 <= n <= MOST_STATES:
        raise ValueError(f"A channel of {n} states came; 1 to {MOST_STATES} are needed.")
    shapes = {"step": ("i4", (count,)), "verdict": ("i1", (count,)), "x": ("f8", (count, n))}
    shapes |= dict.fromkeys(("F", "Q"), ("f8", (len(rows["F"]), n, n)))
    names = *_ROWS, *(name for name in _ESTIMATES if writes and (name != "x" or name in rows))
    wanted = {name: shapes.get(name, ("f8", (count,))) for name in names}
    for name, (kind, shape) in wanted.items():
        array = rows[name]
        if array.dtype != kind or array.shape != shape or not (array.flags.c_contiguous and array.flags.aligned):
            raise ValueError(f"{name} is {array.dtype} of shape {array.shape}, not {kind} of {shape} in one piece.")
    if count and not (rows["step"].min() >= 0 and rows["step"].max() < len(rows["F"])):
        raise ValueError(f"step goes from {rows['step'].min()} to {rows['step'].max()} of {len(rows['F'])} steps.")
    if not (rows["elapsed"] >= 0).all():
        raise ValueError("elapsed is NaN or below 0 somewhere; time only goes on.")
    at = {name: rows[name].ctypes.data for name in wanted}
    block = _Block(at["z"], at["elapsed"], at["step"], at["F"], at["Q"], count)
    estimate = _Estimate(*(at.get(name) for name in _ESTIMATES))
    return block, estimate
