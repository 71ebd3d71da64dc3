"""Share of samples whose true value lies within one sigma, with and without the spread of the tuning.

Walks of order 1 to 3 with white noise of variance 1, cleaned by `becalm.clean` without options. 68.3 % is
right. "conditional" treats the tuning as exact, as `kalman_filter` with a Model does; "with spread" is sigma in
the output. No estimate from a short record is right for every walk: if the noise hides the motion of a walk at
q/r = 1e-4, the search ends at its slowest filter, whose sigma is too wide; the same sigma is too narrow for a faster
walk, as at q/r = 1e-2, that looks equally still by chance. Only the means over walks can be right.

The shares of smoothed walks of order 1 at q/r = 1 stay low, because cross-validation chooses too high an order, which
the spread of the ratio does not include.

The last column is the largest standard error of the shares in its row, estimated from the scatter between records.

Run: python benchmarks/honest_sigma.py [-o docs/honest-sigma.md]
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import becalm
from becalm.core.model.components import motion
from becalm.metrics.truth import coverage
from drawn import draw
from pages import page_parser, publish

ORDERS = (1, 2, 3)
RATIOS = (1e-4, 1e-2, 1.0)
RECORDS = {50: 30, 100: 24, 300: 12, 1000: 6, 10_000: 3}
SEED = 20260205


class Shares(NamedTuple):
    """The shares of samples within one sigma in records of one length."""

    conditional: float  # without the spread of the tuning
    spread: float  # with the spread
    widening: float  # mean factor of sigma
    error: float  # larger standard error of both shares


def shares(order: int, ratio: float, count: int, causal: bool) -> Shares:
    """Clean all records of one kind."""
    found = []
    for record in range(RECORDS[count]):
        rng = np.random.default_rng([SEED, order, RATIOS.index(ratio), count, record])
        truth, z = draw(motion(order, ratio).to_model(1.0, 1.0), count, rng)
        out = becalm.clean(becalm.Recording(z, rate_hz=1.0), causal=causal)
        widening = 1 + (out.reports[0].tuning_spread or 0.0)
        clean, sigma = out.signal.samples[:, 0], out.sigma.samples[:, 0]
        found.append((coverage(clean, sigma / widening, truth), coverage(clean, sigma, truth), widening))
    conditional, spread, widening = np.mean(found, axis=0)
    return Shares(conditional, spread, widening, float(np.std(found, axis=0)[:2].max() / np.sqrt(len(found))))


def table(causal: bool) -> str:
    """Run all cases in one mode."""
    heads = [f"{count} readings" for count in RECORDS]
    lines = [f"| order | q/r | {' | '.join(heads)} | error |", "|---" * (len(heads) + 3) + "|"]
    every: list[list[Shares]] = []
    for order in ORDERS:
        for ratio in RATIOS:
            row = [shares(order, ratio, count, causal) for count in RECORDS]
            cells = [f"{s.conditional:.1%} → **{s.spread:.1%}** (x {s.widening:.2f})" for s in row]
            lines.append(f"| {order} | {ratio:g} | {' | '.join(cells)} | {max(s.error for s in row):.1%} |")
            every.append(row)
    means = np.mean(np.array(every), axis=0)
    cells = [f"{mean[0]:.1%} → **{mean[1]:.1%}** (x {mean[2]:.2f})" for mean in means]
    return "\n".join([*lines, f"| mean | | {' | '.join(cells)} | |"]) + "\n"


def main() -> None:
    """Print the tables; with -o, write them as a page."""
    output = page_parser(__doc__).parse_args().output
    titles = {False: "Smoothed", True: "Causal"}
    text = "\n".join(
        f"## {title}: conditional → with spread (mean widening)\n\n{table(c)}" for c, title in titles.items()
    )
    publish("Honest sigma", __doc__, text, output)


if __name__ == "__main__":
    main()
