"""Call the C smoothers of one channel: each row uses all later rows, or those up to a lag after it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.errors import ModelError
from becalm.native.library import CONSTANTS, checked, kernel, layout_of

kernel.smoother_start.argtypes, kernel.smoother_start.restype = [ctypes.c_void_p] * 2, None
kernel.smoother_forward.argtypes = [*[ctypes.c_void_p] * 7, ctypes.c_int]
kernel.smoother_forward.restype = ctypes.c_int64
kernel.smoother_backward.argtypes = [*[ctypes.c_void_p] * 7, ctypes.c_int]
kernel.smoother_backward.restype = None
kernel.smoother_room.argtypes, kernel.smoother_room.restype = [ctypes.c_int64] * 2, ctypes.c_int64
kernel.smoother_begin_after.argtypes = [*[ctypes.c_void_p] * 3, ctypes.c_double, ctypes.c_int64, ctypes.c_double]
kernel.smoother_begin_after.restype = None
kernel.smoother_is_sound.argtypes, kernel.smoother_is_sound.restype = [ctypes.c_void_p] * 2, ctypes.c_int
kernel.smoother_packed_size.argtypes, kernel.smoother_packed_size.restype = [ctypes.c_int64], ctypes.c_int64
kernel.smoother_pack.argtypes, kernel.smoother_pack.restype = [ctypes.c_int64, *[ctypes.c_void_p] * 2], None
kernel.smoother_unpack.argtypes, kernel.smoother_unpack.restype = [ctypes.c_int64, *[ctypes.c_void_p] * 2], None
kernel.lag_room.argtypes, kernel.lag_room.restype = [ctypes.c_int64] * 3, ctypes.c_int64
kernel.lag_smooth.argtypes = [*[ctypes.c_void_p] * 5, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * 3]
kernel.lag_smooth.restype = ctypes.c_int64

_FORWARD, _FUTURE = map(layout_of, ("forward", "future"))


class _Forward:
    """The forward pass of a smoother.

    Parameters
    ----------
    settings, coefficients : () structured array
        The structs of the channel.

    Attributes
    ----------
    state : () structured array
        The state after the rows filtered so far.
    """

    def __init__(self, settings: NDArray[np.void], coefficients: NDArray[np.void]) -> None:
        self._settings, self._coefficients = settings, coefficients
        self.state, self._nothing = np.zeros((), _FORWARD), np.zeros((), _FUTURE)
        kernel.smoother_start(self.state.ctypes.data, self._nothing.ctypes.data)

    def set_history(self, first: float, rows: int, steps: float) -> None:
        """Set the history before the first row: the record's first measurement, the number of rows, and of steps."""
        kernel.smoother_begin_after(*self._channel, self.state.ctypes.data, first, rows, steps)

    @property
    def _channel(self) -> tuple[int, int]:
        return self._settings.ctypes.data, self._coefficients.ctypes.data


class ForwardPass(NamedTuple):
    """The results of a forward pass that the backward pass needs."""

    taken: int  # number of filtered rows
    room: NDArray[np.float64]  # states of the filter before each block of 64 rows, and working memory
    starts: NDArray[np.int8]  # for each row, whether the filter restarts or the signal jumps there, see `filter.h`
    rows: dict[str, Any]  # the arrays of the block


class Smoother(_Forward):
    """A smoother that filters blocks of rows and passes back over them with later rows; parameters as in `_Forward`."""

    def forward(self, *, ends: bool, **rows: Any) -> ForwardPass:
        """Filter the next block up to the last row on which the gate has decided; pass the other rows again.

        Parameters
        ----------
        ends : bool
            Whether the record ends with this block. If it does not, the number of rows must be a multiple of 64; the
            number of filtered rows is then also a multiple of 64.
        **rows : array
            The arrays of `process`; z is NaN where no measurement may enter the filter, and verdict is 0.

        Raises
        ------
        ValueError
            If the arrays do not fit each other.
        """
        block, estimate = checked(self._settings, rows)
        room = np.empty(kernel.smoother_room(int(self._settings["states"]), block.rows))
        starts = np.empty(block.rows, np.int8)
        memory = room.ctypes.data, starts.ctypes.data
        taken = kernel.smoother_forward(
            *self._channel, self.state.ctypes.data, ctypes.byref(block), ctypes.byref(estimate), *memory, ends
        )
        return ForwardPass(taken, room, starts, rows)

    def no_later_rows(self) -> NDArray[np.void]:
        """Return the information of later rows at the end of a record, where there are no later rows."""
        return np.frombuffer(bytearray(self._nothing.tobytes()), _FUTURE).reshape(())

    def backward(self, passed: ForwardPass, future: NDArray[np.void]) -> None:
        """Pass back over a block with the information of all later rows; signal, sigma and x become smoothed.

        Parameters
        ----------
        passed : ForwardPass
            The result of this smoother's `forward`.
        future : () structured array
            The information of all later rows; afterwards it includes the rows of this block.
        """
        self._pass_back(passed, future, passed.taken, only_future=False)

    def add_information(self, passed: ForwardPass, future: NDArray[np.void], count: int) -> None:
        """Add to `future` the information of the first `count` rows of a block; give all rows or a multiple of 64."""
        self._pass_back(passed, future, count, only_future=True)

    def _pass_back(self, passed: ForwardPass, future: NDArray[np.void], count: int, *, only_future: bool) -> None:
        if count != passed.taken and count % CONSTANTS["SMOOTHED"]:
            raise ValueError(f"count = {count} came; give all {passed.taken} filtered rows, or whole blocks of them.")
        block, estimate = checked(self._settings, passed.rows)
        block.rows = count
        memory = passed.room.ctypes.data, passed.starts.ctypes.data
        kernel.smoother_backward(
            *self._channel, future.ctypes.data, ctypes.byref(block), ctypes.byref(estimate), *memory, only_future
        )


