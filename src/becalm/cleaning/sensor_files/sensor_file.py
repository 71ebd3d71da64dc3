"""Read and write sensor files: TOML with one `[[sensor]]` table for each sensor."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import date
from pathlib import Path
from typing import Annotated, Self

import tomlkit
from pydantic import Field, model_validator

from becalm.cleaning.recipes.recipe import TomlKind
from becalm.cleaning.recipes.recipe_parts import FrozenSettings
from becalm.cleaning.sensor_files.sensor_entries import SensorEntry
from becalm.errors import SensorError
from becalm.sensors.record import SensorRecord

_KIND = TomlKind("sensor file", SensorError)
_ADVICE = "Each sensor starts with [[sensor]] and has kind, channel, raw_unit and unit."


class _Sensors(FrozenSettings):
    """The content of a sensor file."""

    sensor: Annotated[tuple[SensorEntry, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _channels_differ(self) -> Self:
        names = [name for sensor in self.sensor for name in sensor.names]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"the channel {twice[0]!r} has two sensors; give it one")
        return self


def load_sensors(path: str | Path) -> tuple[SensorRecord, ...]:
    """Read the sensor records of a sensor file, in the order of the file.

    Raises
    ------
    SensorError
        If the file cannot be read or is not TOML, or a value is missing, unknown or impossible.
    """
    text = _KIND.read_text(path, _ADVICE)
    return tuple(entry.record() for entry in _KIND.parse(_Sensors, text, f"The sensor file {path}", _ADVICE).sensor)


def to_toml(entries: Iterable[SensorEntry], comment: str = "") -> str:
    """Return the TOML text of a sensor file; it begins with `comment`, and leaves out default values."""
    document, sensors = tomlkit.document(), tomlkit.aot()
    for line in comment.splitlines():
        document.add(tomlkit.comment(line))
    for entry in entries:
        sensors.append(tomlkit.item({"kind": entry.kind, **entry.model_dump(exclude_defaults=True)}))
    document.add("sensor", sensors)
    return tomlkit.dumps(document)


def due_warnings(records: Iterable[SensorRecord], today: date) -> tuple[str, ...]:
    """Return a warning for each sensor whose calibration was due on `today` or before."""
    return tuple(
        f"The sensor of {', '.join(record.channels)}{_serial(record)} was due for calibration on {record.sheet.due}; "
        "its sensitivity and its uncertainty may no longer be valid."
        for record in records
        if record.sheet.is_due(today)
    )


def _serial(record: SensorRecord) -> str:
    return f" (serial {record.sheet.serial})" if record.sheet.serial else ""
