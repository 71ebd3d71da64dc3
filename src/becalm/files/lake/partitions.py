"""Find the sensor of a file by its partition folders, such as `sensor=17/date=2026-01-02`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from becalm.errors import InputError
from becalm.files.lake.listing import is_partition
from becalm.installation import typed

_TIME = re.compile(
    r"(?:.*_)?(?:year|yr|quarter|month|week|day|date|datetime|dt|ds|hour|hr|minute|second|time|timestamp|ts)", re.DOTALL
)
"""Keys of partitions by time: `date`, `event_date`, `eventDate`."""

_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")  # between the words of `eventDate`


def refuse_several(folder: Path, files: Iterable[Path]) -> None:
    """Refuse files of several sensors: their partitions differ in more than time.

    Parameters
    ----------
    folder : Path
        The folder of the files.
    files : iterable of Path
        The files, in any order.

    Raises
    ------
    InputError
        If there are several sensors; the message names two and says what to type.
    """
    sensors: dict[tuple[str, ...], Path] = {}
    for path in files:
        place = path.relative_to(folder).parent
        sensors.setdefault(sensor_of(place), place)
    if len(sensors) < 2:
        return
    names = ["/".join(sensor) or "files of none" for sensor in sensors]
    more = f" and {len(names) - 2:,} more" if len(names) > 2 else ""
    one = next(sensor for sensor in sensors if sensor)
    raise InputError(
        f"{folder} holds several sensors: {names[0]}, {names[1]}{more}; name one: becalm clean"
        f" {typed(str(folder / _path_up_to(one[-1], sensors[one])))} -o OUT.parquet, or all of them with: becalm fleet"
        f" clean {typed(str(folder))} -o OUT"
    )


def sensor_of(place: Path) -> tuple[str, ...]:
    """Return the parts of a path that identify the sensor of its files: its partitions except those by time."""
    return tuple(part for part in place.parts if is_partition(part) and not is_time_partition(part))


def is_time_partition(part: str) -> bool:
    """Return whether a partition is by time: `date=2026-01-02`, and not `sensor=17`."""
    return _TIME.fullmatch(_HUMP.sub("_", part.partition("=")[0]).lower()) is not None


def _path_up_to(last: str, place: Path) -> Path:
    return Path(*place.parts[: place.parts.index(last) + 1])
