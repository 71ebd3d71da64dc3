"""List the sensors of a lake, which its folders, its files or its columns identify."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from becalm.errors import InputError, UsageError
from becalm.files.decoding import Original
from becalm.files.lake.listing import is_partition, parquet_files
from becalm.files.lake.partitions import is_time_partition, sensor_of
from becalm.files.parquet import read_parquet
from becalm.fleet.names import folder_name, keys_of, values_in
from becalm.installation import typed

FOLDER, FILE = "folder", "file"
"""What identifies a sensor, if no column does: a folder, or each file."""


_BY_HINT = "Name the sensors' folders like sensor=17, or use --by file if each file is a sensor."


class SensorPlace(NamedTuple):
    """The place of a sensor in a lake."""

    name: str  # the path of its folder, or file, within the lake; "." for the lake itself
    bytes: int  # total size of its files
    files: tuple[str, ...] = ()  # paths of its files within the lake; empty if these are all files of one folder


class MultiSensorLake(NamedTuple):
    """A lake whose files may each hold several sensors."""

    keys: tuple[str, ...]  # columns, or keys of folders, that identify sensors
    files: tuple[str, ...]  # paths of all files within the lake, in order


def find_sensor_layout(lake: Path, by: str = FOLDER) -> list[SensorPlace] | MultiSensorLake:
    """List the sensors of a lake, if folders or files identify them; else return its files and keys.

    Parameters
    ----------
    lake : Path
        A folder of Parquet files.
    by : str
        "folder" or "file", as in `places_in`; or a column, or the key of a folder at any level such as `sensor` in
        `sensor=17`; or several columns and keys separated by commas.

    Returns
    -------
    list of SensorPlace or MultiSensorLake
        The sensors, sorted by name; a `MultiSensorLake` if a file's path does not contain all keys.

    Raises
    ------
    InputError
        If the lake holds no sensors, or cannot be read.
    UsageError
        If the folders do not identify sensors, or `by` names a column twice or a column that does not exist.
    """
    if by in (FOLDER, FILE):
        return places_in(lake, by)
    paths = _files_in(lake)
    files = [path.relative_to(lake) for path in paths]
    folder_values = [values_in(file.parent) for file in files]
    keys = _keys(by, folder_values[0], paths[0])
    if not all(values.keys() >= set(keys) for values in folder_values):
        return MultiSensorLake(keys, tuple(file.as_posix() for file in files))
    held = defaultdict[str, list[Path]](list)
    for file, values in zip(files, folder_values, strict=True):
        held["/".join(folder_name(key, values[key]) for key in keys)].append(file)
    return [
        SensorPlace(name, sum(_bytes_of(lake / file) for file in own), tuple(file.as_posix() for file in own))
        for name, own in sorted(held.items())
    ]


def _keys(by: str, from_folders: Mapping[str, str | None], path: Path) -> tuple[str, ...]:
    """Return the keys that identify sensors; read the file's columns only if its folders do not have all keys."""
    if by in from_folders or all(key.strip() in from_folders for key in by.split(",")):
        return keys_of(by, from_folders)
    return keys_of(by, {*from_folders, *read_parquet(path, Original(path)).names})


def places_in(lake: Path, by: str = FOLDER) -> list[SensorPlace]:
    """List the sensors of a lake, by name.

    Parameters
    ----------
    lake : Path
        A folder of Parquet files.
    by : {"folder", "file"}
        What identifies a sensor: a folder, without the last folders of its path if these name times; or each file.

    Raises
    ------
    InputError
        If the lake holds no sensors, or cannot be read.
    UsageError
        If the folders do not identify sensors.
    """
    sizes: dict[str, int] = defaultdict(int)
    for path in _files_in(lake):
        below = path.relative_to(lake)
        sizes[(below if by == FILE else _sensor_folder(lake, below.parent)).as_posix()] += _bytes_of(path)
    _refuse_nested(lake, sizes)
    return [SensorPlace(name, size) for name, size in sorted(sizes.items())]


def _bytes_of(path: Path) -> int:
    """Return the size of a file in bytes, or 0 if the file has vanished; its sensor is refused later."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _files_in(lake: Path) -> tuple[Path, ...]:
    if not lake.is_dir():
        raise InputError(
            f"{lake} is not a folder; give one that holds Parquet files, such as sensor=17/date=2026-01-02/..."
        )
    return parquet_files(lake).files


def _sensor_folder(lake: Path, folder: Path) -> Path:
    """Return a path without its last folders that name times; raise UsageError if a folder above a sensor names one."""
    parts = list(folder.parts)
    while parts and is_partition(parts[-1]) and is_time_partition(parts[-1]):
        parts.pop()
    if above := [part for part in parts if is_partition(part) and is_time_partition(part)]:
        keys = ",".join(values_in(Path(*sensor_of(Path(*parts)))))
        way = f"becalm fleet clean {typed(str(lake))} -o OUT --recipe R.toml --by {typed(keys)}" if keys else ""
        raise UsageError(
            f"{lake} has folders of times above its sensors, as in {above[0]}/.../{parts[-1]}, so that the rows of a"
            " sensor are scattered. "
            + (f"Name the key that identifies a sensor, and becalm gathers its rows: {way}" if way else _BY_HINT)
        )
    return Path(*parts)


def _refuse_nested(lake: Path, sizes: dict[str, int]) -> None:
    """Raise an error if a sensor's folder contains other sensors: their rows would be read as one recording."""
    for name in sizes:
        for above in PurePosixPath(name).parents:
            if str(above) in sizes:
                raise UsageError(
                    f"{lake / above} has both files and folders with files, such as {name}. If each file is a sensor of"
                    " its own, use --by file; otherwise move them to separate folders."
                )
