"""rms error of `becalm clean` without options, relative to the best classic filter that is tuned with the truth.

Seven signals at 100 Hz, 10 000 samples, white noise of 5 % and 30 % of the signal's standard
deviation. The causal classic filters are Butterworth of orders 1, 2 and 4, and the moving average; the smoothing
ones are Butterworth of orders 1, 2 and 4 forward and back, and Savitzky-Golay of degrees 2 to 5. Each has the
cut-off with the least rms error, *computed with the truth*; becalm gets only the readings.

Run: python benchmarks/accuracy.py [-o docs/accuracy.md]
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import becalm
from becalm.classic.matching import best_of
from becalm.classic.register import USUAL
from becalm.cleaning.channels.report import ChannelReport
from becalm.metrics.truth import coverage, rms_error
from pages import page_parser, publish

Floats = NDArray[np.float64]

RATE_HZ = 100.0
COUNT = 10_000
NOISES = (0.05, 0.30)
SEED = 20260101


def ramp_and_hold(t: Floats) -> Floats:
    """Return a ramp up, a constant, a ramp down and a constant, as in the strain paper."""
    return np.asarray(np.interp(t, [0, 20, 40, 60, 80, 100], [0, 0, 1, 1, 0, 0]))


def steps(t: Floats) -> Floats:
    """Return ten levels of ten seconds each."""
    levels = np.array([0.0, 1.0, -0.5, 0.8, 0.2, 1.5, -1.0, 0.4, 0.9, -0.2])
    return np.asarray(levels[np.minimum((t / 10).astype(int), 9)])


def sine(t: Floats) -> Floats:
    """Return a sine of 1 Hz."""
    return np.asarray(np.sin(2 * np.pi * t))


def three_sines(t: Floats) -> Floats:
    """Return the sum of sines of 0.3, 1.1 and 2.7 Hz."""
    return np.sin(2 * np.pi * 0.3 * t) + 0.6 * np.sin(2 * np.pi * 1.1 * t + 1) + 0.3 * np.sin(2 * np.pi * 2.7 * t + 2)


def chirp(t: Floats) -> Floats:
    """Return a sine whose frequency rises exponentially from 0.05 to 5 Hz."""
    low, growth = 0.05, np.log(100) / t[-1]
    return np.asarray(np.sin(2 * np.pi * low * np.expm1(growth * t) / growth))


def band_limited(t: Floats) -> Floats:
    """Return Gaussian noise below 2 Hz."""
    spectrum = np.fft.rfft(np.random.default_rng(7).normal(size=len(t)))
    spectrum[np.fft.rfftfreq(len(t), t[1] - t[0]) > 2.0] = 0
    return np.fft.irfft(spectrum, len(t)) * 5


def braking(t: Floats) -> Floats:
    """Return the acceleration of a car in m/s^2 that drives, brakes hard, pitches and stands, five times."""
    phase = t % 20
    brake = np.interp(phase, [0, 5, 5.4, 8.5, 8.7, 20], [0.3, 0.3, -7, -7, 0, 0])
    since = np.maximum(phase - 8.7, 0)
    return brake + np.where(phase > 8.7, 1.5 * np.exp(-since / 0.8) * np.sin(2 * np.pi * 1.5 * since), 0)


SIGNALS: dict[str, Callable[[Floats], Floats]] = {
    "ramp and hold": ramp_and_hold,
    "steps": steps,
    "sine 1 Hz": sine,
    "three sines": three_sines,
    "chirp 0.05-5 Hz": chirp,
    "band-limited noise": band_limited,
    "braking": braking,
}


def table(causal: bool) -> list[dict[str, object]]:
    """Run all cases in one mode."""
    t = np.arange(COUNT) / RATE_HZ
    rows: list[dict[str, object]] = []
    for index, (name, signal) in enumerate(SIGNALS.items()):
        for noise in NOISES:
            truth = signal(t)
            rng = np.random.default_rng([SEED, index, int(100 * noise)])
            z = truth + noise * truth.std() * rng.normal(size=COUNT)
            out = becalm.clean(becalm.Recording(z, rate_hz=RATE_HZ), causal=causal)
            clean, sigma = out.signal.samples[:, 0], out.sigma.samples[:, 0]
            rival = best_of(USUAL[causal], z, truth)
            error = rms_error(clean, truth)
            rows.append(
                {
                    "signal": name,
                    "noise": noise,
                    "raw": rms_error(z, truth),
                    "classic": rival.error,
                    "rival": f"{rival.classic.name}, {rival.cutoff * RATE_HZ:.3g} Hz",
                    "becalm": error,
                    "ratio": error / rival.error,
                    "model": _model(out.reports[0]),
                    "covered": coverage(clean, sigma, truth),
                }
            )
    return rows


def _model(report: ChannelReport) -> str:
    """Return the order of the kinematic model, and the number of tones."""
    tones = len(report.tones_hz)
    return f"{report.order}" + (f", {tones} tone{'s' if tones > 1 else ''}" if tones else "")


def as_markdown(rows: list[dict[str, object]]) -> str:
    """Return the table, with the geometric mean and the worst case below."""
    lines = [
        "| signal | noise | raw | best classic (knows the truth) | its error | becalm | model | ratio | in 1 sigma |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['signal']} | {row['noise']:.0%} | {row['raw']:.4g} | {row['rival']} | {row['classic']:.4g} |"
        f" {row['becalm']:.4g} | {row['model']} | **{row['ratio']:.3f}** | {row['covered']:.0%} |"
        for row in rows
    ]
    ratios = np.array([row["ratio"] for row in rows], dtype=float)
    lines.append("")
    lines.append(f"Geometric mean of the ratios: **{_mean(ratios):.3f}**; worst: **{ratios.max():.3f}**.")
    return "\n".join(lines) + "\n"


def _mean(ratios: Floats) -> float:
    """Return the geometric mean."""
    return float(np.exp(np.log(ratios).mean()))


def main() -> None:
    """Print the table; with -o, write it as a page."""
    output = page_parser(__doc__).parse_args().output
    titles = {False: "Smoothed", True: "Causal"}
    text = "\n".join(f"## {title}\n\n{as_markdown(table(causal))}" for causal, title in titles.items())
    publish("Accuracy", __doc__, text, output)


if __name__ == "__main__":
    main()