class LagSmoother(_Forward):
    """A fixed-lag smoother: each row uses the rows up to a lag after it. Its parameters are those of `_Forward`."""

    def smooth(self, lag: int, ready: int, **rows: Any) -> int | None:
        """Filter the waiting and the new rows; smooth the first `ready` of them, and do not pass these rows again.

        Parameters
        ----------
        lag : int
            Number of later rows that each row uses, 1 or more.
        ready : int
            Number of rows to smooth: the rows that have `lag` rows after them, or all rows.
        **rows : array
            The arrays of `Smoother.forward`.

        Returns
        -------
        int or None
            The first row with the steady-state gain, counted from the very first row; None before that.

        Raises
        ------
        ValueError
            If the arrays do not fit each other, or the numbers do not fit the rows.
        """
        block, estimate = checked(self._settings, rows)
        if not (lag >= 1 and 0 <= ready <= block.rows):
            raise ValueError(f"lag = {lag} and ready = {ready} came; 1 or more, and 0 to {block.rows} are needed.")
        lag = min(lag, block.rows + 1)
        room = np.empty(kernel.lag_room(int(self._settings["states"]), block.rows, lag))
        places, starts = np.empty(2 * block.rows, np.int64), np.empty(block.rows, np.int8)
        memory = room.ctypes.data, places.ctypes.data, starts.ctypes.data
        rows_in = self.state.ctypes.data, ctypes.byref(block), ctypes.byref(estimate)
        row = kernel.lag_smooth(*self._channel, *rows_in, lag, ready, *memory)
        return None if row < 0 else int(row)

    def caller(self, lag: int, **rows: Any) -> Callable[[], None]:
        """Return a fast function that filters the rows in these arrays and smooths the first row, as `smooth` does.

        The function checks nothing. Between calls only the contents of the arrays may change.
        """
        block, estimate = checked(self._settings, rows)
        room = np.empty(kernel.lag_room(int(self._settings["states"]), block.rows, lag))
        places, starts = np.empty(2 * block.rows, np.int64), np.empty(block.rows, np.int8)
        memory = room.ctypes.data, places.ctypes.data, starts.ctypes.data
        filtering = *self._channel, self.state.ctypes.data, ctypes.byref(block), ctypes.byref(estimate)
        kept = room, places, starts, rows, self.state

        def call(_kept: Any = kept) -> None:
            kernel.lag_smooth(*filtering, lag, 1, *memory)

        return call

    def state_dict(self) -> dict[str, NDArray[np.int8]]:
        """Return the state before the waiting rows, as plain bytes."""
        states = int(self._settings["states"])
        kept = np.empty(kernel.smoother_packed_size(states), np.int8)
        kernel.smoother_pack(states, self.state.ctypes.data, kept.ctypes.data)
        return {"lag_state": kept}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`.

        Raises
        ------
        ModelError
            If the bytes are not a state of this filter.
        """
        kept, states, state = np.array(arrays["lag_state"]), int(self._settings["states"]), np.zeros((), _FORWARD)
        if kept.dtype != np.int8 or kept.shape != (kernel.smoother_packed_size(states),):
            raise ModelError(f"The state of a snapshot is {kept.dtype} of shape {kept.shape}, not that of a fixed lag.")
        kernel.smoother_unpack(states, kept.ctypes.data, state.ctypes.data)
        if not kernel.smoother_is_sound(self._settings.ctypes.data, state.ctypes.data):
            raise ModelError("The state of a snapshot has impossible values; pass what snapshot() returned.")
        self.state = state
