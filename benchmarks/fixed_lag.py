"""What a fixed lag gains and costs: errors between those of filter and smoother, the trade-off curve, and time.

The signals and noises of `accuracy.py`, 100 Hz. Each recording is tuned twice, as a causal filter and as a
smoother, with kinematic models only, without tones. It is then smoothed with lags of 0 to 30 readings, and with all
later readings. `becalm clean` uses three rows of the lag to detect outliers: for a lag of 13, 20 or 30 rows it smooths
with 10, 17 or 27. Times are processor times, the shortest of five runs.

Run: python benchmarks/fixed_lag.py [-o docs/fixed-lag.md]
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import becalm
from accuracy import COUNT, NOISES, RATE_HZ, SEED, SIGNALS
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.fixed_lag import fixed_lag_smoother
from becalm.core.model.components import ORDERS, motion
from becalm.identification.cross_validation import simplest, tune_smoother
from becalm.identification.likelihood import Evidence, Tuning, tune_motion
from becalm.identification.risk import retune
from becalm.identification.wishes.gain_of_waiting import delay_curve
from becalm.metrics.truth import rms_error
from pages import page_parser, publish
from stopwatch import nanoseconds, step_through

Floats = NDArray[np.float64]

LAGS = (0, 1, 3, 10, 13, 17, 20, 27, 30, None)  # None: the smoother
EXAMPLES = (("ramp and hold", 0.05), ("band-limited noise", 0.30), ("braking", 0.05))
TIMED, STEPPED = 100_000, 2000  # rows in blocks, and one by one


class Case(NamedTuple):
    """The rms errors of a signal at each lag, tuned as a filter and as a smoother, and the tuning of the smoother."""

    signal: str
    noise: float
    as_filter: list[float]
    as_smoother: list[float]
    smoother: Tuning


def tuned(z: Floats, causal: bool) -> Tuning:
    """Tune the kinematic model of a record as a filter or as a smoother, in units of steps."""
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
        out = kalman_smoother(model, z - level).signal if lag is None else fixed_lag_smoother(model, z - level, lag)[0]
        found.append(rms_error(out[:, 0] + level, truth))
    return found


def run() -> list[Case]:
    """Run all cases, tuned as filters and as smoothers."""
    t, cases = np.arange(COUNT) / RATE_HZ, []
    for number, (name, signal) in enumerate(SIGNALS.items()):
        for noise in NOISES:
            truth = signal(t)
            rng = np.random.default_rng([SEED, number, int(100 * noise)])
            z = truth + noise * truth.std() * rng.normal(size=COUNT)
            filtering, smoothing = tuned(z, True), tuned(z, False)
            cases.append(Case(name, noise, errors(z, truth, filtering), errors(z, truth, smoothing), smoothing))
    return cases


def error_table(cases: list[Case]) -> str:
    """Return the rms errors tuned as a filter / as a smoother, relative to the smoother that is tuned as a smoother."""
    heads = [f"lag {lag}" if lag is not None else "all" for lag in LAGS]
    lines = ["| signal | noise | " + " | ".join(heads) + " |", "|---" * (len(heads) + 2) + "|"]
    ratios = np.array([np.divide([one.as_filter, one.as_smoother], one.as_smoother[-1]) for one in cases])
    for one, (filtering, smoothing) in zip(cases, ratios, strict=True):
        cells = " | ".join(f"{x:.2f} / {y:.2f}" for x, y in zip(filtering, smoothing, strict=True))
        lines.append(f"| {one.signal} | {one.noise:.0%} | {cells} |")
    mean = np.exp(np.log(ratios).mean(axis=0))
    cells = " | ".join(f"**{x:.3f} / {y:.3f}**" for x, y in mean.T)
    better = " | ".join(f"{np.sum(own < other)} of {len(cases)}" for other, own in ratios.transpose(2, 1, 0))
    return "\n".join([*lines, f"| geometric mean | | {cells} |", f"| better tuned as a smoother | | {better} |"])


def curve_table(cases: list[Case]) -> str:
    """Return the curves of noise against delay of three examples."""
    lines = []
    for one in (case for case in cases if (case.signal, case.noise) in EXAMPLES):
        curve = delay_curve(one.smoother, 1 / RATE_HZ)
        points = ", ".join(f"{delay.wait_s * 1e3:.4g} ms {delay.left_db:.1f} dB" for delay in curve)
        lines.append(f"- {one.signal}, {one.noise:.0%} noise, order {one.smoother.order}: {points} (the limit)")
    return "\n".join(lines)


def time_table() -> str:
    """Return the times of a reading in a stream of order 2, with lags of 0, 10, 100 and 1000, in blocks and singly."""
    model, z = motion(2, 1e-3).to_model(1.0, 1.0), np.random.default_rng(1).normal(size=TIMED)
    holes = np.where(np.random.default_rng(2).random(TIMED // 10) < 0.01, np.nan, z[: TIMED // 10])
    lines = ["| lag | block, ns | over lag 0 | 1 % missing, ns | one by one, ns |", "|---|---|---|---|---|"]
    first = np.nan
    for lag in (0, 10, 100, 1000):
        online = becalm.Online(model, lag)
        block = nanoseconds(partial(online.run, z), len(z))
        first = block if lag == 0 else first
        single = nanoseconds(partial(step_through, online, z[:STEPPED].tolist()), STEPPED)
        missing = nanoseconds(partial(online.run, holes), len(holes))
        lines.append(f"| {lag} | {block:.0f} | {block / first:.1f} | {missing:.0f} | {single:.0f} |")
    return "\n".join(lines)


def main() -> None:
    """Print the tables; with -o, write them as a page."""
    output = page_parser(__doc__).parse_args().output
    cases = run()
    text = "\n\n".join(
        [
            "## Errors\n\nOver that of the smoother; tuned as a filter / as a smoother.",
            error_table(cases),
            "## Delay and noise\n\nSigma of the settled filter over the noise of a reading, at each delay.",
            curve_table(cases),
            "## Time\n\nOf a reading, order 2.",
            time_table(),
        ]
    )
    publish("Fixed lag", __doc__, text + "\n", output)


if __name__ == "__main__":
    main()
