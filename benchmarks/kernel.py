"""The filter in C, in nanoseconds a row, compared with SciPy's filters over the same rows in the same run.

A million evenly sampled readings of a walk of each order, one channel; and the same with one reading in a hundred
missing, so that the gain does not stay settled for long. *Filter* computes signal and sigma, without limits and
monitor; *channel* is all that a stream does; *smoother* runs forward and back; *likelihood* is the score that tuning
needs. `lfilter` and `sosfiltfilt` run a Butterworth filter of the same order, without sigma. Times are the shortest of
five runs of one thread; ratios are ratios of these times.

*Whole* is `becalm.clean` of such a record in memory with a recipe that becalm tuned on it: limits, outliers, filter,
verdict on every sample, and report. The recipe's kinematic model is damped, as in most recipes: it returns to a level,
so slowly that its gain changes over the whole record, and the covariance is computed in every row. *Undamped* is the
same recipe without damping. All times are processor times of all threads.

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


def measured_scipy(order: int, z: Floats) -> list[float]:
    """Return nanoseconds a row of SciPy's filters: forward, and forward and back."""
    b, a = butter(order, 2 * CUTOFF)
    sections = butter(order, 2 * CUTOFF, output="sos")
    jobs: list[Callable[[], object]] = [partial(lfilter, b, a, z), partial(sosfiltfilt, sections, z)]
    return [nanoseconds(job, ROWS) for job in jobs]


def whole(order: int, causal: bool) -> Iterator[str]:
    """Clean a recording in memory with its recipe, damped and undamped; yield a row for each."""
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
    """Measure whole channels, and return the table."""
    lines = ["## Whole channels", "", "| order | mode | motion | ns a row |", "|---|---|---|---|"]
    lines += [row for order in (1, 2) for causal in (True, False) for row in whole(order, causal)]
    return "\n".join([*lines, ""])


def table() -> str:
    """Measure the parts of the filter, and return the table."""
    lines = [
        "| order | readings | filter | `lfilter` | filter / `lfilter` | channel | smoother | `sosfiltfilt`"
        " | smoother / `sosfiltfilt` | likelihood |",
        "|---" * 10 + "|",
    ]
    rng = np.random.default_rng(1)
    for order in EVERY_ORDER:
        z = np.cumsum(0.1 * rng.normal(size=ROWS)) + rng.normal(size=ROWS)
        once, twice = measured_scipy(order, z)
        for what, share in (("all came", 0.0), ("1 in 100 missing", MISSING)):
            read = np.where(rng.random(ROWS) < share, np.nan, z)
            own, channel, smoother, likelihood = measured(order, read)
            figures = (own, once, own / once, channel, smoother, twice, smoother / twice, likelihood)
            lines.append(f"| {order} | {what} | " + " | ".join(f"{figure:.3g}" for figure in figures) + " |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Print the table; with -o, write it as a page."""
    output = page_parser(__doc__).parse_args().output
    publish("The filter in C", __doc__, table() + "\n" + whole_table(), output)


if __name__ == "__main__":
    main()
