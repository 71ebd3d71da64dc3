"""Full process and measurement covariances of several channels by maximum likelihood: errors, their estimates, time.

Two states, two channels: F = [[0.9, 0], [-0.3, 0.8]], H = I, Q = [[2, -0.5], [-0.5, 1]], R = diag(3, 2),
N = 1001, with a known initial state. All six entries of Q and R are unknown, and the search starts from
identity matrices. For comparison, unweighted least squares on the readings' autocovariances uses the same records.
Then the car: three channels at 500 Hz, F = [[1, T, 0], [0, 1, 0], [0, 0, 1]], G = [[T^2/2, 0], [T, 0], [0, T]],
H = I; two variances of Q, three of R and the initial state are unknown. Times are processor times of one
thread.

Run: python benchmarks/full_noise.py [-o docs/full-noise.md] [--runs 500]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.identification.several.autocovariances import autocovariances
from becalm.identification.several.joint import TunedModel, tune_model
from becalm.identification.several.matrices import patterns_of
from pages import page_parser, publish

Floats = NDArray[np.float64]

SEED = 20260101
ROWS, CAR_ROWS, LONG_ROWS = 1001, 10_000, 1_000_000
CAR_RUNS = 50
STEP_S = 1 / 500

PLANE = Model(
    F=[[0.9, 0.0], [-0.3, 0.8]],
    H=np.eye(2),
    Q=[[2.0, -0.5], [-0.5, 1.0]],
    R=np.diag([3.0, 2.0]),
    x0=np.zeros(2),
    P0=np.zeros((2, 2)),
)
CAR = Model(
    F=np.array([[1, STEP_S, 0], [0, 1, 0], [0, 0, 1]]),
    G=[[STEP_S**2 / 2, 0], [STEP_S, 0], [0, STEP_S]],
    H=np.eye(3),
    Q=np.diag([1e5, 1e5]),
    R=np.diag([100.0, 100.0, 100.0]),
)


class Runs(NamedTuple):
    """The tuned covariances of many records of one model; each row is one record."""

    off: Floats  # errors of the entries, estimate minus truth
    errors: Floats  # estimated standard errors of the entries
    moments: Floats  # errors of least squares on autocovariances
    seconds: Floats  # processor time


def simulate(model: Model, count: int, seed: list[int]) -> Floats:
    """Draw readings (N, m) of a model that starts at zero."""
    rng = np.random.default_rng(seed)
    w = rng.multivariate_normal(np.zeros(len(model.Q)), model.Q, count) @ model.G.T
    v = rng.multivariate_normal(np.zeros(model.channels), model.R, count)
    x, z = np.zeros(model.states), v.copy()
    for k in range(count):
        z[k] += model.H @ x
        x = model.F @ x + w[k]
    return z


def unknowing(model: Model) -> Model:
    """Return the model with identity matrices as Q and R."""
    Q, R = np.eye(len(model.Q)), np.eye(model.channels)
    return Model(F=model.F, H=model.H, Q=Q, R=R, G=model.G, x0=model.x0, P0=model.P0)


def by_moments(model: Model, z: Floats) -> Floats:
    """Estimate the entries by unweighted least squares on the readings' autocovariances."""
    process, noise = patterns_of("Q", model.Q, "full"), patterns_of("R", model.R, "full")
    together = np.ones((model.channels, model.channels), dtype=bool)
    found = autocovariances(model, process, noise, together, np.ones(model.channels)).estimate(z)
    assert found is not None, "records are complete"
    return found


def entries(Q: Floats, R: Floats, full: bool) -> Floats:
    """Return the unknown entries of Q and R, in one row."""
    parts = [matrix[np.tril_indices(len(matrix))] if full else np.diag(matrix) for matrix in (Q, R)]
    return np.concatenate(parts)


def repeat(model: Model, rows: int, runs: int, tune: Callable[[Floats], TunedModel], full: bool) -> Runs:
    """Tune many records of one model."""
    truth = entries(model.Q, model.R, full)
    tune(simulate(model, rows, [SEED]))  # a run to warm up
    off, errors, moments, seconds = [], [], [], []
    for run in range(runs):
        z = simulate(model, rows, [SEED, run])
        begun = time.process_time()
        found = tune(z)
        seconds.append(time.process_time() - begun)
        off.append(entries(found.model.Q, found.model.R, full) - truth)
        errors.append(entries(found.process_error, found.noise_error, full))
        moments.append(by_moments(model, z) - truth if full else truth * np.nan)
    return Runs(*(np.array(each) for each in (off, errors, moments, seconds)))


def shares(runs: Runs) -> str:
    """Return the shares of errors within one and within two standard errors."""
    off = np.abs(runs.off / runs.errors)
    return f"{np.mean(off < 1):.1%} | {np.mean(off < 2):.1%}"


