"""What became of one sensor: rows of the fleet's report, and how it went."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from becalm.report.fleet_rows import FleetRow, State

SHOWN = 12
"""Digits of a hash that people are shown."""


@dataclass(frozen=True)
class Outcome:
    """What became of one sensor.

    Attributes
    ----------
    sensor : str
        Its path within the lake.
    state : {"cleaned", "kept", "refused"}
        "kept": it was finished before, and nothing that it came of has changed since.
    channels : tuple of FleetRow
        What became of each channel; of a sensor that was refused one row, with the reason.
    took_s : float
        How long it took, in all tasks together, in seconds.
    seams : str
        Of a sensor that was cleaned in stretches of time, how they fit together.
    """

    sensor: str
    state: State
    channels: tuple[FleetRow, ...]
    took_s: float = 0.0
    seams: str = ""

    @property
    def reason(self) -> str:
        """Why it was refused, as a sentence."""
        return self.channels[0].reason if self.state == "refused" else ""

    @property
    def describes(self) -> bool:
        """Whether it was cleaned, and no channel is said not to be described by its model."""
        return self.state != "refused" and all(row.verdict != "does not fit" for row in self.channels)

    @property
    def rows(self) -> int:
        """How many rows it has."""
        return max(row.rows for row in self.channels)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, ready for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, told: Mapping[str, Any]) -> Outcome:
        """Read what `as_dict` returned.

        Raises
        ------
        ValueError
            If it is something else.
        """
        try:
            return cls(**{**told, "channels": tuple(FleetRow(**row) for row in told["channels"])})
        except (TypeError, KeyError) as cause:
            known = ", ".join(field.name for field in fields(cls))
            raise ValueError(f"{str(told)[:80]!r} is no outcome of a sensor, which has {known}") from cause


def noted(rows: Sequence[FleetRow], notes: Sequence[str]) -> tuple[FleetRow, ...]:
    """Return rows that also say what was found of their sensor's files and clock."""
    return tuple(replace(row, says=" ".join((row.says, *notes)).strip()) for row in rows)


def refused(sensor: str, reason: str, took_s: float = 0.0) -> Outcome:
    """Return the outcome of a sensor that could not be cleaned."""
    return Outcome(sensor, "refused", (FleetRow(sensor, state="refused", reason=reason),), took_s)
