"""What a fixed lag buys: errors at lags from the filter to the smoother, tuned as either; its curve; its time.

The signals and noises of `accuracy.py`, 100 Hz. Each recording is tuned twice, as a causal filter and as a
smoother, motions alone without the tones beside them, and then smoothed with lags of 0, 1, 3, 10 and 30
readings, and of all.

Run: python benchmarks/fixed_lag.py [-o docs/fixed-lag.md]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

import becalm
from accuracy import COUNT, NOISES, RATE_HZ, SEED, SIGNALS
from becalm.core.components import ORDERS, motion
from becalm.core.fixed_lag import fixed_lag_smoother
from becalm.core.smoothing import kalman_smoother
from becalm.metrics.truth import rms_error
from becalm.noise.cross_validation import simplest, tune_smoother
from becalm.noise.likelihood import Evidence, Tuning, tune_motion
from becalm.noise.risk import retune
from becalm.noise.waiting import delay_curve
from pages import page_parser, publish

Floats = NDArray[np.float64]

LAGS = (0, 1, 3, 10, 30, None)  # None: the smoother
EXAMPLES = (("ramp and hold", 0.05), ("band-limited noise", 0.30), ("braking", 0.05))
TIMED = 100_000


def tuned(z: Floats, causal: bool) -> Tuning:
    """Tune the motion of a record as a filter or as a smoother, in steps."""
    evidence = Evidence.of(z, np.ones(len(z)))
    if not causal:
        return simplest(tune_smoother(evidence))
    rivals = [tune_motion(order, evidence) for order in ORDERS]
    return retune(max(rivals, key=lambda tuning: tuning.log_likelihood), evidence)


def errors(z: Floats, truth: Floats, tuning: Tuning) -> list[float]:
    """Return the rms error at each lag."""
    model, level = tuning.component.to_model(1.0, tuning.noise_variance), z[0]
    found = []
    for lag in LAGS:
        told = kalman_smoother(model, z - level).signal if lag is None else fixed_lag_smoother(model, z - level, lag)[0]
        found.append(rms_error(told[:, 0] + level, truth))
    return found


def run() -> tuple[list[tuple[str, float, list[float], list[float]]], dict[tuple[str, float], Tuning]]:
    """Run all cases, tuned in both ways."""
    t, rows, kept = np.arange(COUNT) / RATE_HZ, [], {}
    for number, (name, signal) in enumerate(SIGNALS.items()):
        for noise in NOISES:
            truth = signal(t)
            rng = np.random.default_rng([SEED, number, int(100 * noise)])
            z = truth + noise * truth.std() * rng.normal(size=COUNT)
            filtering, smoothing = tuned(z, True), tuned(z, False)
            rows.append((name, noise, errors(z, truth, filtering), errors(z, truth, smoothing)))
            kept[name, noise] = smoothing
    return rows, kept


def error_table(rows: list[tuple[str, float, list[float], list[float]]]) -> str:
    """Write rms errors, tuned as a filter / as a smoother, over that of the smoother tuned as one."""
    heads = [f"lag {lag}" if lag is not None else "all" for lag in LAGS]
    lines = ["| signal | noise | " + " | ".join(heads) + " |", "|---" * (len(heads) + 2) + "|"]
    ratios = np.array([[np.divide(a, c[-1]), np.divide(c, c[-1])] for _, _, a, c in rows])
    for (name, noise, *_), (a, c) in zip(rows, ratios, strict=True):
        cells = " | ".join(f"{x:.2f} / {y:.2f}" for x, y in zip(a, c, strict=True))
        lines.append(f"| {name} | {noise:.0%} | {cells} |")
    mean = np.exp(np.log(ratios).mean(axis=0))
    cells = " | ".join(f"**{x:.3f} / {y:.3f}**" for x, y in mean.T)
    better = " | ".join(f"{np.sum(c < a)} of {len(rows)}" for a, c in ratios.transpose(2, 1, 0))
    return "\n".join([*lines, f"| geometric mean | | {cells} |", f"| better tuned as a smoother | | {better} |"])


def curve_table(kept: dict[tuple[str, float], Tuning]) -> str:
    """Write the curves of delay against noise of three examples."""
    lines = []
    for name, noise in EXAMPLES:
        told = [
            f"{wait.wait_s * 1e3:.4g} ms {wait.left_db:.1f} dB" for wait in delay_curve(kept[name, noise], 1 / RATE_HZ)
        ]
        lines.append(f"- {name}, {noise:.0%} noise, order {kept[name, noise].order}: {', '.join(told)} (the limit)")
    return "\n".join(lines)


def nanoseconds(use: Callable[[Floats], object], z: Floats) -> float:
    """Return the shortest of five times, a reading."""
    took = []
    for _ in range(5):
        begun = time.perf_counter()
        use(z)
        took.append(time.perf_counter() - begun)
    return min(took) / len(z) * 1e9


def step_through(online: becalm.Online, z: Floats) -> None:
    """Take readings one by one."""
    for reading in z.tolist():
        online.step(reading)


def time_table() -> str:
    """Write what a reading costs a stream of order 2, with lags of 0, 10, 100 and 1000, in blocks and one by one."""
    model, z = motion(2, 1e-3).to_model(1.0, 1.0), np.random.default_rng(1).normal(size=TIMED)
    holes = np.where(np.random.default_rng(2).random(TIMED // 10) < 0.01, np.nan, z[: TIMED // 10])
    lines, first = (
        ["| lag | block, ns | over lag 0 | 1 % missing, ns | one by one, ns |", "|---|---|---|---|---|"],
        np.nan,
    )
    for lag in (0, 10, 100, 1000):
        online = becalm.Online(model, lag)
        online.run(z[:5000])
        block = nanoseconds(online.run, z)
        first = block if lag == 0 else first
        single = nanoseconds(partial(step_through, online), z[:2000])
        missing = nanoseconds(online.run, holes)
        lines.append(f"| {lag} | {block:.0f} | {block / first:.1f} | {missing:.0f} | {single:.0f} |")
    return "\n".join(lines)


def main() -> None:
    """Print the tables; with -o, write them as a page."""
    output = page_parser(__doc__).parse_args().output
    rows, kept = run()
    text = "\n\n".join(
        [
            "## Errors\n\nOver that of the smoother; tuned as a filter / as a smoother.",
            error_table(rows),
            "## Delay and noise\n\nSigma of the settled filter over the noise of a reading, at each delay.",
            curve_table(kept),
            "## Time\n\nOf a reading, order 2.",
            time_table(),
        ]
    )
    publish("Fixed lag", __doc__, text + "\n", output)


if __name__ == "__main__":
    main()
