"""Read the real recordings with becalm; each sampling rate of a file gives one part.

Needs `pip install 'becalm[formats]'`. Nothing is resampled, and no channel is left out: the parts include constant
channels, clocks, and flags (true and false), which `becalm clean` would pass through.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

import becalm
from becalm.errors import InputError
from becalm.files.inputs.opening import OpenSource, open_table
from becalm.files.inputs.time_bases import open_file
from becalm.files.read_options import ReadOptions
from becalm.files.roles import values_of
from becalm.files.source import CHANNEL, RawTable

DATA = Path(__file__).parents[2] / "shared" / "data"

COUNTED_HZ = {"imu_sample.csv": 204.8, "mocap_sample.csv": 100.0}
"""Sampling rates of the tables that have row numbers instead of times."""

_NO_RECORDINGS = (".dbc", ".json", ".md", ".note")


class Part(NamedTuple):
    """Channels that share one time base.

    Attributes
    ----------
    title : str
        Name of the time base in the file; "" if the file has only one.
    names : tuple of str
        Names of the channels.
    recording : becalm.Recording or None
        The channels, with NaN for missing samples; None if becalm refuses the part.
    refusal : str
        Reason of the refusal.
    """

    title: str
    names: tuple[str, ...]
    recording: becalm.Recording | None
    refusal: str = ""


def files() -> list[Path]:
    """List the recordings."""
    return sorted(
        path for path in DATA.glob("*/*") if path.suffix not in _NO_RECORDINGS and not path.name.startswith("LICENSE")
    )


def options(path: Path) -> ReadOptions:
    """Return the options that a file needs."""
    return ReadOptions(rate_hz=COUNTED_HZ.get(path.name))


def parts(path: Path) -> Iterator[Part]:
    """Read one file, and yield a part for each of its sampling rates."""
    with open_file(path, options(path)) as opened:
        for source in opened.sources:
            yield _part(source)
        for raw, why in opened.passed_through:
            yield _part_of_flags(path, raw, why)


def _part(source: OpenSource) -> Part:
    """Return the channels as a part, with flags as 0 and 1."""
    chosen = [one for one in source.columns if one.role == CHANNEL or one.name in _flags(source.schema)]
    timebase, table = source.recording().timebase, source.table()
    samples = np.column_stack([values_of(table.column(one.name), ".") for one in chosen])
    names, units = tuple(one.name for one in chosen), [one.unit for one in chosen]
    return Part(source.group, names, becalm.Recording(samples, names=names, units=units, timebase=timebase))


def _part_of_flags(path: Path, raw: RawTable, why: str) -> Part:
    """Return the flags of a table that has no other channels, or a refused part."""
    if flags := _flags(raw.rows.schema):
        with suppress(InputError):
            return _part(open_table(path, raw, ReadOptions(channels=flags)))
    names = tuple(name for name in raw.names if raw.time is None or name != raw.time.column)
    return Part(raw.group, names, None, why)


def _flags(schema: pa.Schema) -> tuple[str, ...]:
    return tuple(field.name for field in schema if pa.types.is_boolean(field.type))
