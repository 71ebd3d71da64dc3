"""What became of each channel of a fleet's sensors, in one row: enough to find those that are to be looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from becalm.cleaning.faults import Fault
from becalm.cleaning.judging import Decision
from becalm.cleaning.report import ChannelReport

State = Literal["cleaned", "kept", "refused"]

LOSSES = ("clipped", "stuck", "dead", "drift")
"""Faults while which a sensor does not tell what it should: named before all others."""

_USABLE = ("used", "step", "late", "repeated", "gap")  # verdicts on readings that tell of the signal
_WORDS = {  # of faults: of one, and of several
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
    """What became of one channel of one sensor.

    Attributes
    ----------
    sensor : str
        Its path within the lake, such as "plant=3/sensor=17".
    channel, unit : str
        As in the recording; empty where it was refused before they were known.
    state : {"cleaned", "kept", "refused"}
        "kept": finished before, and unchanged since. "refused": no output was written.
    reason : str
        Why it was refused, as a sentence; empty if it was not.
    verdict : Decision or ""
        Whether its model describes it, as `becalm.cleaning.judging.Judgement` has it; empty where nothing was judged.
    health : float or None
        Mean squared normalised innovation (NIS); 1 is right.
    noise_std : float or None
        Standard deviation of one reading's white noise, in unit.
    usable_share : float or None
        Share of the readings, 0 to 1, that tell of the signal.
    faults : str
        What was wrong with the sensor, as `faults_told` writes it; empty if nothing was found.
    says : str
        The judgement as a sentence, with what to do.
    recipe : str
        The first twelve hexadecimal digits of the recipe's hash.
    rows : int
        How many it has.
    rate_hz : float or None
        Rows a second.
    outlying : str
        Why it is unlike the other sensors of its class, as a sentence; empty if it is like them.
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
    """Return the row of a channel that was cleaned; what its class says of it may be added by `dataclasses.replace`.

    Parameters
    ----------
    sensor : str
        Its path within the lake.
    report : ChannelReport
        What was found when it was cleaned.
    recipe : str
        The first digits of the recipe's hash.
    rate_hz : float or None
        Rows a second.
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
        faults=faults_told(report.faults),
        says=report.says,
        recipe=recipe,
        rows=rows,
        rate_hz=rate_hz,
    )


def usable_share(verdicts: Mapping[str, int]) -> float | None:
    """Return the share of readings that tell of the signal, by how often each verdict was given; None of none."""
    readings = sum(verdicts.values())
    return sum(verdicts.get(name, 0) for name in _USABLE) / readings if readings else None


def faults_told(faults: Sequence[Fault]) -> str:
    """Return faults in a few words, the gravest first: "1 203 clipped, 2 gaps"."""
    told = sorted(faults, key=lambda fault: fault.what not in LOSSES)
    return ", ".join(counted(fault.readings, *_WORDS.get(fault.what, (fault.what, fault.what))) for fault in told)


def counted(count: int, one: str, several: str) -> str:
    """Return a count with its word: "1 gap", "10 000 gaps"."""
    return f"{spaced(count)} {one if count == 1 else several}"


def spaced(count: int) -> str:
    """Return a count as people read it: "10 000"."""
    return f"{count:,}".replace(",", " ")
