"""Call the C filter and smoother for a model of several channels; `multivariate.h` describes the structs."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.errors import ModelError
from becalm.native.library import CONSTANTS, kernel, layout_of

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

MOST_STATES, MOST_CHANNELS = CONSTANTS["N_MAX"], CONSTANTS["M_MAX"]
GAIN, COVARIANCE = CONSTANTS["GAIN"], CONSTANTS["COVARIANCE"]
"""What must reach its steady state before the filter reuses a gain: only the gain, or also the covariance."""

_HEAD, _FUTURE = layout_of("knowledge"), layout_of("future")


class _Model(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ("states", "channels", "enough", "proper_prior")),
        *((name, ctypes.c_void_p) for name in ("H", "R", "prior", "right")),
    )


class _Record(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("z", "first", "step", "F", "Q", "lengths")),
        ("rows", ctypes.c_int64),
    )


class _Estimates(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_void_p) for name in ("signal", "sigma", "innovation", "deviation", "x", "P"))


kernel.multivariate_size.argtypes, kernel.multivariate_size.restype = [ctypes.c_int64] * 2, ctypes.c_int64
kernel.multivariate_room.argtypes, kernel.multivariate_room.restype = [ctypes.c_int64] * 3, ctypes.c_int64
kernel.multivariate_start.argtypes, kernel.multivariate_start.restype = [ctypes.c_void_p] * 4, None
kernel.multivariate_filter.argtypes, kernel.multivariate_filter.restype = [ctypes.c_void_p] * 4, None
kernel.multivariate_smooth.argtypes, kernel.multivariate_smooth.restype = [ctypes.c_void_p] * 6, None
kernel.multivariate_lag_room.argtypes, kernel.multivariate_lag_room.restype = [ctypes.c_int64] * 3, ctypes.c_int64
kernel.multivariate_lag.argtypes = [*[ctypes.c_void_p] * 3, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * 3]
kernel.multivariate_lag.restype = None
kernel.multivariate_is_sound.argtypes, kernel.multivariate_is_sound.restype = [ctypes.c_void_p] * 2, ctypes.c_int
kernel.multivariate_end.argtypes, kernel.multivariate_end.restype = [ctypes.c_void_p] * 2, None


class MeasurementRows(NamedTuple):
    """Measurements and the steps before them: step number step[s] precedes the rows first[s] to first[s + 1] - 1."""

    z: Floats  # (N, m) measurements, NaN where missing
    first: Whole  # (runs + 1,) first row of each run
    step: Whole  # (runs,) index of the step; -1: none
    F: Floats  # (u, n, n) transitions of the steps
    Q: Floats  # (u, n, n) process noise of the steps
    lengths: Floats  # (u,) lengths of the steps; equal lengths mean equal matrices


class EstimateBuffers(NamedTuple):
    """Output arrays for the estimates; None for estimates that are not requested."""

    signal: Floats | None = None  # (N, m)
    sigma: Floats | None = None  # (N, m)
    innovation: Floats | None = None  # (N, m)
    deviation: Floats | None = None  # (N, m)
    x: Floats | None = None  # (N, n)
    P: Floats | None = None  # (N, n, n)


class Multivariate:
    """A filter of several channels that share one state.

    Parameters
    ----------
    H, R : (m, n), (m, m) float array
        The measurement matrix, and the covariance of the channels' noise.
    prior, right : (n, n), (n,) float array
        The prior before the first measurement as information, U x = b + e with e ~ N(0, I): the upper triangular U,
        and b.
    proper_prior : bool
        Whether the prior information determines the state, so that it predicts the first measurements.
    enough : int
        What must reach its steady state before a gain is reused: GAIN or COVARIANCE.

    Raises
    ------
    ValueError
        If the arrays do not fit each other, or are too large.

    Attributes
    ----------
    state : (S,) uint8 array
        The complete state; its bytes are a checkpoint.
    channels : int
        Number of channels, m.
    """

    def __init__(  # noqa: PLR0913  (the matrices of a model)
        self, H: Floats, R: Floats, prior: Floats, right: Floats, *, proper_prior: bool = False, enough: int = GAIN
    ) -> None:
        m, n = self._size = H.shape
        self.channels = m
        if not (1 <= n <= MOST_STATES and 1 <= m <= MOST_CHANNELS):
            raise ValueError(f"{n} states and {m} channels came; 1 to {MOST_STATES}, 1 to {MOST_CHANNELS} are needed.")
        self._arrays = {
            name: _checked(name, array, shape)
            for name, array, shape in (
                ("H", H, (m, n)),
                ("R", R, (m, m)),
                ("prior", prior, (n, n)),
                ("right", right, (n,)),
            )
        }
        self._model = _Model(n, m, enough, proper_prior, *(array.ctypes.data for array in self._arrays.values()))
        self.state = np.zeros(kernel.multivariate_size(n, m) // 8).view(np.uint8)
        kernel.multivariate_start(ctypes.byref(self._model), None, None, self.state.ctypes.data)

    def start(self, x: Floats, P: Floats) -> None:
        """Set the state (n,) and its covariance (n, n) before the first row."""
        n = self._size[1]
        x, P = _checked("x", x, (n,)), _checked("P", P, (n, n))
        kernel.multivariate_start(ctypes.byref(self._model), x.ctypes.data, P.ctypes.data, self.state.ctypes.data)

    @property
    def head(self) -> Any:
        """Return the fields of the state that Python reads."""
        return self.state[: _HEAD.itemsize].view(_HEAD)[0]

    @property
    def covariance(self) -> Floats:
        """Return the covariance (n, n) of the state after the last row; valid once the state is determined."""
        n = self._size[1]
        return self.state[_HEAD.itemsize :].view(np.float64)[n : n + n * n].reshape(n, n)

    def filter(self, rows: MeasurementRows, buffers: EstimateBuffers) -> None:
        """Filter rows.

        Raises
        ------
        ValueError
            If the arrays do not fit each other: C would read beyond their ends.
        """
        record, output = self._structs(rows, buffers)
        model = ctypes.byref(self._model)
        kernel.multivariate_filter(model, self.state.ctypes.data, ctypes.byref(record), ctypes.byref(output))

    def smooth(self, rows: MeasurementRows, buffers: EstimateBuffers) -> None:
        """Filter and smooth the last rows of a record.

        `buffers` needs an array for innovations; it gets those of the filter.

        Raises
        ------
        ValueError
            If the arrays do not fit each other.
        """
        if buffers.innovation is None:
            raise ValueError("Smoothing needs an array for innovations; buffers.innovation is None.")
        record, output = self._structs(rows, buffers)
        future = np.zeros((), _FUTURE)
        room = np.empty(kernel.multivariate_room(self._model.states, self._model.channels, record.rows) // 8)
        model = ctypes.byref(self._model)
        kernel.multivariate_end(model, future.ctypes.data)
        rows_and_output = self.state.ctypes.data, ctypes.byref(record), ctypes.byref(output)
        kernel.multivariate_smooth(model, *rows_and_output, future.ctypes.data, room.ctypes.data)

    def smooth_late(self, rows: MeasurementRows, lag: int, ready: int) -> tuple[Floats, Floats]:
        """Smooth the first `ready` rows with the rows up to a lag after each; return signal and sigma, (ready, m) each.

        Afterwards the state is that after these rows. All rows must have the same step before them, except the very
        first row, which has none.

        Raises
        ------
        ValueError
            If the arrays do not fit each other, or the numbers do not fit the rows.
        """
        record, _ = self._structs(rows, EstimateBuffers())
        if not (lag >= 0 and 0 <= ready <= record.rows):
            raise ValueError(f"lag = {lag} and ready = {ready} came; 0 or more, and 0 to {record.rows} are needed.")
        signal, sigma = np.empty((2, ready, self.channels))
        lag = min(lag, record.rows)
        room = np.empty(kernel.multivariate_lag_room(self._model.states, self._model.channels, lag) // 8)
        output = signal.ctypes.data, sigma.ctypes.data, room.ctypes.data
        model = ctypes.byref(self._model)
        kernel.multivariate_lag(model, self.state.ctypes.data, ctypes.byref(record), lag, ready, *output)
        return signal, sigma

    def state_dict(self) -> NDArray[np.uint8]:
        """Return the bytes of the state, without the matrices A and g of the closed loop, which are computed again."""
        m, n = self._size
        kept = self.state[: -8 * n * (n + m)].copy()
        kept[: _HEAD.itemsize].view(_HEAD)["closed"] = 0
        return kept

    def load(self, kept: NDArray[np.uint8]) -> None:
        """Restore the result of `state_dict`.

        Raises
        ------
        ModelError
            If the bytes are not a state of this model.
        """
        (m, n), state = self._size, np.zeros(len(self.state) // 8).view(np.uint8)
        own = state[: -8 * n * (n + m)]
        if kept.dtype != np.uint8 or kept.shape != own.shape:
            raise ModelError(f"The state of a snapshot is {kept.dtype} of shape {kept.shape}, not that of this model.")
        own[:] = kept
        own[: _HEAD.itemsize].view(_HEAD)["closed"] = 0
        if not kernel.multivariate_is_sound(ctypes.byref(self._model), state.ctypes.data):
            raise ModelError("The state of a snapshot has impossible values; pass what snapshot() returned.")
        self.state = state

    def _structs(self, rows: MeasurementRows, buffers: EstimateBuffers) -> tuple[_Record, _Estimates]:
        (m, n), count, runs, steps = self._size, len(rows.z), len(rows.step), len(rows.F)
        shapes: dict[str, tuple[int, ...]] = {"z": (count, m), "F": (steps, n, n), "Q": (steps, n, n)}
        shapes |= {"lengths": (steps,), "first": (runs + 1,), "step": (runs,)}
        for name, array in rows._asdict().items():
            _checked(name, array, shapes[name], np.int64 if name in ("first", "step") else np.float64)
        if not steps:
            raise ValueError("There are no steps; at least one is needed.")
        first, step = rows.first, rows.step
        if first[0] != 0 or first[-1] != count or (first[1:] <= first[:-1]).any():
            raise ValueError(f"Runs of steps begin at {first.tolist()[:9]}; they must ascend from 0 to {count} rows.")
        if runs and not (step.min() >= -1 and step.max() < steps):
            raise ValueError(f"step goes from {step.min()} to {step.max()}; there are {steps} steps.")
        wanted: dict[str, tuple[int, ...]] = {"x": (count, n), "P": (count, n, n)}
        for name, array in buffers._asdict().items():
            if array is not None:
                _checked(name, array, wanted.get(name, (count, m)))
                if not array.flags.writeable:
                    raise ValueError(f"{name} cannot be written; pass a writeable array.")
        record = _Record(*(array.ctypes.data for array in rows), count)
        return record, _Estimates(*(None if array is None else array.ctypes.data for array in buffers))


def _checked(name: str, array: Any, shape: tuple[int, ...], kind: Any = np.float64) -> NDArray[Any]:
    """Return the array if C can read it; otherwise raise a ValueError."""
    if array.dtype != kind or array.shape != shape or not (array.flags.c_contiguous and array.flags.aligned):
        raise ValueError(
            f"{name} is {array.dtype} of shape {array.shape}, not {np.dtype(kind)} of {shape} in one piece."
        )
    return np.asarray(array)
