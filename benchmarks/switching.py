"""Still when it is still, quick when it moves: a filter that switches against the fixed gain of the IMU paper.

White noise with the variances of the paper's table 1 at 10 kHz: 30 s of rest, then a step; the steps are of the same
size in standard deviations for both sensors. becalm finds the modes in each record by itself and filters it causally.
Rest noise is the rms error over the last 15 s before the step; t90 is the time from the step until the output first
passes nine tenths of it. Medians over 20 seeds; beside them the same for a random walk of the paper's ratio, Q/R.

Run: python benchmarks/switching.py [-o docs/switching.md] [--seeds 20]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import becalm
from becalm.core.components import motion
from pages import publish

Floats = NDArray[np.float64]

RATE_HZ = 10_000.0
REST, SETTLED, AFTER = 300_000, 150_000, 20_000  # rows


class Sensor(NamedTuple):
    """A sensor of table 1 and the paper's optimum for it, with what is asked of its rest noise."""

    variance: float  # unit^2
    ratio: float  # Q/R of table 2, of a covariance T^2 Q a step
    rest_noise: float  # unit


ACCELEROMETER = Sensor(1.8472e-4, 22.95, 6e-5)
SCALE = float(np.sqrt(1.3872e-6 / ACCELEROMETER.variance))
SENSORS = {"accelerometer": ACCELEROMETER, "gyroscope": Sensor(1.3872e-6, 1027.5, SCALE * ACCELEROMETER.rest_noise)}
STEPS = {0.2: 0.2, 0.05: 0.2, 0.02: 2.0, 0.005: 15.0}  # of the accelerometer: size, and the ms asked


class Found(NamedTuple):
    """What one record shows of one filter."""

    rest_noise: float
    t90_ms: float


def record(sensor: Sensor, size: float, seed: int) -> Floats:
    """Return noise with a step of `size` after 30 s."""
    rng = np.random.default_rng([seed, round(1e6 * size)])
    z = rng.normal(0.0, np.sqrt(sensor.variance), REST + AFTER)
    z[REST:] += size
    return z


def measured(signal: Floats, size: float) -> Found:
    """Measure a filter's output over such a record."""
    reached = np.flatnonzero(signal[REST:] > 0.9 * size)
    rest = float(np.sqrt(np.mean(signal[SETTLED:REST] ** 2)))
    return Found(rest, 1e3 * reached[0] / RATE_HZ if len(reached) else np.inf)


def switching(z: Floats) -> Floats:
    """Clean a record, causally, nothing chosen."""
    return becalm.clean(becalm.Recording(z, rate_hz=RATE_HZ), causal=True).signal.samples[:, 0]


def fixed(sensor: Sensor, z: Floats) -> Floats:
    """Filter a record with the paper's ratio."""
    walk = motion(1, sensor.ratio * sensor.variance / RATE_HZ)
    return becalm.kalman_filter(walk.to_model(1 / RATE_HZ, sensor.variance), z).signal[:, 0]


def table(name: str, seeds: int) -> str:
    """Run one sensor; one row a step."""
    sensor, rests = SENSORS[name], list[float]()
    scale = np.sqrt(sensor.variance / ACCELEROMETER.variance)
    lines = ["| step | in std | t90 asked | got | paper's optimum |", "|---|---|---|---|---|"]
    for size, asked_ms in STEPS.items():
        own, paper = list[Found](), list[Found]()
        for seed in range(seeds):
            z = record(sensor, size * scale, seed)
            own.append(measured(switching(z), size * scale))
            paper.append(measured(fixed(sensor, z), size * scale))
        rests += [found.rest_noise for found in own]
        t90 = [float(np.median([found.t90_ms for found in each])) for each in (own, paper)]
        std = size / np.sqrt(ACCELEROMETER.variance)
        lines.append(f"| {size * scale:.3g} | {std:.2f} | <= {asked_ms:g} ms | **{t90[0]:.2f} ms** | {t90[1]:.0f} ms |")
    noise = float(np.median([found.rest_noise for found in paper]))
    lines.append("")
    lines.append(
        f"Rest noise: asked <= {sensor.rest_noise:.2g}, got **{np.median(rests):.2g}**; the paper's optimum leaves"
        f" {noise:.2g}, a reading has {np.sqrt(sensor.variance):.2g}."
    )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the tables; with -o, write them as a page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, help="page to write to")
    parser.add_argument("--seeds", type=int, default=20)
    asked = parser.parse_args()
    text = "\n".join(f"## {name.capitalize()}\n\n{table(name, asked.seeds)}" for name in SENSORS)
    publish("Switching", __doc__, text, asked.output)


if __name__ == "__main__":
    main()
