"""Hold the outcome of one sensor: its rows in the fleet's report, whether it was refused, and how long it took."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from becalm.report.fleet_rows import FleetRow, State

SHOWN = 12
"""Number of hexadecimal digits of a recipe's hash in reports."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of one sensor.

    Attributes
    ----------
    sensor : str
        Its path within the lake.
    state : {"cleaned", "kept", "refused"}
        "kept": it was finished before, and its input has not changed since.
    channels : tuple of FleetRow
        A row of the report for each channel; one row with the reason if the sensor was refused.
    took_s : float
        The time it took in all tasks together, in seconds.
    seams : str
        How the stretches fit together, if the sensor was cleaned in stretches of time.
    """

    sensor: str
    state: State
    channels: tuple[FleetRow, ...]
    took_s: float = 0.0
    seams: str = ""

    @property
    def reason(self) -> str:
        """Return why the sensor was refused, as a sentence."""
        return self.channels[0].reason if self.state == "refused" else ""

    @property
    def describes(self) -> bool:
        """Return whether the sensor was not refused, and no channel has the verdict "does not fit"."""
        return self.state != "refused" and all(row.verdict != "does not fit" for row in self.channels)

    @property
    def rows(self) -> int:
        """Return the number of rows of the sensor."""
        return max(row.rows for row in self.channels)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Outcome:
        """Return the outcome from the values that `as_dict` returned.

        Raises
        ------
        ValueError
            If a value is missing, or is not one of an outcome.
        """
        try:
            return cls(**{**data, "channels": tuple(FleetRow(**row) for row in data["channels"])})
        except (TypeError, KeyError) as cause:
            names = ", ".join(field.name for field in fields(cls))
            raise ValueError(f"{str(data)[:80]!r} is not an outcome of a sensor, which has {names}") from cause


def noted(rows: Sequence[FleetRow], notes: Sequence[str]) -> tuple[FleetRow, ...]:
    """Return the report's rows with `notes`, on their sensor's files and clock, appended to what each says."""
    return tuple(replace(row, says=" ".join((row.says, *notes)).strip()) for row in rows)


def refused(sensor: str, reason: str, took_s: float = 0.0) -> Outcome:
    """Return the outcome of a sensor that could not be cleaned."""
    return Outcome(sensor, "refused", (FleetRow(sensor, state="refused", reason=reason),), took_s)
