"""A filter with modes, quiet at rest and fast in motion, compared with the fixed gain of the IMU paper.

White noise with the variances of the paper's table 1 at 10 kHz: 30 s of rest, then a step; the steps have the same
size in standard deviations for both sensors. becalm identifies the modes in each record and filters it causally.
Rest noise is the rms error over the last 15 s before the step; t90 is the time from the step until the output first
exceeds nine tenths of it. The tables show medians over 20 seeds, also for a random walk with the paper's ratio Q/R.

Run: python benchmarks/switching.py [-o docs/switching.md] [--figure docs/switching.svg] [--seeds 20]
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

import becalm
from becalm.core.model.components import motion
from becalm.identification.wishes.noise_against_lag import trade_off_curve
from becalm.report.data.description import Axis, Curve, Figure, Layer, Look
from becalm.report.printing import Kind, printed, refuse_unprintable
from pages import page_parser, publish

Floats = NDArray[np.float64]

RATE_HZ = 10_000.0
REST, SETTLED, AFTER = 300_000, 150_000, 20_000  # rows


class Sensor(NamedTuple):
    """A sensor of table 1, the paper's optimum for it, and the required rest noise."""

    variance: float  # unit^2
    ratio: float  # Q/R of table 2, for a covariance of T^2 Q in each step
    rest_noise: float  # unit


ACCELEROMETER = Sensor(1.8472e-4, 22.95, 6e-5)
SCALE = float(np.sqrt(1.3872e-6 / ACCELEROMETER.variance))
SENSORS = {"accelerometer": ACCELEROMETER, "gyroscope": Sensor(1.3872e-6, 1027.5, SCALE * ACCELEROMETER.rest_noise)}
LOOKS: tuple[Look, ...] = ("line", "dashed", "dotted")
STEPS = {0.2: 0.2, 0.05: 0.2, 0.02: 2.0, 0.005: 15.0}  # of the accelerometer: size, and the required t90 in ms


class Found(NamedTuple):
    """The results of one filter on one record."""

    rest_noise: float
    t90_ms: float


def record(sensor: Sensor, size: float, seed: int) -> Floats:
    """Return noise with a step of `size` after 30 s."""
    rng = np.random.default_rng([seed, round(1e6 * size)])
    z = rng.normal(0.0, np.sqrt(sensor.variance), REST + AFTER)
    z[REST:] += size
    return z


def measured(signal: Floats, size: float) -> Found:
    """Measure rest noise and t90 in a filter's output for a record with a step."""
    reached = np.flatnonzero(signal[REST:] > 0.9 * size)
    rest = float(np.sqrt(np.mean(signal[SETTLED:REST] ** 2)))
    return Found(rest, 1e3 * reached[0] / RATE_HZ if len(reached) else np.inf)


def switching(z: Floats) -> Floats:
    """Clean a record causally, without options."""
    return becalm.clean(becalm.Recording(z, rate_hz=RATE_HZ), causal=True).signal.samples[:, 0]


def fixed(sensor: Sensor, z: Floats) -> Floats:
    """Filter a record with the paper's ratio Q/R."""
    walk = motion(1, sensor.ratio * sensor.variance / RATE_HZ)
    return becalm.kalman_filter(walk.to_model(1 / RATE_HZ, sensor.variance), z).signal[:, 0]


class Measured(NamedTuple):
    """Medians over all records of one sensor."""

    rest_noise: float
    paper_rest_noise: float
    t90_ms: dict[float, float]  # by step, in the accelerometer's unit
    paper_t90_ms: dict[float, float]


def measure(sensor: Sensor, seeds: int) -> Measured:
    """Run all records of one sensor."""
    scale = np.sqrt(sensor.variance / ACCELEROMETER.variance)
    own, paper = dict[float, list[Found]](), dict[float, list[Found]]()
    for size in STEPS:
        records = [record(sensor, size * scale, seed) for seed in range(seeds)]
        own[size] = [measured(switching(z), size * scale) for z in records]
        paper[size] = [measured(fixed(sensor, z), size * scale) for z in records]
    return Measured(_rest(own), _rest(paper), _times(own), _times(paper))


