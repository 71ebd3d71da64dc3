"""Real recordings of a sensor that rests between motions: a filter with modes compared with a fixed filter.

The fixed filter has the kinematic model of order 1 to 3 that is likeliest for the whole recording. Rest noise is the
median of the standard deviations of a causal filter's output in windows of one second that the recording's mask calls
rest, at least one second away from motion. Motion is the rms difference of a causal filter from the fixed filter's
smoother where the mask says that the sensor moves. Both are also given as ratios, switching filter over fixed filter.

Run: python benchmarks/resting.py [-o docs/resting.md]   (the recordings lie in ../shared/data/broad)
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat

import becalm
from becalm.identification.likelihood import Evidence, tune_motion
from pages import page_parser, publish

Floats = NDArray[np.float64]

DATA = Path(__file__).parents[2] / "shared" / "data" / "broad"
RATE_HZ = 2000 / 7


class Trial(NamedTuple):
    """A recording of a gyroscope, with a mask of its motion."""

    name: str
    gyroscope: Floats  # (N, 3) rad/s
    moves: NDArray[np.bool_]  # (N,)


class Row(NamedTuple):
    """The results for one channel; noise and differences in rad/s."""

    rest_raw: float  # noise of the readings at rest
    rest_fixed: float  # noise of the fixed filter at rest
    rest_ratio: float  # switching filter over fixed filter
    motion_fixed: float  # difference of the fixed filter from its smoother in motion
    motion_ratio: float  # switching filter over fixed filter
    modes: str


def trials() -> Iterator[Trial]:
    """Read the recordings."""
    for path in sorted(DATA.glob("*.hdf5")) + sorted(DATA.glob("*.mat")):
        if path.suffix == ".mat":
            arrays = loadmat(path)
            yield Trial(path.stem, np.asarray(arrays["imu_gyr"], float), np.ravel(arrays["movement"]).astype(bool))
        else:
            with h5py.File(path) as file:
                moves = np.ravel(np.array(file["movement"])).astype(bool)
                yield Trial(path.stem, np.array(file["imu_gyr"], float), moves)


def compared(z: Floats, moves: NDArray[np.bool_]) -> Row:
    """Compare both filters on one channel, (N,)."""
    evidence = Evidence.of(z, np.ones(len(z)))
    likeliest = max((tune_motion(order, evidence) for order in (1, 2, 3)), key=lambda tuning: tuning.log_likelihood)
    model = likeliest.component.to_model(1.0, likeliest.noise_variance)
    fixed, smooth = becalm.kalman_filter(model, z).signal[:, 0], becalm.kalman_smoother(model, z).signal[:, 0]
    out = becalm.clean(becalm.Recording(z, rate_hz=RATE_HZ), causal=True)
    own, report = out.signal.samples[:, 0], out.reports[0]
    rest, motion = _rest_noise(moves), _motion_error(moves, smooth)
    modes = ", ".join(f"{name} {mode.share:.0%}" for name, mode in report.modes.items())
    return Row(rest(z), rest(fixed), rest(own) / rest(fixed), motion(fixed), motion(own) / motion(fixed), modes)


def _rest_noise(moves: NDArray[np.bool_]) -> Callable[[Floats], float]:
    width = round(RATE_HZ)
    starts = range(width, len(moves) - 2 * width, width)
    quiet = [slice(start, start + width) for start in starts if not moves[start - width : start + 2 * width].any()]
    return lambda signal: float(np.median([signal[part].std() for part in quiet]))


def _motion_error(moves: NDArray[np.bool_], smooth: Floats) -> Callable[[Floats], float]:
    return lambda signal: float(np.sqrt(np.mean((signal - smooth)[moves] ** 2)))


def as_markdown() -> str:
    """Return the table."""
    lines = [
        "| trial | axis | rest: raw, rad/s | fixed | switching over fixed (<= 0.2) | motion: fixed off its smoother |"
        " switching over fixed (<= 1) | modes |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for trial in trials():
        for axis, z in zip("xyz", trial.gyroscope.T, strict=True):
            row = compared(np.ascontiguousarray(z), trial.moves)
            lines.append(
                f"| {trial.name} | {axis} | {row.rest_raw:.5f} | {row.rest_fixed:.5f} | **{row.rest_ratio:.3f}** |"
                f" {row.motion_fixed:.5f} | **{row.motion_ratio:.4f}** | {row.modes} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the table; with -o, write it as a page."""
    output = page_parser(__doc__).parse_args().output
    if not DATA.is_dir():
        print(f"The recordings are not in {DATA}: nothing was measured, and no page written.", file=sys.stderr)
        return
    publish("Resting", __doc__, as_markdown(), output)


if __name__ == "__main__":
    main()
