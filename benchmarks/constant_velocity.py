"""Position error of `becalm.clean` without options, relative to a filter with the true model, Q and R.

A target moves at constant velocity, disturbed by white acceleration; N = 2000 readings of its position, mean of
20 seeds. Q = q [[dt^3/3, dt^2/2], [dt^2/2, dt]], R = r. becalm does not know q, r or the order of the model.

Run: python benchmarks/constant_velocity.py [-o docs/constant-velocity.md]
"""

from __future__ import annotations

import time
from statistics import mean
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import becalm
from becalm.metrics.truth import rms_error
from pages import page_parser, publish

COUNT, SEEDS = 2000, 20
CASES = ((0.01, 100.0, 1.0), (0.01, 1e4, 1.0), (0.002, 1e3, 0.01))  # dt in s, q, r


class CaseResult(NamedTuple):
    """The result of one case in one mode."""

    ratio: float  # of rms errors, mean over seeds
    worst: float  # largest ratio
    orders: str  # orders that becalm chose, with their counts
    seconds: float  # mean time of a record


def draw(dt: float, q: float, r: float, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64], becalm.Model]:
    """Return positions, readings and the true model."""
    model = becalm.components.motion(2, q).to_model(dt, r)
    rng = np.random.default_rng([seed, int(q)])
    root = np.linalg.cholesky(model.process_covariance)
    x, position = np.zeros(2), np.empty(COUNT)
    for k in range(COUNT):
        position[k] = x[0]
        x = model.F @ x + root @ rng.normal(size=2)
    return position, position + np.sqrt(r) * rng.normal(size=COUNT), model


def measure(dt: float, q: float, r: float, causal: bool) -> CaseResult:
    """Run one case."""
    ratios, seconds, orders = [], [], []
    run = becalm.kalman_filter if causal else becalm.kalman_smoother
    for seed in range(SEEDS):
        position, z, model = draw(dt, q, r, seed)
        begun = time.perf_counter()
        out = becalm.clean(becalm.Recording(z, rate_hz=1 / dt), causal=causal)
        seconds.append(time.perf_counter() - begun)
        known = slice(2, None)
        true = rms_error(run(model, z).signal[known, 0], position[known])
        ratios.append(rms_error(out.signal.samples[known, 0], position[known]) / true)
        orders.append(out.reports[0].order)
    tried = ", ".join(f"{orders.count(n)} x {n}" for n in sorted(set(orders), key=str))
    return CaseResult(mean(ratios), max(ratios), tried, mean(seconds[1:]))


def page() -> str:
    """Run all cases, and return the table."""
    lines = ["| dt | q | r | mode | error over that of the true model | worst | orders | s a record |"]
    lines.append("|---|---|---|---|---|---|---|---|")
    for case in CASES:
        for causal in (True, False):
            got = measure(*case, causal)
            names = " | ".join(f"{value:g}" for value in case)
            mode = "causal" if causal else "smoothed"
            lines.append(
                f"| {names} | {mode} | **{got.ratio:.3f}** | {got.worst:.3f} | {got.orders} | {got.seconds:.3f} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the table; with -o, write it as a page."""
    output = page_parser(__doc__).parse_args().output
    publish("Constant velocity", __doc__, page(), output)


if __name__ == "__main__":
    main()
