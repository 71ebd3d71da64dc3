"""Damage records: missing, stuck or wrong readings, and motion that looks like damage."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from safe_signals import Floats, Record

Insult = Callable[[Record, np.random.Generator], Record]
"""Function that gets a record and a random generator, and returns the damaged record."""

SHOCK_ROWS = 20


def _starts(rows: int, length: int, count: int, rng: np.random.Generator) -> list[int]:
    """Return the first rows of `count` runs of a length; each run is at a random place in its part of the record."""
    part = rows // count
    free = max(part - length - 20, 1)
    return [k * part + 10 + int(rng.integers(free)) for k in range(count)]


def _without(record: Record, starts: list[int], length: int) -> Record:
    """Remove runs of readings."""
    readings, hidden = record.readings.copy(), record.hidden.copy()
    for start in starts:
        readings[start : start + length] = np.nan
        hidden[start : start + length] = True
    return record._replace(readings=readings, hidden=hidden, touched=record.touched | hidden)


def gaps(record: Record, rng: np.random.Generator, length: int, share: float = 0.03) -> Record:
    """Remove readings in runs of a length, a share of the record in all, but at least one run."""
    rows = len(record.truth)
    length = min(length, rows // 4)
    return _without(record, _starts(rows, length, max(int(share * rows / length), 1), rng), length)


def blank_ends(record: Record, rng: np.random.Generator) -> Record:
    """Remove the first and the last twelfth of the record."""
    del rng
    rows = len(record.truth)
    return _without(record, [0, rows - rows // 12], rows // 12)


def _wild(record: Record, rows: list[int], values: Floats) -> Record:
    """Replace the readings of some rows by wrong values."""
    readings, touched, hidden = record.readings.copy(), record.touched.copy(), record.hidden.copy()
    readings[rows], touched[rows], hidden[rows] = values, True, True
    return record._replace(readings=readings, touched=touched, hidden=hidden)


def spike(record: Record, rng: np.random.Generator, size: float) -> Record:
    """Put one spike into the middle third of the record; `size` is in standard deviations of the signal."""
    row = len(record.truth) // 3 + int(rng.integers(len(record.truth) // 3))
    return _wild(record, [row], record.truth[row] + size * rng.choice([-1.0, 1.0], 1))


def bit_flips(record: Record, rng: np.random.Generator) -> Record:
    """Add 2^k standard deviations of the signal, k from 0 to 20, to one reading in a hundred."""
    rows = np.flatnonzero(rng.uniform(size=len(record.truth)) < 0.01)
    values = record.sound[rows] + rng.choice([-1.0, 1.0], len(rows)) * 2.0 ** rng.integers(0, 21, len(rows))
    return _wild(record, rows.tolist(), values)


def wild_ends(record: Record, rng: np.random.Generator) -> Record:
    """Replace the first and the last reading by 65 535 standard deviations of the signal."""
    del rng
    return _wild(record, [0, len(record.truth) - 1], np.full(2, 65_535.0))


def zeros(record: Record, rng: np.random.Generator) -> Record:
    """Replace ten consecutive readings by zeros."""
    start = _starts(len(record.truth), 10, 1, rng)[0]
    return _wild(record, list(range(start, start + 10)), np.zeros(10))


def held(record: Record, rng: np.random.Generator, length: int = 40) -> Record:
    """Repeat the last reading in runs of a length, 3 % of the record in all."""
    rows = len(record.truth)
    length = min(length, rows // 10)
    starts = _starts(rows, length, max(int(0.03 * rows / length), 1), rng)
    readings, hidden = record.readings.copy(), record.hidden.copy()
    for start in starts:
        readings[start : start + length] = readings[start - 1]
        hidden[start : start + length] = True
    return record._replace(readings=readings, hidden=hidden, touched=record.touched | hidden)


def repeated(record: Record, rng: np.random.Generator, every: int) -> Record:
    """Log a slower sensor: each reading occurs `every` times."""
    del rng
    rows = np.arange(len(record.truth))
    stale = rows % every != 0
    readings = record.readings[rows - rows % every]
    return record._replace(readings=readings, hidden=record.hidden | stale, every=max(every, record.every))


def every_tenth(record: Record, rng: np.random.Generator) -> Record:
    """Remove all readings except every tenth."""
    del rng
    stale = np.arange(len(record.truth)) % 10 != 0
    readings = np.where(stale, np.nan, record.readings)
    return record._replace(readings=readings, hidden=record.hidden | stale, every=10)


def resolution(record: Record, rng: np.random.Generator, sigmas: float) -> Record:
    """Round readings to a converter's step, which is given in standard deviations of the noise."""
    del rng
    step = sigmas * record.noise_std
    return record._replace(readings=np.round(record.readings / step) * step, resolution=step)


def _moved(record: Record, motion: Floats, touched: slice) -> Record:
    """Add real motion to a record, in truth and readings."""
    flags = record.touched.copy()
    flags[touched] = True
    return record._replace(
        truth=record.truth + motion, sound=record.sound + motion, readings=record.readings + motion, touched=flags
    )


def shock(record: Record, rng: np.random.Generator, sigmas: float = 400.0) -> Record:
    """Add a shock: half a sine of 20 rows, with a height in standard deviations of the noise."""
    start = _starts(len(record.truth), SHOCK_ROWS, 1, rng)[0]
    motion = np.zeros(len(record.truth))
    half = np.sin(np.pi * (np.arange(SHOCK_ROWS) + 0.5) / SHOCK_ROWS)
    motion[start : start + SHOCK_ROWS] = sigmas * record.noise_std * half
    return _moved(record, motion, slice(start, start + SHOCK_ROWS))


def step(record: Record, rng: np.random.Generator, sigmas: float = 50.0) -> Record:
    """Add a step, with a height in standard deviations of the noise."""
    start = _starts(len(record.truth), 20, 1, rng)[0]
    motion = np.where(np.arange(len(record.truth)) < start, 0.0, sigmas * record.noise_std)
    return _moved(record, motion, slice(start, start + 5))


INSULTS: dict[str, Insult] = {
    **{f"gap {length}": partial(gaps, length=length) for length in (8, 40, 200, 2000)},
    "blank ends": blank_ends,
    **{f"spike 1e{k}": partial(spike, size=10.0**k) for k in (3, 6, 12)},
    "1 % spikes": bit_flips,
    "wild ends": wild_ends,
    "ten zeros": zeros,
    "held 40": held,
    **{f"each {every} times": partial(repeated, every=every) for every in (2, 4, 10)},
    "every tenth": every_tenth,
    **{f"resolution {sigmas}": partial(resolution, sigmas=sigmas) for sigmas in (1, 3, 10)},
    "shock": shock,
    "step": step,
}
"""All insults by name."""

ORDER: tuple[Callable[..., Record], ...]
ORDER = (shock, step, repeated, resolution, held, gaps, blank_ends, every_tenth, spike, bit_flips, zeros, wild_ends)
"""The order in which several insults are applied: motion first, then damage by the sensor, then by the link."""
