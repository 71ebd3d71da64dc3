"""What the folders of a table tell: `sensor=17/date=2026-01-02`; one recording is of one sensor."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from shlex import quote

from becalm.errors import InputError
from becalm.files.lake.listing import is_partition

_TIME = re.compile(
    r"(?:.*_)?(?:year|yr|quarter|month|week|day|date|datetime|dt|ds|hour|hr|minute|second|time|timestamp|ts)", re.DOTALL
)
"""Keys that tell when rows were: `date`, `event_date`, `eventDate`."""

_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")


def refuse_several(folder: Path, files: Iterable[Path]) -> None:
    """Refuse files of several sensors: of partitions that differ in more than time.

    Parameters
    ----------
    folder : Path
        That they are in.
    files : iterable of Path
        In any order.

    Raises
    ------
    InputError
        If there are several; two are named, and what to type.
    """
    sensors: dict[tuple[str, ...], Path] = {}
    for path in files:
        place = path.relative_to(folder).parent
        sensors.setdefault(sensor_of(place), place)
    if len(sensors) < 2:
        return
    told = ["/".join(sensor) or "files of none" for sensor in sensors]
    more = f" and {len(told) - 2:,} more" if len(told) > 2 else ""
    one = next(sensor for sensor in sensors if sensor)
    raise InputError(
        f"{folder} holds several: {told[0]}, {told[1]}{more}; name one: becalm clean"
        f" {quote(str(folder / _up_to(one[-1], sensors[one])))} -o OUT.parquet, or all of them with: becalm fleet clean"
        f" {quote(str(folder))} -o OUT"
    )


def sensor_of(place: Path) -> tuple[str, ...]:
    """Return the parts of a path that tell of which sensor the files in it are: partitions by all but time."""
    return tuple(part for part in place.parts if is_partition(part) and not tells_time(part))


def tells_time(part: str) -> bool:
    """Tell whether a partition is by time: `date=2026-01-02`, and not `sensor=17`."""
    return _TIME.fullmatch(_HUMP.sub("_", part.partition("=")[0]).lower()) is not None


def _up_to(last: str, place: Path) -> Path:
    return Path(*place.parts[: place.parts.index(last) + 1])
