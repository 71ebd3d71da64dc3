"""Call the C functions that need no filter: they detect faults of measurements, stamps and innovations."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.native.library import CONSTANTS, kernel, layout_of

Floats = NDArray[np.float64]
Codes = NDArray[np.int8]
Whole = NDArray[np.int64]

LIMITS, WATCHED, CLOCK = map(layout_of, ("limits", "watched", "stamps"))
NEIGHBOURS, SIDE, SPREADS, REACH = (CONSTANTS[name] for name in ("NEIGHBOURS", "SIDE", "SPREADS", "REACH"))
SHORTEST_FILL, EVERY_REPEAT, LONGEST_0 = (CONSTANTS[name] for name in ("SHORTEST_FILL", "EVERY_REPEAT", "LONGEST_0"))
HOP, KEPT_HOPS, PARTS, MOST_SIGMA = (CONSTANTS[name] for name in ("HOP", "KEPT_HOPS", "PARTS", "MOST_SIGMA"))
WINDOW = HOP * CONSTANTS["WINDOW_HOPS"]
"""Number of innovations in a window, whose variance the monitor tests."""

kernel.scan_start.argtypes, kernel.scan_start.restype = [ctypes.c_void_p] * 2, None
kernel.scan_is_sound.argtypes, kernel.scan_is_sound.restype = [ctypes.c_void_p] * 2, ctypes.c_int
kernel.scan_faults.argtypes = [*[ctypes.c_void_p] * 4, ctypes.c_int64, ctypes.c_void_p]
kernel.scan_faults.restype = ctypes.c_int64
kernel.scan_reduce.argtypes, kernel.scan_reduce.restype = [ctypes.c_void_p] * 2, None
kernel.scan_innovations.argtypes = [*[ctypes.c_void_p] * 4, ctypes.c_int64, *[ctypes.c_void_p] * 2]
kernel.scan_innovations.restype = ctypes.c_int64
_POINTER, _COUNT = ctypes.c_void_p, ctypes.c_int64
kernel.scan_outliers.argtypes = [
    _POINTER,
    ctypes.c_double,
    _COUNT,
    _POINTER,
    _COUNT,
    _COUNT,
    ctypes.c_int,
    *[_POINTER] * 3,
]
kernel.scan_outliers.restype = ctypes.c_int64
kernel.scan_outliers_soon.argtypes = [
    *kernel.scan_outliers.argtypes[:6],
    _COUNT,
    *kernel.scan_outliers.argtypes[6:],
]
kernel.scan_outliers_soon.restype = ctypes.c_int64
kernel.measure_distances.argtypes = [ctypes.c_void_p, ctypes.c_int64, *[ctypes.c_void_p] * 3]
kernel.measure_distances.restype = None
kernel.clock_walk.argtypes, kernel.clock_walk.restype = (
    [*[ctypes.c_void_p] * 3, ctypes.c_int64, *[ctypes.c_void_p] * 2],
    None,
)
kernel.measure_jumps.argtypes = [ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p]
kernel.measure_jumps.restype = None


class _Hops(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_void_p) for name in ("totals", "squares", "powers", "steps"))


class Hops(NamedTuple):
    """The sums over each complete hop of innovations."""

    totals: Whole  # (H,) sums, in parts of a sigma
    squares: Whole  # (H,) sums of squares, in parts^2
    powers: Floats  # (H,) sums of squares, in sigma^2
    steps: Floats  # (H,) time of the hop's first innovation, in steps from the very first row


def restored(kept: NDArray[np.int8], struct: np.dtype[np.void]) -> NDArray[np.void] | None:
    """Return a state of the limits (LIMITS) or of the monitor (WATCHED) from its bytes; None if they are invalid."""
    if kept.dtype != np.int8 or kept.shape != (struct.itemsize,):
        return None
    state = np.frombuffer(bytearray(kept.tobytes()), struct).reshape(())
    limits, watched = (state, new_watched()) if struct == LIMITS else (new_limits(), state)
    return state if kernel.scan_is_sound(limits.ctypes.data, watched.ctypes.data) else None


def new_limits() -> NDArray[np.void]:
    """Return the state of the limits before the first measurement."""
    return _started()[0]


def new_watched() -> NDArray[np.void]:
    """Return the state of the monitor before the first innovation."""
    return _started()[1]


def _started() -> tuple[NDArray[np.void], NDArray[np.void]]:
    limits, watched = np.zeros((), LIMITS), np.zeros((), WATCHED)
    kernel.scan_start(limits.ctypes.data, watched.ctypes.data)
    return limits, watched


def scan_faults(settings: NDArray[np.void], limits: NDArray[np.void], z: Floats, elapsed: Floats, codes: Codes) -> int:
    """Write verdicts on faulty measurements into the codes (B,); return how many codes are not 0 afterwards.

    `z` (B,) holds the measurements, in unit, and `elapsed` (B,) the steps before them. The state `limits` changes.
    """
    _check(z, (z, elapsed), (codes,))
    pointers = [array.ctypes.data for array in (settings, limits, z, elapsed)]
    return int(kernel.scan_faults(*pointers, len(z), codes.ctypes.data))


def reduced_limits(settings: NDArray[np.void], limits: NDArray[np.void]) -> bytes:
    """Return the bytes of a copy of the state, reduced to what later verdicts depend on."""
    own = bytearray(limits.tobytes())
    kernel.scan_reduce(settings.ctypes.data, ctypes.addressof(ctypes.c_char.from_buffer(own)))
    return bytes(own)


def scan_innovations(
    settings: NDArray[np.void], watched: NDArray[np.void], normalised: Floats, elapsed: Floats, codes: Codes
) -> Hops:
    """Write the alarms of a monitor of innovations into the codes (B,); return the complete hops.

    `normalised` (B,) holds innovations over their standard deviations, NaN where there is none; `elapsed` (B,) holds
    the steps before the rows. The state `watched` changes.
    """
    _check(normalised, (normalised, elapsed), (codes,))
    most = len(normalised) // HOP + 1
    hops = Hops(*np.empty((2, most), np.int64), *np.empty((2, most)))
    pointers = [array.ctypes.data for array in (settings, watched, normalised, elapsed)]
    output = _Hops(*(array.ctypes.data for array in hops))
    count = kernel.scan_innovations(*pointers, len(normalised), codes.ctypes.data, ctypes.byref(output))
    return Hops(hops.totals[:count], hops.squares[:count], hops.powers[:count], hops.steps[:count])


def scan_outliers(  # noqa: PLR0913  (keyword arguments)
    settings: NDArray[np.void],
    z: Floats,
    codes: Codes,
    *,
    distance: float,
    stuck: int,
    judged_rows: int,
    whole: bool,
    ahead: int = REACH,
) -> int:
    """Write into the codes (N,) the verdicts on measurements that follow from their neighbours on both sides.

    Parameters
    ----------
    settings : () structured array
        Settings with the plausible range, the distance from earlier measurements, and whether repeats count as one.
    z : (N,) float array
        Measurements, in unit, NaN where missing.
    codes : (N,) int8 array
        The codes of rows before `judged_rows` are final; the other codes must be 0.
    distance : float
        Distance of an outlier from the median of its neighbours, in unit; inf: no outliers.
    stuck : int
        This many equal measurements in a row are stuck, including the first; 0 if any number may be equal.
    judged_rows : int
        Number of rows whose codes are final.
    whole : bool
        Whether the record ends here.
    ahead : int
        Largest number of later rows that a row waits for. If these have fewer than two measurements, only the earlier
        measurements are compared.

    Returns
    -------
    int
        The first row that has to wait for later rows; N if no row has to wait.
    """
    _check(z, (z,), (codes,))
    values, ends = np.empty(len(z)), np.empty((len(z), 2), np.int64)
    room = values.ctypes.data, ends.ctypes.data, codes.ctypes.data
    rule, rows = (settings.ctypes.data, distance, stuck), (z.ctypes.data, len(z), judged_rows)
    if ahead < REACH:
        return int(kernel.scan_outliers_soon(*rule, *rows, ahead, whole, *room))
    return int(kernel.scan_outliers(*rule, *rows, whole, *room))


def measure_distances(z: Floats) -> tuple[Floats, Floats]:
    """Return the distance of measurements from the median of six neighbours, and the neighbours' spread, (N,) each.

    Both are 0 if N <= 6.
    """
    _check(z, (z,), ())
    if len(z) <= NEIGHBOURS:
        return np.zeros(len(z)), np.zeros(len(z))
    distances, spreads = np.empty((2, len(z)))
    ends = np.empty((len(z), 2), np.int64)
    kernel.measure_distances(z.ctypes.data, len(z), ends.ctypes.data, distances.ctypes.data, spreads.ctypes.data)
    return distances, spreads


def measure_jumps(z: Floats) -> Floats:
    """Return the distance of each measurement, from the seventh of N on, from the median of the six before it."""
    _check(z, (z,), ())
    jumps = np.empty(max(len(z) - NEIGHBOURS, 0))
    kernel.measure_jumps(z.ctypes.data, len(z), jumps.ctypes.data)
    return jumps


def walk_stamps(clock: NDArray[np.void], stamps: Floats, doubled: Codes, elapsed: Floats, codes: Codes) -> None:
    """Write the steps before each row of a stream into `elapsed` (B,), and codes of its stamps (s) into `codes` (B,).

    `doubled` (B,) is not 0 for rows that repeat the measurements of the previous row. The state `clock` changes.
    """
    _check(stamps, (stamps, elapsed), (doubled, codes))
    if not elapsed.flags.writeable:
        raise ValueError("elapsed cannot be written; pass a writeable array.")
    output = elapsed.ctypes.data, codes.ctypes.data
    kernel.clock_walk(clock.ctypes.data, stamps.ctypes.data, doubled.ctypes.data, len(stamps), *output)


def _check(rows: Floats, reals: tuple[Floats, ...], codes: tuple[Codes, ...]) -> None:
    """Raise a ValueError if arrays do not fit; otherwise C would read or write beyond their ends."""
    for kind, arrays in (("f8", reals), ("i1", codes)):
        for array in arrays:
            flags = array.flags
            in_place = flags.c_contiguous and flags.aligned and (kind == "f8" or flags.writeable)
            if array.dtype != kind or array.shape != (len(rows),) or not in_place:
                raise ValueError(f"{array.dtype} {array.shape} came; {kind} ({len(rows)},) in one piece is needed.")
