"""The IMU paper's tuning repeated: the minimum of step lag plus spectrum, on white noise of the measured variance.

The paper (Kownacki 2010) tunes R and Q of a filter for an accelerometer, state [V, a], and for a gyroscope,
state [omega, epsilon], by the cost of its equation (10); its records are not public. Here ten seconds of
white noise at 10 kHz stand in for them, with the variances of its table 1.

Run: python benchmarks/imu_tuning.py [-o docs/imu-tuning.md]
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from becalm.identification.several.step_spectrum import Sensor, StepTrial
from becalm.identification.several.step_tuning import StepTuning, tune_by_simplex, tune_by_step
from becalm.studies.imu.imu_records import HARMONICS_HZ, PRINTED, RATE_HZ
from pages import page_parser, publish

Floats = NDArray[np.float64]

COUNT = 100_000
SEEDS = range(10)
ONES = np.ones((2, 2))
SHARES = (0.0, 0.5, 0.9, 0.99)


def white(sensor: Sensor, seed: int, share: float = 1.0) -> Floats:
    """Return white noise, (N,), with a share of the variance of table 1."""
    return np.random.default_rng(seed).normal(0, np.sqrt(share * PRINTED[sensor].measured_noise), COUNT)


def harmonics(sensor: Sensor, share: float) -> Floats:
    """Return equal harmonics of 50 Hz up to 500 Hz, (N,), with a share of the variance of table 1."""
    t = np.arange(COUNT) / RATE_HZ
    phases = np.random.default_rng(0).uniform(0, 2 * np.pi, len(HARMONICS_HZ))
    size = np.sqrt(2 * share * PRINTED[sensor].measured_noise / len(HARMONICS_HZ))
    return np.asarray(size * np.sin(2 * np.pi * np.outer(t, HARMONICS_HZ) + phases).sum(axis=1))


def trial(sensor: Sensor, record: Floats) -> StepTrial:
    """Return the paper's trial: a step of 0.2 after 5 s, P0 of ones."""
    return StepTrial(record, RATE_HZ, sensor, initial_covariance=ONES)


def optima() -> str:
    """Compare the ratios Q/R of least cost with those that the paper prints."""
    lines = [
        "| sensor | \\|X(f)\\| is | Q/R in the paper | Q/R here, of 10 records: median (least to most) | t_f - t_s, ms"
        " | J at the paper's ratio over the least J |",
        "|---|---|---|---|---|---|",
    ]
    for sensor, printed in PRINTED.items():
        for spectrum in ("amplitude", "power"):
            trials = [replace(trial(sensor, white(sensor, seed)), spectrum=spectrum) for seed in SEEDS]
            found = [tune_by_step(each, printed.measured_noise) for each in trials]
            ratios = [each.ratio for each in found]
            reached_ms = 1e3 * np.nanmedian([each.cost.reached_after_s for each in found])
            there = [each.cost(printed.tuned_noise, printed.tuned_process).total for each in trials]
            excess = np.median([cost / each.cost.total for cost, each in zip(there, found, strict=True)])
            lines.append(
                f"| {sensor} | {spectrum} density | {printed.ratio:.4g} | **{np.median(ratios):.4g}**"
                f" ({min(ratios):.4g} to {max(ratios):.4g}) | {reached_ms:.3g} | {excess:.3g} |"
            )
    return "\n".join(lines)


def coloured() -> str:
    """Show the effect of harmonics on the accelerometer's optimum."""
    lines = ["| share of the variance in harmonics | Q/R of least cost |", "|---|---|"]
    for share in SHARES:
        record = white("accelerometer", 0, 1 - share) + harmonics("accelerometer", share)
        found = tune_by_step(trial("accelerometer", record), PRINTED["accelerometer"].measured_noise)
        lines.append(f"| {share:.0%} | {found.ratio:.4g} |")
    return "\n".join(lines)


def valley() -> str:
    """Show where searches over R and Q end, and where the search over Q/R ends."""
    lines = ["| sensor | search | from R, Q | to R, Q | Q/R | J | filters |", "|---|---|---|---|---|---|---|"]
    for sensor, printed in PRINTED.items():
        one = replace(trial(sensor, white(sensor, 0)), initial_covariance=None)
        found = tune_by_step(one, printed.measured_noise)
        lines.append(_valley_row(sensor, "over Q/R", f"R = {printed.measured_noise:.4g}", found))
        for R, Q in ((printed.measured_noise, printed.measured_process), (1e-3, 1.0), (1.0, 1e-3)):
            lines.append(_valley_row(sensor, "simplex", f"{R:.4g}, {Q:.4g}", tune_by_simplex(one, R, Q)))
    return "\n".join(lines)


def _valley_row(sensor: Sensor, search: str, start: str, found: StepTuning) -> str:
    end = f"{found.noise_variance:.3g}, {found.process_variance:.3g}"
    return (
        f"| {sensor} | {search} | {start} | {end} | {found.ratio:.4g} | {found.cost.total:.6g} | {found.evaluations} |"
    )


def page() -> str:
    """Return the page with all tables and their discussion."""
    return f"""## The optimum

J(R, Q) = int from t_s to t_f of (S - x)^2 dt + int from 0 to Fs/2 of |X(f)| df: the first for the record plus a
step S = 0.2 at t_s = 5 s, until x first reaches S; the second of the Welch spectrum (segments of 1024) of the
filter's output for the record alone.

{optima()}

- The gyroscope's record was nearly white, and its printed optimum comes out, if |X(f)| is the *amplitude*
  spectral density, the square root of the Welch power density. With the power density the least cost lies some
  five decades away.
- The accelerometer's record was not white: the paper shows harmonics from 50 to 500 Hz. How they were spread is
  not printed. Put into equal harmonics of 50 Hz, a share of the same variance slows the optimum down, but not to
  the printed {PRINTED["accelerometer"].ratio:.4g}; what else the record held is not known:

{coloured()}

## The valley

Only Q/R sets the gain, so that J is the same all along Q/R = constant, and a search over R and Q ends at an
arbitrary point there. Over Q/R alone, with R that of the record, the answer is one. Both start from the first
readings; a fixed P0 would tilt the floor a little.

{valley()}
"""


def main() -> None:
    """Print the tables; with -o, write them as a page."""
    output = page_parser(__doc__).parse_args().output
    publish("The IMU paper's tuning", __doc__, page(), output)


if __name__ == "__main__":
    main()
