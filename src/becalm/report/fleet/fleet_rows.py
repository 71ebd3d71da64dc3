"""Summarise each channel of a fleet in one row of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from becalm.cleaning.channels.faults import Fault
from becalm.cleaning.channels.judging import Decision
from becalm.cleaning.channels.report import ChannelReport

State = Literal["cleaned", "kept", "refused"]
"""What happened to a sensor; see `FleetRow.state`."""

LOSSES = ("clipped", "stuck", "dead", "drift")
"""Faults during which the readings do not show the signal; a list of faults begins with these."""

_USABLE = ("used", "step", "late", "repeated", "gap")  # verdicts of readings that show the signal
_WORDS = {  # names of faults: singular and plural
    "spike": ("spike", "spikes"),
    "step": ("step", "steps"),
    "gap": ("gap", "gaps"),
    "drift": ("drifting", "drifting"),
    "nonfinite": ("infinite", "infinite"),
    "overrange": ("out of range", "out of range"),
    "outlier": ("gross outlier", "gross outliers"),
    "hole": ("in holes", "in holes"),
    "runaway": ("ran away", "ran away"),
}


@dataclass(frozen=True)
class FleetRow:
    """The result for one channel of one sensor.

    Attributes
    ----------
    sensor : str
        Path of the sensor within the lake, such as "plant=3/sensor=17".
    channel, unit : str
        Name and unit of the channel; empty if the sensor was refused before they were read.
    state : {"cleaned", "kept", "refused"}
        "kept": finished in an earlier run, and unchanged since. "refused": no output was written.
    reason : str
        A sentence that says why the sensor was refused; empty if it was not.
    verdict : Decision or ""
        Decision of `becalm.cleaning.channels.judging.Judgement` on whether the model describes the channel; empty if
        not judged.
    health : float or None
        Mean square of the normalised innovations (NIS); 1 is right.
    noise_std : float or None
        Standard deviation of one reading's white noise, in the channel's unit.
    usable_share : float or None
        Share of the readings, 0 to 1, that show the signal.
    faults : str
        Faults of the sensor, as `faults_text` writes them; empty if there are none.
    says : str
        The judgement as a sentence, with advice.
    recipe : str
        The first twelve hexadecimal digits of the recipe's hash.
    rows : int
        Number of rows.
    rate_hz : float or None
        Rows per second.
    outlying : str
        A sentence that says how the sensor differs from the others of its class; empty if it does not.
    """

    sensor: str
    channel: str = ""
    unit: str = ""
    state: State = "cleaned"
    reason: str = ""
    verdict: Decision | Literal[""] = ""
    health: float | None = None
    noise_std: float | None = None
    usable_share: float | None = None
    faults: str = ""
    says: str = ""
    recipe: str = ""
    rows: int = 0
    rate_hz: float | None = None
    outlying: str = ""


def row_of(sensor: str, report: ChannelReport, *, recipe: str, rate_hz: float | None) -> FleetRow:
    """Return the row of a cleaned channel; its `outlying` is empty.

    Parameters
    ----------
    sensor : str
        Path of the sensor within the lake.
    report : ChannelReport
        Report of the cleaned channel.
    recipe : str
        The first digits of the recipe's hash.
    rate_hz : float or None
        Rows per second.
    """
    rows = sum(report.verdicts.values())
    return FleetRow(
        sensor,
        report.name,
        report.unit,
        verdict=report.verdict,
        health=report.nis_mean,
        noise_std=report.noise_std,
        usable_share=usable_share(report.verdicts),
        faults=faults_text(report.faults),
        says=report.says,
        recipe=recipe,
        rows=rows,
        rate_hz=rate_hz,
    )


def usable_share(verdicts: Mapping[str, int]) -> float | None:
    """Return the share of readings that show the signal, from the count of each verdict; None without readings."""
    readings = sum(verdicts.values())
    return sum(verdicts.get(name, 0) for name in _USABLE) / readings if readings else None


def faults_text(faults: Sequence[Fault]) -> str:
    """Return faults as text, those in `LOSSES` first: "1 203 clipped, 2 gaps"."""
    ordered = sorted(faults, key=lambda fault: fault.what not in LOSSES)
    return ", ".join(counted(fault.readings, *_WORDS.get(fault.what, (fault.what, fault.what))) for fault in ordered)


def counted(count: int, one: str, several: str) -> str:
    """Return a count with its noun: "1 gap", "10 000 gaps"."""
    return f"{spaced(count)} {one if count == 1 else several}"


def spaced(count: int) -> str:
    """Return a count with its thousands separated by spaces: "10 000"."""
    return f"{count:,}".replace(",", " ")
