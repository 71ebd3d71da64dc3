"""Which sensors a lake holds: by its folders, or a file each."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from shlex import quote
from typing import NamedTuple

from becalm.errors import InputError, UsageError
from becalm.files.identity import Original
from becalm.files.lake.listing import is_partition, parquet_files
from becalm.files.lake.partitions import sensor_of, tells_time
from becalm.files.parquet import read_parquet
from becalm.fleet.names import folder_name, keys_of, values_in

FOLDER, FILE = "folder", "file"
"""What tells a sensor, beside a column."""


_TOLD_BY = "Name the sensors' folders as sensor=17, or say that each file is one: --by file"


class SensorPlace(NamedTuple):
    """Where a sensor is in a lake."""

    name: str  # the path of its folder, or file, within the lake; "." for the lake itself
    bytes: int
    files: tuple[str, ...] = ()  # their paths within the lake, where they are not all that is in one place


class MultiSensorLake(NamedTuple):
    """A lake whose files hold several sensors each, or may do so."""

    keys: tuple[str, ...]  # columns, or keys of folders, that tell sensors apart
    files: tuple[str, ...]  # their paths within the lake, in order


def told_apart(lake: Path, by: str = FOLDER) -> list[SensorPlace] | MultiSensorLake:
    """Find what tells the sensors of a lake apart; where folders or files do, list them by name.

    Parameters
    ----------
    lake : Path
        A folder of Parquet files.
    by : str
        "folder" or "file", as in `places_in`; or a column, or a key of folders wherever it is in a path, or several of
        these with commas between.

    Raises
    ------
    InputError
        If it holds none, or cannot be read.
    UsageError
        If its folders do not tell sensors apart, or there is no such column.
    """
    if by in (FOLDER, FILE):
        return places_in(lake, by)
    paths = _files_in(lake)
    files = [path.relative_to(lake) for path in paths]
    told = [values_in(file.parent) for file in files]
    keys = _keys(by, told[0], paths[0])
    if not all(values.keys() >= set(keys) for values in told):
        return MultiSensorLake(keys, tuple(file.as_posix() for file in files))
    held = defaultdict[str, list[Path]](list)
    for file, values in zip(files, told, strict=True):
        held["/".join(folder_name(key, values[key]) for key in keys)].append(file)
    return [
        SensorPlace(name, sum(_bytes_of(lake / file) for file in own), tuple(file.as_posix() for file in own))
        for name, own in sorted(held.items())
    ]


def _keys(by: str, told: Mapping[str, str | None], path: Path) -> tuple[str, ...]:
    """Return what tells sensors apart; the columns of a file are looked at only where its folders do not tell."""
    if by in told or all(key.strip() in told for key in by.split(",")):
        return keys_of(by, told)
    return keys_of(by, {*told, *read_parquet(path, Original(path)).names})


def places_in(lake: Path, by: str = FOLDER) -> list[SensorPlace]:
    """List the sensors of a lake, by name.

    Parameters
    ----------
    lake : Path
        A folder of Parquet files.
    by : {"folder", "file"}
        What tells a sensor: the folder, above those that tell times, that its files are in; or each file.

    Raises
    ------
    InputError
        If it holds none, or cannot be read.
    UsageError
        If its folders do not tell sensors apart.
    """
    sizes: dict[str, int] = defaultdict(int)
    for path in _files_in(lake):
        below = path.relative_to(lake)
        sizes[str(below) if by == FILE else str(_sensor_folder(lake, below.parent))] += _bytes_of(path)
    _refuse_nested(lake, sizes)
    return [SensorPlace(name, size) for name, size in sorted(sizes.items())]


def _bytes_of(path: Path) -> int:
    """Return how long a file is, 0 of one that is not there any more: its sensor will be refused."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _files_in(lake: Path) -> tuple[Path, ...]:
    if not lake.is_dir():
        raise InputError(f"{lake} is no folder; give one that holds Parquet files, as sensor=17/date=2026-01-02/...")
    return parquet_files(lake).files


def _sensor_folder(lake: Path, folder: Path) -> Path:
    """Return a folder without the folders below that tell times."""
    parts = list(folder.parts)
    while parts and is_partition(parts[-1]) and tells_time(parts[-1]):
        parts.pop()
    if above := [part for part in parts if is_partition(part) and tells_time(part)]:
        keys = ",".join(values_in(Path(*sensor_of(Path(*parts)))))
        way = f"becalm fleet clean {quote(str(lake))} -o OUT --recipe R.toml --by {quote(keys)}" if keys else ""
        raise UsageError(
            f"{lake} has its sensors below times, as {above[0]}/.../{parts[-1]}, so that the rows of one are not"
            " together. " + (f"Say which key tells a sensor, and they are brought together: {way}" if way else _TOLD_BY)
        )
    return Path(*parts)


def _refuse_nested(lake: Path, sizes: dict[str, int]) -> None:
    """Refuse a sensor whose folder holds others: its rows and theirs would be taken for one recording."""
    for name in sizes:
        for above in Path(name).parents:
            if str(above) in sizes:
                raise UsageError(
                    f"{lake / above} has files beside folders of others, as {name}. If each file is a sensor of its"
                    " own, say --by file; else move them apart."
                )