def _rest(found: dict[float, list[Found]]) -> float:
    return float(np.median([one.rest_noise for each in found.values() for one in each]))


def _times(found: dict[float, list[Found]]) -> dict[float, float]:
    return {size: float(np.median([one.t90_ms for one in each])) for size, each in found.items()}


def table(sensor: Sensor, got: Measured) -> str:
    """Return the table of one sensor, with a row for each step."""
    scale = np.sqrt(sensor.variance / ACCELEROMETER.variance)
    lines = ["| step | in std | t90 asked | got | paper's optimum |", "|---|---|---|---|---|"]
    lines += [
        f"| {size * scale:.3g} | {size / np.sqrt(ACCELEROMETER.variance):.2f} | <= {asked_ms:g} ms |"
        f" **{got.t90_ms[size]:.2f} ms** | {got.paper_t90_ms[size]:.0f} ms |"
        for size, asked_ms in STEPS.items()
    ]
    lines.append("")
    lines.append(
        f"Rest noise: asked <= {sensor.rest_noise:.2g}, got **{got.rest_noise:.2g}**; the paper's optimum leaves"
        f" {got.paper_rest_noise:.2g}, a reading has {np.sqrt(sensor.variance):.2g}."
    )
    return "\n".join(lines) + "\n"


def figure(got: dict[str, Measured]) -> Figure:
    """Return the figure: the trade-off curve of fixed gains, the paper's optima, and the filter with modes."""
    layers, std = list[Layer](), float(np.sqrt(ACCELEROMETER.variance))
    curve = trade_off_curve(ACCELEROMETER.variance, 1 / RATE_HZ).points
    for order, look in zip((1, 2, 3), LOOKS, strict=True):
        points = np.array([(1e3 * one.step_90_s, one.noise_std / std) for one in curve if one.order == order])
        layers.append(Curve(f"fixed gain, order {order}", points[:, 0], points[:, 1], "other", look))
    for name, found in got.items():
        std = float(np.sqrt(SENSORS[name].variance))
        times_ms = np.maximum(list(found.t90_ms.values()), 1e3 / RATE_HZ)
        noises = np.full(len(times_ms), found.rest_noise / std)
        paper = np.array([found.paper_t90_ms[0.2]]), np.array([found.paper_rest_noise / std])
        layers.append(Curve(f"switching, {name}", times_ms, noises, "clean", "points"))
        layers.append(Curve(f"paper, {name}", *paper, "other", "points"))
    x = Axis("time to nine tenths of a step (ms)", log=True, low=5e-2, high=3e3)
    title = (
        f"Steps of {', '.join(f'{size / np.sqrt(ACCELEROMETER.variance):.3g}' for size in STEPS)} standard deviations"
    )
    return Figure("switching", title, x, Axis("noise at rest / noise read", log=True), tuple(layers))


def main() -> None:
    """Print the tables; with -o, write them as a page; with --figure, draw them (needs matplotlib)."""
    parser = page_parser(__doc__)
    parser.add_argument("--figure", type=Path, help="picture to draw: SVG, PNG or PDF")
    parser.add_argument("--seeds", type=int, default=20, help="records of each step")
    arguments = parser.parse_args()
    if arguments.figure:
        refuse_unprintable()
        if arguments.figure.suffix[1:] not in get_args(Kind):
            parser.error(f"--figure {arguments.figure} ends in none of {', '.join(get_args(Kind))}")
    got = {name: measure(sensor, arguments.seeds) for name, sensor in SENSORS.items()}
    text = "\n".join(f"## {name.capitalize()}\n\n{table(SENSORS[name], one)}" for name, one in got.items())
    if arguments.figure:
        arguments.figure.write_bytes(printed([figure(got)], arguments.figure.suffix[1:]))
        text += f"\n![Noise at rest over the time to nine tenths of a step]({arguments.figure.name})\n"
    publish("Switching", __doc__, text, arguments.output)


if __name__ == "__main__":
    main()
