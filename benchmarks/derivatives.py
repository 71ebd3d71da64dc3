"""rms errors on PyNumDiff's simulations, relative to those of PyNumDiff's `rtsdiff` that is tuned with the truth.

Six signals of 4 s at 100 Hz, white noise of 0.1 and 0.4, median of 20 seeds. The rival is the same kind of
smoother, of order 1 to 3, with the order and the ratio that have the least rms error, *computed with the truth*:
one choice for the signal, another one for its derivative. becalm gets only the readings, and no options.
rtsdiff runs with its defaults, not forward and back.

Run: pip install 'becalm[bench]', then python benchmarks/derivatives.py [-o docs/derivatives.md]
"""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.filter.smoothing import kalman_smoother
from becalm.identification.choose import choose
from becalm.metrics.truth import rms_error
from pages import page_parser, publish

Floats = NDArray[np.float64]

STEP_S, DURATION_S, SEEDS = 0.01, 4, 20
NOISES = (0.1, 0.4)
SIGNALS = {
    "PI cruise control": "pi_cruise_control",
    "sum of sines": "sine",
    "triangles": "triangle",
    "logistic growth": "pop_dyn",
    "linear autonomous": "linear_autonomous",
    "Lorenz x": "lorenz_x",
}
ORDERS, LOG_RATIOS = (1, 2, 3), np.arange(1.0, 12.1, 0.25)  # decimal logarithms, as rtsdiff takes them


class Errors(NamedTuple):
    """rms errors of a signal and of its derivative."""

    signal: float
    slope: float


def rival(rtsdiff: Any, z: Floats, truth: tuple[Floats, Floats]) -> Errors:
    """Return the least errors of signal and derivative that rtsdiff can have."""
    found = []
    for order in ORDERS:
        for log_ratio in LOG_RATIOS:
            signal, slope = rtsdiff(z, STEP_S, order, float(log_ratio))
            found.append((rms_error(signal, truth[0]), rms_error(slope, truth[1])))
    return Errors(*np.nanmin(found, axis=0).tolist())


def ours(z: Floats, truth: tuple[Floats, Floats]) -> Errors:
    """Smooth with the chosen model; the derivative is the second state, or a difference if there is only one state."""
    tuning = choose(z, np.ones(len(z)), causal=False).tuning
    if tuning is None:
        raise ValueError("These readings tell no noise.")
    smoothed = kalman_smoother(tuning.component.to_model(1.0, tuning.noise_variance), z, states=True)
    signal, states = smoothed.signal[:, 0], smoothed.mean
    slope = np.gradient(signal) if tuning.order == 1 or states is None else states[:, 1]
    return Errors(rms_error(signal, truth[0]), rms_error(slope / STEP_S, truth[1]))


def page() -> str:
    """Run all cases, and return the table."""
    rtsdiff, simulate = import_module("pynumdiff.kalman_smooth").rtsdiff, import_module("pynumdiff.utils.simulate")
    lines = ["| signal | noise | x | its worst seed | dx/dt | its worst seed |", "|---|---|---|---|---|---|"]
    ratios = []
    for name, function in SIGNALS.items():
        made = getattr(simulate, function)(duration=DURATION_S, dt=STEP_S)
        truth = np.asarray(made[1], dtype=np.float64), np.asarray(made[2], dtype=np.float64)
        for noise in NOISES:
            case = []
            for seed in range(SEEDS):
                z = truth[0] + noise * np.random.default_rng([seed, int(10 * noise)]).normal(size=len(truth[0]))
                best, found = rival(rtsdiff, z, truth), ours(z, truth)
                case.append((found.signal / best.signal, found.slope / best.slope))
            middle, worst = np.median(case, axis=0), np.max(case, axis=0)
            ratios.append(case)
            lines.append(f"| {name} | {noise} | {middle[0]:.3f} | {worst[0]:.2f} | {middle[1]:.3f} | {worst[1]:.2f} |")
    whole = np.median(np.concatenate(ratios), axis=0)
    lines += [
        "",
        f"Median of all: **{whole[0]:.3f}** for x, **{whole[1]:.3f}** for dx/dt.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the table; with -o, write it as a page."""
    output = page_parser(__doc__).parse_args().output
    warnings.simplefilter("ignore")  # of solvers that are not needed here
    try:
        text = page()
    except ModuleNotFoundError as cause:
        sys.exit(f"{cause.name} is not installed; type: pip install 'becalm[bench]'")
    publish("Derivatives", __doc__, text, output)


if __name__ == "__main__":
    main()
