"""Split a file into strips. A strip has rows of one sensor in the order of time, stored as Arrow IPC messages."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Integers
from becalm.errors import BecalmError, InputError
from becalm.files.atomic_file import explain_write_errors, replacing
from becalm.files.decoding import Original
from becalm.files.parquet import read_parquet
from becalm.files.source import RawTable
from becalm.fleet.grouped.order import Ranks, has_clock_reset, ranks_of, time_of
from becalm.fleet.marks import hash_input
from becalm.fleet.names import name_sensors, values_in

RANK = "becalm.rank"
"""Name of the last column of a strip: the rank, by which its rows are sorted."""

BATCH_ROWS = 1 << 13
"""Rows of a message in a strip. During a merge, at most one message of each strip is in memory."""

_PACKED = pa.ipc.IpcWriteOptions(compression="lz4")


class Strip(NamedTuple):
    """A strip: some rows of one sensor, stored in a temporary file.

    Attributes
    ----------
    path : str
        The file that contains the strip.
    offset : int
        Position of the strip's first byte in that file.
    rows : int
        Number of rows.
    first : int, float or None
        The rank of the first row; None if the rows keep their original order.
    file : str
        The file of the lake that the rows were read from.
    """

    path: str
    offset: int
    rows: int
    first: float | None
    file: str


class Lake(NamedTuple):
    """The description of a lake that every task receives.

    Attributes
    ----------
    root : str
        The folder of the lake.
    keys : tuple of str
        Columns, or keys of folders, that identify sensors.
    wanted : mapping of str to str or None
        For each sensor whose rows are needed, the time column that its recipe names, or None.
    """

    root: str
    keys: tuple[str, ...]
    wanted: Mapping[str, str | None]


class StripPart(NamedTuple):
    """A part of a file of a lake, which one task splits.

    Attributes
    ----------
    file : str
        The file's path within the lake.
    number, parts : int
        Index of this part, and number of parts of the file; all parts have about the same number of row groups.
    strips : str
        Path of the file to write the strips to.
    hashed : str
        The hash of the file, to detect a change.
    """

    file: str
    number: int
    parts: int
    strips: str
    hashed: str


class Strips(NamedTuple):
    """The strips of one part of a file.

    Attributes
    ----------
    by_sensor : dict of str to list of Strip
        Strips by sensor, in the order of the file.
    failed : str
        A sentence on why the file cannot be split; empty if it was split.
    """

    by_sensor: dict[str, list[Strip]]
    failed: str = ""


Time = tuple[str, ...]
"""Names of the time columns: one column, or a column of dates and one of times of day."""


def split_rows(lake: Lake, part: StripPart) -> Strips:
    """Split a part of a file by sensor; an error is returned as `failed`, not raised.

    Parameters
    ----------
    lake : Lake
        The lake of the file.
    part : StripPart
        The part of a file to split.
    """
    try:
        return Strips(_split(lake, part))
    except BecalmError as cause:
        return Strips({}, str(cause))
    except Exception as cause:  # file damage that no check detects
        return Strips({}, f"{part.file}: {type(cause).__name__}: {cause}")


def report_lost_part(part: StripPart, why: str) -> Strips:
    """Return the strips of a part on which every worker died: none, and the reason."""
    return Strips({}, f"{part.file} cannot be read. {why}")


def _split(lake: Lake, part: StripPart) -> dict[str, list[Strip]]:
    path, target, strips = Path(lake.root) / part.file, Path(part.strips), defaultdict[str, list[Strip]](list)
    table = read_parquet(path, Original(path))
    times = {asked: time_of(table, asked) for asked in set(lake.wanted.values())}
    if alike := {name for own in times.values() for name in own} & set(lake.keys):
        raise InputError(
            f"{min(alike)!r} is the time of the rows and cannot identify sensors; name another column with --by."
        )
    if RANK in table.names:
        raise InputError(f"{path} has a column {RANK!r}, a name that becalm needs for merging; rename that column.")
    with replacing(target) as file:
        for block in _share_of(path, table, part):
            rows_of = _rows_by_sensor(block, lake.keys, values_in(Path(part.file).parent))
            wanted = {name: times[lake.wanted[name]] for name in rows_of if name in lake.wanted}
            block = block.drop_columns([key for key in lake.keys if key in block.column_names])
            for name, rows, ranks in _in_order(block, wanted, rows_of):
                first = None if ranks is None else ranks[0].item()
                strips[name].append(Strip(part.strips, file.tell(), len(rows), first, part.file))
                with explain_write_errors(target):
                    _write(file, block.take(rows), ranks)
    if hash_input([(part.file, path)], "", {}) != part.hashed:
        raise InputError(f"{path} changed while it was read; wait until it is complete, and repeat.")
    return dict(strips)


def _share_of(path: Path, table: RawTable, part: StripPart) -> Iterator[pa.Table]:
    """Yield the rows of a part of a file, block by block."""
    ends = _group_ends(path)
    first, stop = (ends[(len(ends) - 1) * share // part.parts] for share in (part.number, part.number + 1))
    for block in table.blocks(table.names, first):
        if first >= stop:
            return
        yield block.slice(0, stop - first).combine_chunks()
        first += block.num_rows


def _group_ends(path: Path) -> list[int]:
    import pyarrow.parquet as pq

    footer = pq.read_metadata(path)
    return [*accumulate((footer.row_group(number).num_rows for number in range(footer.num_row_groups)), initial=0)]


def _rows_by_sensor(block: pa.Table, keys: Sequence[str], folders: Mapping[str, str | None]) -> dict[str, Integers]:
    """Return, by sensor, the indices of its rows in a block, in increasing order."""
    names, codes = name_sensors(block, keys, folders)
    order = np.argsort(codes.astype(np.min_scalar_type(len(names))), kind="stable")  # small integers sort faster
    ends = np.cumsum(np.bincount(codes, minlength=len(names)))
    return dict(zip(names, np.split(order, ends[:-1]), strict=True))


def _in_order(
    block: pa.Table, wanted: Mapping[str, Time], rows_of: Mapping[str, Integers]
) -> Iterator[tuple[str, Integers, Ranks | None]]:
    """Yield each wanted sensor, its row indices sorted by time, and their ranks; None if the rows keep their order."""
    ranks = {time: ranks_of(block.select(time)) if time else None for time in set(wanted.values())}
    for name, time in wanted.items():
        rows = rows_of[name]
        if (every := ranks[time]) is None:
            yield name, rows, None
            continue
        own = every[rows]
        if np.all(own[1:] >= own[:-1]):
            yield name, rows, own
        elif has_clock_reset(own, block.schema.field(time[0]).type):
            yield name, rows, None
        else:
            order = np.argsort(own, kind="stable")
            yield name, rows[order], own[order]


def _write(file: IO[bytes], table: pa.Table, ranks: Ranks | None) -> None:
    table = table.append_column(RANK, pa.array(np.zeros(table.num_rows) if ranks is None else ranks))
    with pa.ipc.new_stream(file, table.schema, options=_PACKED) as out:
        out.write_table(table, BATCH_ROWS)
