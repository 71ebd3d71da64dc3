"""The real recordings as channels: each file as becalm reads it, each of its rates a part of its own.

Needs `pip install 'becalm[formats]'`. Nothing is resampled, and no channel is left out: constant ones and clocks are
parts of what a logger wrote; so are flags (true and false), which `becalm clean` would let pass.
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
from becalm.files.opening import OpenSource, open_table
from becalm.files.read_options import ReadOptions
from becalm.files.roles import values_of
from becalm.files.source import CHANNEL, RawTable
from becalm.files.time_bases import open_file

DATA = Path(__file__).parents[2] / "shared" / "data"

COUNTED_HZ = {"imu_sample.csv": 204.8, "mocap_sample.csv": 100.0}
"""Rates of the tables that only count their rows."""

_NO_RECORDINGS = (".dbc", ".json", ".md", ".note")


class Part(NamedTuple):
    """Channels that share one time base.

    Attributes
    ----------
    title : str
        Which of the file's rates it is; "" where there is only one.
    names : tuple of str
        The channels.
    recording : becalm.Recording or None
        The channels, NaN where missing; None where their time cannot serve.
    refusal : str
        Why there is none.
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
    """Return what must be said of a file."""
    return ReadOptions(rate_hz=COUNTED_HZ.get(path.name))


def parts(path: Path) -> Iterator[Part]:
    """Read one file, a part for each of its rates."""
    with open_file(path, options(path)) as opened:
        for source in opened.sources:
            yield _part(source)
        for raw, why in opened.passed:
            yield _insisted(path, raw, why)


def _part(source: OpenSource) -> Part:
    """Take the channels, and flags as 0 and 1."""
    chosen = [one for one in source.columns if one.role == CHANNEL or one.name in _flags(source.schema)]
    timebase, table = source.recording().timebase, source.table()
    samples = np.column_stack([values_of(table.column(one.name), ".") for one in chosen])
    names, units = tuple(one.name for one in chosen), [one.unit for one in chosen]
    return Part(source.group, names, becalm.Recording(samples, names=names, units=units, timebase=timebase))


def _insisted(path: Path, raw: RawTable, why: str) -> Part:
    """Take the flags of a table that holds nothing else."""
    if flags := _flags(raw.rows.schema):
        with suppress(InputError):
            return _part(open_table(path, raw, ReadOptions(channels=flags)))
    names = tuple(name for name in raw.names if raw.time is None or name != raw.time.column)
    return Part(raw.group, names, None, why)


def _flags(schema: pa.Schema) -> tuple[str, ...]:
    return tuple(field.name for field in schema if pa.types.is_boolean(field.type))
