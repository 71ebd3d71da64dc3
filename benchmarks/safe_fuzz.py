"""Clean random records with random insults; no error may exceed the range of the readings around it."""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np

from safe_bounds import LIMITS, largest_error
from safe_insults import ORDER, Insult, bit_flips, gaps, held, repeated, resolution, shock, spike, step
from safe_paths import by_file
from safe_signals import SIGNALS, Record, undamaged

SHORTEST, LONGEST = 300, 5000


class Found(NamedTuple):
    """The result for one random record.

    Attributes
    ----------
    seed : int
        Seed of the record.
    what : str
        Signal, length, noise and insults of the record.
    estimate : str
        "smoothed" or "causal".
    error : float
        Largest error, relative to the range of the readings around it; inf for an exception.
    says : str
        Message of the exception, or "".
    """

    seed: int
    what: str
    estimate: str
    error: float
    says: str


def drawn(seed: int) -> tuple[Record, str]:
    """Return a random damaged record, and its description."""
    rng = np.random.default_rng([20261102, seed])
    names = [name for name in SIGNALS if not name.startswith("real")]
    name, rows = str(rng.choice(names)), int(np.exp(rng.uniform(np.log(SHORTEST), np.log(LONGEST))))
    noise = float(np.exp(rng.uniform(np.log(0.005), np.log(0.5))))
    record = undamaged(SIGNALS[name], rng, rows, noise)
    if record is None:
        raise ValueError(f"There is no signal {name!r}.")
    what = [name, f"{rows} rows", f"noise {noise:.1%}"]
    picked = set(rng.choice(len(ORDER), int(rng.integers(1, 4)), replace=False).tolist())
    for k in sorted(picked):
        insult, name = _varied(ORDER[k], rng)
        record = insult(record, rng)
        what.append(name)
    return record, ", ".join(what)


def _varied(insult: Callable[..., Record], rng: np.random.Generator) -> tuple[Insult, str]:
    """Return an insult of a random size, and its name."""
    size = float(np.exp(rng.uniform()))
    length = int(10 ** rng.uniform(0, 3))
    varied: dict[Callable[..., Record], tuple[Insult, str]] = {
        gaps: (partial(gaps, length=length, share=0.1 * rng.uniform()), f"gaps of {length}"),
        spike: (partial(spike, size=10 ** (5 * size - 4)), f"a spike of {10 ** (5 * size - 4):.2g}"),
        held: (partial(held, length=length // 4 + 2), f"held {length // 4 + 2}"),
        repeated: (partial(repeated, every=2 + length % 9), f"each {2 + length % 9} times"),
        resolution: (partial(resolution, sigmas=4 * size), f"resolution {4 * size:.2g} sigma"),
        shock: (partial(shock, sigmas=150 * size), f"a shock of {150 * size:.3g} sigma"),
        step: (partial(step, sigmas=20 * size), f"a step of {20 * size:.3g} sigma"),
        bit_flips: (bit_flips, "1 % spikes"),
    }
    return varied.get(insult, (insult, getattr(insult, "__name__", "insult").replace("_", " ")))


def found(seed: int) -> list[Found]:
    """Clean one random record, smoothed and causal."""
    record, what = drawn(seed)
    results = []
    for estimate in ("smoothed", "causal"):
        try:
            error, says = largest_error(by_file(record.readings, estimate).signal, record), ""
        except Exception as failure:
            error, says = np.inf, traceback.format_exception_only(failure)[-1].strip()[:200]
        results.append(Found(seed, what, estimate, error, says))
    return results


def fuzz_page(seeds: Sequence[int], jobs: int) -> str:
    """Return the page on random records, the worst first.

    Parameters
    ----------
    seeds : sequence of int
        Seeds of the records.
    jobs : int
        Number of processes.
    """
    with get_context("spawn").Pool(jobs) as pool:
        every = [one for results in pool.imap_unordered(found, seeds, 4) for one in results]
    limit = LIMITS["largest error"]
    beyond = sorted((one for one in every if not one.error <= limit), key=lambda one: (-one.error, one.seed))
    worst = max(one.error for one in every)
    counts = Counter(
        part.split(" of ")[0].rstrip(" 0123456789.e+") for one in beyond for part in one.what.split(", ")[3:]
    )
    lines = [
        f"{len(every)} estimates of {len(seeds)} records, seeds {seeds[0]} to {seeds[-1]}: {len(beyond)} are beyond"
        f" {limit:g}, the worst at {worst:.3g}; {sum(bool(one.says) for one in beyond)} raised an exception.",
        "",
        f"Insults in them: {', '.join(f'{name} {count}' for name, count in counts.most_common()) or 'none'}.",
        "",
    ]
    lines += [
        f"- seed {one.seed}: {one.error:.3g}, {one.estimate}: {one.what}{'. ' if one.says else ''}{one.says}"
        for one in beyond or (every if len(seeds) == 1 else [])
    ]
    return "\n".join(lines) + "\n"
