"""Spikes and steps in simulated and in real records: what a gate must do, and what it does.

False alarms are counted over 10^8 readings, a random walk in Gaussian noise, and compared with the 99 % interval of a
Poisson distribution. rms errors are those of `becalm.clean` without options with 1 % of spikes of 8 sigma, relative to
the errors on the same record without spikes: the median of 8 seeds, and the largest in brackets. A robust filter
(`--robust`) gets 10 % of spikes; its error is given relative to that of `becalm.clean` without options and spikes, and
relative to its own error without spikes. For real recordings the share of readings that are rejected as spikes is
given.

Run: python benchmarks/faults.py [--readings 1e8] [--recordings FOLDER] [-o docs/faults.md]
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import poisson

from becalm.cleaning.pipeline import Cleaned, clean
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.filter.gate import Gate, threshold_for
from becalm.core.filter.restarting_flow import CausalFlow
from becalm.core.model.components import motion
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording
from becalm.metrics.truth import rms_error
from pages import page_parser, publish

Floats = NDArray[np.float64]
Row = tuple[str, str, str]

RATE_HZ, ROWS, SEEDS, STARTING = 500.0, 20_000, 8, 500
SPIKES, SIZE = 0.01, 8.0
MANY, STEP = 0.1, 50.0
BLOCK = 1 << 20
RECORDINGS = ("comma2k19/accelerometer.csv", "comma2k19/gyroscope.csv", "comma2k19/can_speed.csv")


def smooth_motion(order: int, cutoff: float = 0.01) -> CausalFlow:
    """Return a causal filter with a cut-off in cycles per step, and a gate with one false alarm per hour at 500 Hz."""
    part = motion(order, (2 * np.pi * cutoff) ** (2 * order))
    return CausalFlow(part, 1.0, Gate(threshold_for(1.0, RATE_HZ)))


def false_alarms(rate_hz: float, readings: float) -> Row:
    """Count the good readings that a gate rejects."""
    part = motion(1, (2 * np.pi * 0.01) ** 2)
    flow = CausalFlow(part, 1.0, Gate(threshold_for(1.0, rate_hz)))
    rng, count, level, blocks = np.random.default_rng(int(rate_hz)), 0, 0.0, round(readings / BLOCK)
    for _ in range(blocks):
        walk = level + np.cumsum(2 * np.pi * 0.01 * rng.normal(size=BLOCK))
        level = float(walk[-1])
        estimates = flow.push(walk + rng.normal(size=BLOCK), np.ones(BLOCK))
        count += sum(int(np.count_nonzero(part.verdicts)) for part in estimates)
    expected = blocks * BLOCK / rate_hz / 3600
    low, high = poisson.interval(0.99, expected)
    what = f"false alarms at {rate_hz:g} Hz in {expected:.1f} h"
    return what, f"{low:.0f} to {high:.0f}", f"{count}"


def truths(seed: int) -> dict[str, Floats]:
    """Return the true signals by name."""
    t = np.arange(ROWS) / RATE_HZ
    walk = np.cumsum(0.03 * np.random.default_rng(seed + 100).normal(size=ROWS))
    return {"random walk": walk, "slow sine": 5 * np.sin(np.pi * t), "constant": np.full(ROWS, 3.0)}


def error_of(out: Cleaned, truth: Floats) -> float:
    """Return the rms error without the first second."""
    return rms_error(out.signal.samples[STARTING:, 0], truth[STARTING:])


def spiky(name: str, causal: bool) -> Row:
    """Compare rms errors with and without spikes."""
    errors = []
    for seed in range(SEEDS):
        rng, truth = np.random.default_rng(seed), truths(seed)[name]
        noise = rng.normal(size=ROWS)
        bad = np.where(rng.random(ROWS) < SPIKES, SIZE * rng.choice([-1.0, 1.0], ROWS), 0.0)
        pair = (Recording(truth + noise + extra, rate_hz=RATE_HZ) for extra in (0.0, bad))
        errors.append([error_of(clean(record, causal=causal), truth) for record in pair])
    ratios = [spiked / without for without, spiked in errors]
    how = "causal" if causal else "smoothed"
    return (
        f"rms error with spikes over that without, {name}, {how}",
        "up to 1.1",
        f"{np.median(ratios):.3f} ({max(ratios):.3f})",
    )


def spiked(seed: int, share: float) -> Floats:
    """Return spikes in a share of the rows, and zeros in the others."""
    rng = np.random.default_rng(seed + 200)
    return np.where(rng.random(ROWS) < share, SIZE * rng.choice([-1.0, 1.0], ROWS), 0.0)


def robustly(z: Floats, causal: bool) -> Cleaned:
    """Clean a record with a robust filter."""
    record = Recording(z, rate_hz=RATE_HZ)
    return clean(record, tune(record, causal=causal, wishes=Wishes(robust=True)))


def robust(name: str, causal: bool) -> Row:
    """Compare rms errors with many spikes and without any."""
    ratios = []
    for seed in range(SEEDS):
        truth = truths(seed)[name]
        z = truth + np.random.default_rng(seed).normal(size=ROWS)
        own = error_of(robustly(z + spiked(seed, MANY), causal), truth)
        without = clean(Recording(z, rate_hz=RATE_HZ), causal=causal), robustly(z, causal)
        ratios.append([own / error_of(out, truth) for out in without])
    middle, most = np.median(ratios, axis=0), np.max(ratios, axis=0)
    got = " and ".join(f"{one:.3f} ({other:.3f})" for one, other in zip(middle, most, strict=True))
    how = "causal" if causal else "smoothed"
    return f"robust, rms error with 10 % of spikes over that without, {name}, {how}", "up to 1.5", got


def robust_step(name: str) -> Row:
    """Count the readings until a robust filter has followed a step of 50 sigma to within 3 sigma, among many spikes."""
    late = []
    for seed in range(SEEDS):
        truth = truths(seed)[name] + np.where(np.arange(ROWS) >= ROWS // 2, STEP, 0.0)
        z = truth + np.random.default_rng(seed).normal(size=ROWS) + spiked(seed, MANY)
        off = np.abs(robustly(z, True).signal.samples[ROWS // 2 :, 0] - truth[ROWS // 2 :])
        late.append(int(np.flatnonzero(off > 3.0).max(initial=-1)) + 2)
    what = f"robust, readings until a step of 50 sigma among 10 % of spikes is followed, {name}"
    return what, "15", f"{np.median(late):g} ({max(late)})"


def stepping(order: int) -> Row:
    """Count the readings until a filter jumps after a step of 50 sigma."""
    z = np.random.default_rng(order).normal(size=4096)
    z[2000:] += 50.0
    verdicts = np.concatenate([part.verdicts for part in smooth_motion(order).push(z, np.ones(len(z)))])
    steps = np.flatnonzero(verdicts == Verdict.STEP)
    got = ", ".join(str(step - 2000 + 1) for step in steps) or "never"
    return f"readings until a step of 50 sigma is followed, order {order}", "4", got


def burst(order: int) -> Row:
    """Count the longest run of rejected readings in a burst of random readings."""
    rng = np.random.default_rng(order)
    z = rng.normal(size=4096)
    z[1000:1500] = rng.uniform(-300, 300, 500)
    verdicts = np.concatenate([part.verdicts for part in smooth_motion(order).push(z, np.ones(len(z)))])
    bounds = np.flatnonzero(np.concatenate([[True], verdicts != Verdict.SPIKE, [True]]))
    return f"longest run left out in a burst, order {order}", "up to 3", f"{np.diff(bounds).max() - 1}"


def real(folder: Path) -> Iterator[Row]:
    """Yield rows with the share of readings in real recordings that is rejected as spikes."""
    for name in RECORDINGS:
        if not (folder / name).exists():
            continue
        table = np.loadtxt(folder / name, delimiter=",", skiprows=1)
        for causal in (True, False):
            out = clean(Recording(table[:, 1:], times_s=table[:, 0]), causal=causal)
            shares = [f"{np.mean(verdicts == Verdict.SPIKE):.3%}" for verdicts in out.verdicts.values()]
            yield f"rejected of {name}, {'causal' if causal else 'smoothed'}", "next to nothing", ", ".join(shares)


def main() -> None:
    """Print the table."""
    parser = page_parser(__doc__)
    parser.add_argument("--readings", type=float, default=1e8, help="readings for the false alarms")
    parser.add_argument("--recordings", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    arguments = parser.parse_args()
    rows = [false_alarms(rate_hz, arguments.readings) for rate_hz in (500.0, 10_000.0)]
    rows += [spiky(name, causal) for name in truths(0) for causal in (True, False)]
    rows += [robust(name, causal) for name in truths(0) for causal in (True, False)]
    rows += [robust_step(name) for name in truths(0)]
    rows += [make(order) for make in (stepping, burst) for order in (1, 2, 3)]
    rows += real(arguments.recordings)
    lines = ["| what | asked | got |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in rows)]
    publish("Spikes and steps", __doc__, "\n".join(lines) + "\n", arguments.output)


if __name__ == "__main__":
    main()
