"""The filter in C, in nanoseconds a row, beside SciPy's filters over the same rows in the same run.

A million readings of a walk of each order, one channel, in even time; and the same with one reading in a hundred
missing, where the gain is never settled for long. *Filter* is what reads them all and tells signal and sigma, without
limits and monitor; *channel* is all that a stream does; *smoother* goes there and back; *likelihood* is what tuning
asks for. `lfilter` and `sosfiltfilt` run a Butterworth filter of the same order, and tell no sigma. The shortest of
five runs, of one thread; ratios are of these.

*Whole* is `becalm.clean` of such a record in memory by a recipe that becalm tuned on it: limits, outliers, filter,
verdict on every sample, and what the report says. The recipe's motion is damped, as most are: it returns to a level of
its own, so slowly that its gain goes on changing over the whole record, and every row takes its covariance along.
*Undamped* is the same recipe without damping. All are times of the processor, of all threads.

Run: python benchmarks/kernel.py [-o docs/kernel.md]
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, sosfiltfilt

from becalm.cleaning.pipeline import clean
from becalm.cleaning.tuning import tune
from becalm.core.filter.channel import Channel, ChannelRecord
from becalm.core.filter.channel_settings import ChannelSettings
from becalm.core.model.components import EVERY_ORDER, motion
from becalm.core.recording import Recording
from pages import page_parser, publish
from stopwatch import nanoseconds

Floats = NDArray[np.float64]

ROWS, MISSING, CUTOFF = 1_000_000, 0.01, 0.02  # cut-off in cycles a row


def measured(order: int, z: Floats) -> list[float]:
    """Return nanoseconds a row: filter, channel, smoother, likelihood."""
    component, even = motion(order, (2 * np.pi * CUTOFF) ** (2 * order)), np.ones(ROWS)
    record = ChannelRecord(component, 1.0, z, even)
    stream = partial(Channel(ChannelSettings(component, 1.0)).process, z, even)
    jobs: list[Callable[[], object]] = [record.filtered, stream, record.smoothed, partial(record.score, 3)]
    return [nanoseconds(job, ROWS) for job in jobs]


def beside(order: int, z: Floats) -> list[float]:
    """Return nanoseconds a row of SciPy's filters: once, and there and back."""
    b, a = butter(order, 2 * CUTOFF)
    sections = butter(order, 2 * CUTOFF, output="sos")
    jobs: list[Callable[[], object]] = [partial(lfilter, b, a, z), partial(sosfiltfilt, sections, z)]
    return [nanoseconds(job, ROWS) for job in jobs]


def whole(order: int, causal: bool) -> Iterator[str]:
    """Clean a recording in memory by its recipe, damped and undamped; write a row of each."""
    rng = np.random.default_rng(2)
    z = 0.05 * rng.normal(size=ROWS)
    for _ in range(order):
        z = np.cumsum(z)
    recording = Recording(z + rng.normal(size=ROWS), rate_hz=1000.0)
    recipe = tune(recording, causal=causal)
    (channel,) = recipe.channel
    if channel.order != order or channel.damped_below_hz is None:
        raise SystemExit(f"The recipe has order {channel.order}; a damped motion of order {order} is to be timed.")
    undamped = recipe.model_copy(update={"channel": (channel.model_copy(update={"damped_below_hz": None}),)})
    for name, one in (("damped", recipe), ("undamped", undamped)):
        took = nanoseconds(partial(clean, recording, one), ROWS)
        yield f"| {order} | {'causal' if causal else 'smoothed'} | {name} | {took:.3g} |"


def whole_table() -> str:
    """Measure whole channels, and write the rows."""
    lines = ["## Whole channels", "", "| order | mode | motion | ns a row |", "|---|---|---|---|"]
    lines += [row for order in (1, 2) for causal in (True, False) for row in whole(order, causal)]
    return "\n".join([*lines, ""])


def table() -> str:
    """Measure, and write the rows."""
    lines = [
        "| order | readings | filter | `lfilter` | filter / `lfilter` | channel | smoother | `sosfiltfilt`"
        " | smoother / `sosfiltfilt` | likelihood |",
        "|---" * 10 + "|",
    ]
    rng = np.random.default_rng(1)
    for order in EVERY_ORDER:
        z = np.cumsum(0.1 * rng.normal(size=ROWS)) + rng.normal(size=ROWS)
        once, twice = beside(order, z)
        for what, share in (("all came", 0.0), ("1 in 100 missing", MISSING)):
            read = np.where(rng.random(ROWS) < share, np.nan, z)
            alone, channel, smoother, likelihood = measured(order, read)
            figures = (alone, once, alone / once, channel, smoother, twice, smoother / twice, likelihood)
            lines.append(f"| {order} | {what} | " + " | ".join(f"{figure:.3g}" for figure in figures) + " |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Print the table; with -o, write it as a page."""
    output = page_parser(__doc__).parse_args().output
    publish("The filter in C", __doc__, table() + "\n" + whole_table(), output)


if __name__ == "__main__":
    main()
