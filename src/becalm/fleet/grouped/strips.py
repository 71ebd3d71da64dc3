"""Rows of a file parted by sensor: each strip holds some of one, in the order of time, as Arrow's own messages."""

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
from becalm.files.atomic_file import replacing, sentences
from becalm.files.identity import Original
from becalm.files.parquet import read_parquet
from becalm.files.source import RawTable
from becalm.fleet.grouped.order import Ranks, is_mended, ranks_of, time_of
from becalm.fleet.marks import came_of
from becalm.fleet.names import named, values_in

RANK = "becalm.rank"
"""The last column of a strip: what orders its rows."""

BATCH_ROWS = 1 << 13
"""So many rows of each strip are in memory where strips are merged."""

_PACKED = pa.ipc.IpcWriteOptions(compression="lz4")


class Strip(NamedTuple):
    """Some rows of one sensor.

    Attributes
    ----------
    path : str
        The file that it is in.
    offset : int
        The byte that it begins with there.
    rows : int
        How many.
    first : int, float or None
        The rank of its first row; None where rows are to stay as they came.
    file : str
        The file of the lake that they were in.
    """

    path: str
    offset: int
    rows: int
    first: float | None
    file: str


class Lake(NamedTuple):
    """What every task knows of a lake.

    Attributes
    ----------
    root : str
        Its folder.
    keys : tuple of str
        What tells its sensors apart.
    wanted : mapping of str to str or None
        Sensors whose rows are wanted, and the columns of time that their recipes name.
    """

    root: str
    keys: tuple[str, ...]
    wanted: Mapping[str, str | None]


class StripPart(NamedTuple):
    """Some rows of a file of a lake, for one task.

    Attributes
    ----------
    file : str
        Its path within the lake.
    number, parts : int
        Which of how many equal shares of its row groups.
    strips : str
        The file to write.
    hashed : str
        What tells whether the file of the lake is still the same.
    """

    file: str
    number: int
    parts: int
    strips: str
    hashed: str


class Strips(NamedTuple):
    """What became of a part.

    Attributes
    ----------
    of : dict of str to list of Strip
        By sensor, in the order of the file.
    failed : str
        Why there are none, as a sentence.
    """

    of: dict[str, list[Strip]]
    failed: str = ""


Time = tuple[str, ...]
"""Columns that tell it."""


def part_rows(lake: Lake, part: StripPart) -> Strips:
    """Part the rows of a file by sensor; what is wrong with it is told, not raised.

    Parameters
    ----------
    lake : Lake
        What it is of.
    part : StripPart
        Which rows, and where to.
    """
    try:
        return Strips(_parted(lake, part))
    except BecalmError as cause:
        return Strips({}, str(cause))
    except Exception as cause:  # rubbish of a kind that nobody has thought of
        return Strips({}, f"{part.file}: {type(cause).__name__}: {cause}")


def not_parted(part: StripPart, why: str) -> Strips:
    """Tell of a file that the workers died of."""
    return Strips({}, f"{part.file} cannot be read. {why}")


def _parted(lake: Lake, part: StripPart) -> dict[str, list[Strip]]:
    path, target, found = Path(lake.root) / part.file, Path(part.strips), defaultdict[str, list[Strip]](list)
    table = read_parquet(path, Original(path))
    times = {asked: time_of(table, asked) for asked in set(lake.wanted.values())}
    if alike := {name for own in times.values() for name in own} & set(lake.keys):
        raise InputError(
            f"{min(alike)!r} tells the time of rows, and cannot tell sensors apart; name another with --by."
        )
    if RANK in table.names:
        raise InputError(f"{path} has a column {RANK!r}, which is used while rows are brought together; rename it.")
    with replacing(target) as file:
        for block in _share_of(path, table, part):
            rows_of = _rows_by_sensor(block, lake.keys, values_in(Path(part.file).parent))
            wanted = {name: times[lake.wanted[name]] for name in rows_of if name in lake.wanted}
            block = block.drop_columns([key for key in lake.keys if key in block.column_names])
            for name, rows, ranks in _in_order(block, wanted, rows_of):
                first = None if ranks is None else ranks[0].item()
                found[name].append(Strip(part.strips, file.tell(), len(rows), first, part.file))
                with sentences(target):
                    _write(file, block.take(rows), ranks)
    if came_of([(part.file, path)], "", {}) != part.hashed:
        raise InputError(f"{path} changed while it was read; wait until it is complete, and repeat.")
    return dict(found)


def _share_of(path: Path, table: RawTable, part: StripPart) -> Iterator[pa.Table]:
    """Read the row groups that are a part's, in blocks."""
    ends = _group_ends(path)
    first, stop = (ends[(len(ends) - 1) * share // part.parts] for share in (part.number, part.number + 1))
    for block in table.blocks(table.names, first):
        if first >= stop:
            return
        yield block.slice(0, stop - first).combine_chunks()
        first += block.num_rows


def _group_ends(path: Path) -> list[int]:
    import pyarrow.parquet as pq

    held = pq.read_metadata(path)
    return [*accumulate((held.row_group(number).num_rows for number in range(held.num_row_groups)), initial=0)]


def _rows_by_sensor(block: pa.Table, keys: Sequence[str], told: Mapping[str, str | None]) -> dict[str, Integers]:
    """Return the rows of each sensor, as they came."""
    names, codes = named(block, keys, told)
    order = np.argsort(codes.astype(np.min_scalar_type(len(names))), kind="stable")  # of small types in one pass
    ends = np.cumsum(np.bincount(codes, minlength=len(names)))
    return dict(zip(names, np.split(order, ends[:-1]), strict=True))


def _in_order(
    block: pa.Table, wanted: Mapping[str, Time], rows_of: Mapping[str, Integers]
) -> Iterator[tuple[str, Integers, Ranks | None]]:
    """Give the sensors that are wanted, with their rows in the order of time and what tells it."""
    ranks = {time: ranks_of(block.select(time)) if time else None for time in set(wanted.values())}
    for name, time in wanted.items():
        rows = rows_of[name]
        if (every := ranks[time]) is None:
            yield name, rows, None
            continue
        own = every[rows]
        if np.all(own[1:] >= own[:-1]):
            yield name, rows, own
        elif is_mended(own, block.schema.field(time[0]).type):
            yield name, rows, None
        else:
            order = np.argsort(own, kind="stable")
            yield name, rows[order], own[order]


def _write(file: IO[bytes], table: pa.Table, ranks: Ranks | None) -> None:
    table = table.append_column(RANK, pa.array(np.zeros(table.num_rows) if ranks is None else ranks))
    with pa.ipc.new_stream(file, table.schema, options=_PACKED) as out:
        out.write_table(table, BATCH_ROWS)
