"""What happens to records: readings that are missing, stuck or wild, and motion that looks like it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from safe_signals import Floats, Record

Insult = Callable[[Record, np.random.Generator], Record]
"""Takes a record and a generator, and returns the record with the damage."""

SHOCK_ROWS = 20


def _starts(rows: int, length: int, count: int, rng: np.random.Generator) -> list[int]:
    """Return the first rows of so many runs of a length, each at random in a part of the record of its own."""
    part = rows // count
    free = max(part - length - 20, 1)
    return [k * part + 10 + int(rng.integers(free)) for k in range(count)]


def _without(record: Record, starts: list[int], length: int) -> Record:
    """Empty runs of readings."""
    readings, hidden = record.readings.copy(), record.hidden.copy()
    for start in starts:
        readings[start : start + length] = np.nan
        hidden[start : start + length] = True
    return record._replace(readings=readings, hidden=hidden, touched=record.touched | hidden)


def gaps(record: Record, rng: np.random.Generator, length: int, share: float = 0.03) -> Record:
    """Leave readings out, in runs of a length; runs share 3 % of the record, or there is one run."""
    rows = len(record.truth)
    length = min(length, rows // 4)
    return _without(record, _starts(rows, length, max(int(share * rows / length), 1), rng), length)


def blank_ends(record: Record, rng: np.random.Generator) -> Record:
    """Leave out the first and the last twelfth of the record."""
    del rng
    rows = len(record.truth)
    return _without(record, [0, rows - rows // 12], rows // 12)


def _wild(record: Record, rows: list[int], values: Floats) -> Record:
    """Put wild readings into rows."""
    readings, touched, hidden = record.readings.copy(), record.touched.copy(), record.hidden.copy()
    readings[rows], touched[rows], hidden[rows] = values, True, True
    return record._replace(readings=readings, touched=touched, hidden=hidden)


def spike(record: Record, rng: np.random.Generator, size: float) -> Record:
    """Put one wild reading into the middle third, so many spreads of the signal away."""
    row = len(record.truth) // 3 + int(rng.integers(len(record.truth) // 3))
    return _wild(record, [row], record.truth[row] + size * rng.choice([-1.0, 1.0], 1))


def bit_flips(record: Record, rng: np.random.Generator) -> Record:
    """Put 2^k spreads of the signal, k of 0 to 20, on one reading of a hundred."""
    rows = np.flatnonzero(rng.uniform(size=len(record.truth)) < 0.01)
    values = record.sound[rows] + rng.choice([-1.0, 1.0], len(rows)) * 2.0 ** rng.integers(0, 21, len(rows))
    return _wild(record, rows.tolist(), values)


def wild_ends(record: Record, rng: np.random.Generator) -> Record:
    """Put 65 535 spreads of the signal into the first and the last reading."""
    del rng
    return _wild(record, [0, len(record.truth) - 1], np.full(2, 65_535.0))


def zeros(record: Record, rng: np.random.Generator) -> Record:
    """Put ten zeros in a row into the record, in one place."""
    start = _starts(len(record.truth), 10, 1, rng)[0]
    return _wild(record, list(range(start, start + 10)), np.zeros(10))


def held(record: Record, rng: np.random.Generator, length: int = 40) -> Record:
    """Repeat the last reading so many times, in runs that share 3 % of the record."""
    rows = len(record.truth)
    length = min(length, rows // 10)
    starts = _starts(rows, length, max(int(0.03 * rows / length), 1), rng)
    readings, hidden = record.readings.copy(), record.hidden.copy()
    for start in starts:
        readings[start : start + length] = readings[start - 1]
        hidden[start : start + length] = True
    return record._replace(readings=readings, hidden=hidden, touched=record.touched | hidden)


def repeated(record: Record, rng: np.random.Generator, every: int) -> Record:
    """Log a slower sensor: each reading comes so many times."""
    del rng
    rows = np.arange(len(record.truth))
    stale = rows % every != 0
    readings = record.readings[rows - rows % every]
    return record._replace(readings=readings, hidden=record.hidden | stale, every=max(every, record.every))


def every_tenth(record: Record, rng: np.random.Generator) -> Record:
    """Leave out all readings but one of ten."""
    del rng
    stale = np.arange(len(record.truth)) % 10 != 0
    readings = np.where(stale, np.nan, record.readings)
    return record._replace(readings=readings, hidden=record.hidden | stale, every=10)


def resolution(record: Record, rng: np.random.Generator, sigmas: float) -> Record:
    """Round readings to a converter's step, so many standard deviations of the noise."""
    del rng
    step = sigmas * record.noise_std
    return record._replace(readings=np.round(record.readings / step) * step, resolution=step)


def _moved(record: Record, motion: Floats, touched: slice) -> Record:
    """Add motion, which the sensor sees, to a record."""
    flags = record.touched.copy()
    flags[touched] = True
    return record._replace(
        truth=record.truth + motion, sound=record.sound + motion, readings=record.readings + motion, touched=flags
    )


def shock(record: Record, rng: np.random.Generator, sigmas: float = 400.0) -> Record:
    """Add a shock: half a sine of 20 rows, so many standard deviations of the noise high."""
    start = _starts(len(record.truth), SHOCK_ROWS, 1, rng)[0]
    motion = np.zeros(len(record.truth))
    half = np.sin(np.pi * (np.arange(SHOCK_ROWS) + 0.5) / SHOCK_ROWS)
    motion[start : start + SHOCK_ROWS] = sigmas * record.noise_std * half
    return _moved(record, motion, slice(start, start + SHOCK_ROWS))


def step(record: Record, rng: np.random.Generator, sigmas: float = 50.0) -> Record:
    """Add a step, so many standard deviations of the noise high."""
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
"""All insults by their name."""

ORDER: tuple[Callable[..., Record], ...]
ORDER = (shock, step, repeated, resolution, held, gaps, blank_ends, every_tenth, spike, bit_flips, zeros, wild_ends)
"""The order in which insults that come together befall a record: motion, the sensor, the link."""
