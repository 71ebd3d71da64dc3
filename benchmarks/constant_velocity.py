"""Position error of `becalm.clean`, nothing chosen, over that of the same filter with the true Q and R.

A target of constant velocity but for white acceleration, N = 2000 readings of its position; the mean of
20 seeds. Q = q [[dt^3/3, dt^2/2], [dt^2/2, dt]], R = r. becalm is told neither q, r nor the order of motion.

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


class Told(NamedTuple):
    """What one case gave in one mode."""

    ratio: float  # mean over seeds
    worst: float
    orders: str
    seconds: float  # a record, mean


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


def measure(dt: float, q: float, r: float, causal: bool) -> Told:
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
    return Told(mean(ratios), max(ratios), tried, mean(seconds[1:]))


def page() -> str:
    """Run all cases and write the table."""
    lines = ["| dt | q | r | mode | error over that of the true model | worst | orders | s a record |"]
    lines.append("|---|---|---|---|---|---|---|---|")
    for case in CASES:
        for causal in (True, False):
            told = measure(*case, causal)
            names = " | ".join(f"{value:g}" for value in case)
            mode = "causal" if causal else "smoothed"
            lines.append(
                f"| {names} | {mode} | **{told.ratio:.3f}** | {told.worst:.3f} | {told.orders} | {told.seconds:.3f} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the table; with -o, write it as a page."""
    output = page_parser(__doc__).parse_args().output
    publish("Constant velocity", __doc__, page(), output)


if __name__ == "__main__":
    main()
