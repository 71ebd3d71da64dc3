"""Define the outcome of one sensor: its rows in the fleet's report, its state, and the time it took."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from becalm.report.fleet.fleet_rows import FleetRow, State

SHOWN = 12
"""Number of hexadecimal digits of a recipe's hash in reports."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of one sensor.

    Attributes
    ----------
    sensor : str
        The sensor's path within the lake.
    state : {"cleaned", "kept", "refused"}
        "kept": an earlier job finished the sensor, and its input has not changed since. "refused": it was not cleaned.
    channels : tuple of FleetRow
        A row of the report for each channel; one row with the reason if the sensor was refused.
    took_s : float
        The total time of its tasks, in seconds.
    seams : str
        A sentence on how well its stretches join; empty if it was not cut in time.
    """

    sensor: str
    state: State
    channels: tuple[FleetRow, ...]
    took_s: float = 0.0
    seams: str = ""

    @property
    def reason(self) -> str:
        """Return a sentence on why the sensor was refused; empty if it was not."""
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
        """Return the outcome as plain values for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Outcome:
        """Return the outcome from the values that `as_dict` returned.

        Raises
        ------
        ValueError
            If a value is missing or unknown.
        """
        try:
            return cls(**{**data, "channels": tuple(FleetRow(**row) for row in data["channels"])})
        except (TypeError, KeyError) as cause:
            names = ", ".join(field.name for field in fields(cls))
            raise ValueError(f"{str(data)[:80]!r} is not an outcome of a sensor, which has {names}") from cause


def noted(rows: Sequence[FleetRow], notes: Sequence[str]) -> tuple[FleetRow, ...]:
    """Return the report's rows with notes on the sensor's files and clock appended to their sentences."""
    return tuple(replace(row, says=" ".join((row.says, *notes)).strip()) for row in rows)


def refused(sensor: str, reason: str, took_s: float = 0.0) -> Outcome:
    """Return the outcome of a sensor that could not be cleaned."""
    return Outcome(sensor, "refused", (FleetRow(sensor, state="refused", reason=reason),), took_s)