def plane_page(runs: int) -> list[str]:
    """Measure the six entries of the model with two channels."""
    found = repeat(PLANE, ROWS, runs, lambda z: tune_model(unknowing(PLANE), z, "full", "full"), full=True)
    names = ["Q[0,0]", "Q[0,1]", "Q[1,1]", "R[0,0]", "R[0,1]", "R[1,1]"]
    squares, rough, expected = ((each**2).mean(axis=0) for each in (found.off, found.moments, found.errors))
    lines = [
        f"## Two channels, six unknowns, {runs} records of {ROWS} rows",
        "",
        "| mean squared error of | autocovariances | likelihood | what its standard errors promise |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {name} | {a:.4f} | {b:.4f} | {c:.4f} |"
        for name, a, b, c in zip(names, rough, squares, expected, strict=True)
    ]
    uncertain = (found.off**2).sum(axis=1).std() / np.sqrt(runs)
    return [
        *lines,
        f"| **sum** | {rough.sum():.3f} | **{squares.sum():.3f}** (asked: at most 0.19) | {expected.sum():.3f} |",
        "",
        f"The sum is itself uncertain by {uncertain:.3f}, for there are only {runs} records.",
        "",
        "| within one error | within two | milliseconds a record, median | slowest |",
        "|---|---|---|---|",
        f"| {shares(found)} | **{1e3 * np.median(found.seconds):.1f}** (asked: at most 30) |"
        f" {1e3 * found.seconds.max():.1f} |",
        "",
    ]


def car_page(car_runs: int) -> list[str]:
    """Measure the five variances of the car, and a long record."""
    found = repeat(CAR, CAR_ROWS, car_runs, lambda z: tune_model(unknowing(CAR), z), full=False)
    truth = entries(CAR.Q, CAR.R, full=False)
    names = ["Q[0,0]", "Q[1,1]", "R[0,0]", "R[1,1]", "R[2,2]"]
    lines = [
        f"## The car: three channels, five unknowns, {car_runs} records of {CAR_ROWS} rows",
        "",
        "| | true | mean found | rms error | mean standard error |",
        "|---|---|---|---|---|",
    ]
    columns = (truth, truth + found.off.mean(axis=0), np.sqrt((found.off**2).mean(axis=0)), found.errors.mean(axis=0))
    lines += [
        f"| {name} | {a:.6g} | {b:.5g} | {c:.3g} | {d:.3g} |" for name, a, b, c, d in zip(names, *columns, strict=True)
    ]
    z = simulate(CAR, LONG_ROWS, [SEED, 1])
    begun = time.process_time()
    once = tune_model(unknowing(CAR), z)
    took = time.process_time() - begun
    off = entries(once.model.Q, once.model.R, False) - truth
    worst = np.abs(off / entries(once.process_error, once.noise_error, False)).max()
    return [
        *lines,
        "",
        "| within one error | within two | seconds a record, median |",
        "|---|---|---|",
        f"| {shares(found)} | {np.median(found.seconds):.2f} |",
        "",
        f"{LONG_ROWS:,} rows of three channels, tuned jointly: **{took:.1f} s** (asked: well under a minute);"
        f" the worst of the five is {worst:.1f} standard errors off.",
        "",
    ]


def untold_page() -> list[str]:
    """Show what becalm says if readings do not determine an entry."""
    accelerometer = Model(F=np.array([[1, STEP_S], [0, 1]]), H=[[0, 1]], Q=np.diag([1e-3, 4e-3]), R=[[1.0]])
    slope = motion(2, 0.01).to_model(1.0, 1.0)
    silent = simulate(CAR, 3000, [SEED, 2])
    silent[:, 1] = np.nan
    overdone = np.diff(np.random.default_rng(SEED).normal(size=2000))
    cases = {
        "a velocity that no channel reads": tune_model(accelerometer, simulate(accelerometer, 4000, [SEED, 3])),
        "a walking slope, all of Q free": tune_model(slope, simulate(slope, 4000, [SEED, 4]), "full"),
        "the car, whose second channel is silent": tune_model(CAR, silent),
        "differenced white noise, taken for a level": tune_model(motion(1).to_model(1.0, 1.0), overdone),
    }
    lines = ["## What readings do not tell", "", "| record | said |", "|---|---|"]
    said = {name: " ".join(found.not_identifiable) or "nothing: all is told" for name, found in cases.items()}
    return [*lines, *(f"| {name} | {sentences} |" for name, sentences in said.items()), ""]


def main() -> None:
    """Print the tables; with -o, write them as a page."""
    parser = page_parser(__doc__)
    parser.add_argument("--runs", type=int, default=500, help="records of two channels")
    arguments = parser.parse_args()
    text = "\n".join(plane_page(arguments.runs) + car_page(CAR_RUNS) + untold_page())
    publish("Full covariances", __doc__, text, arguments.output)


if __name__ == "__main__":
    main()
