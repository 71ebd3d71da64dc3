"""Join the results of a sensor's stretches into one outcome."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from becalm.cleaning.channels.faults import Fault
from becalm.cleaning.channels.report import ChannelReport
from becalm.core.reading_verdicts import Verdict
from becalm.fleet.outcome import SHOWN, Outcome, noted
from becalm.fleet.stretching.long_sensor import LongSensor
from becalm.fleet.stretching.run import StretchEstimates
from becalm.report.fleet.fleet_rows import FleetRow, faults_text, usable_share

_WORST_FIRST = ("does not fit", "fits except", "fits", "constant", "untold")
_NO_FAULT = (Verdict.USED, Verdict.MISSING, Verdict.SPIKE, Verdict.STEP, Verdict.HOLE, Verdict.RUNAWAY)


class _Part(NamedTuple):
    """The results of one channel in one stretch."""

    estimates: StretchEstimates
    report: ChannelReport
    counts: dict[Verdict, int]  # number of rows with each verdict

    @property
    def used(self) -> int:
        return self.counts.get(Verdict.USED, 0)


def joined_outcome(long: LongSensor, estimates: Sequence[StretchEstimates], again: int, took_s: float) -> Outcome:
    """Return the outcome of a sensor that was cleaned in stretches.

    Parameters
    ----------
    long : LongSensor
        The sensor.
    estimates : sequence of StretchEstimates
        The results of its stretches, in order.
    again : int
        The number of stretches that ran twice.
    took_s : float
        The computing time of all stretches together, in seconds.
    """
    parts = [[_Part(one, one.reports[c], one.counts[c]) for one in estimates] for c in range(len(long.first))]
    rows = tuple(_row(long, channel) for channel in parts)
    return Outcome(long.sensor.name, "cleaned", noted(rows, long.notes), took_s, _seams(estimates, again))


def _seams(stretches: Sequence[StretchEstimates], again: int) -> str:
    """Return a sentence on how well the stretches join."""
    seams = stretches[0].seams
    count, smoothed = len(stretches), seams is not None and seams.end is None
    if smoothed:
        return f"{count} stretches, which agree where they overlap."
    more = f" {again} of them ran a second time, from the state that the one before left." if again else ""
    return f"{count} stretches, each of which begins with exactly the state that the one before left.{more}"


def _row(long: LongSensor, parts: Sequence[_Part]) -> FleetRow:
    counts = Counter[Verdict]()
    for part in parts:
        counts.update(part.counts)
    worst = min(parts, key=lambda part: _WORST_FIRST.index(part.report.verdict))
    first = parts[0].report
    return FleetRow(
        long.sensor.name,
        first.name,
        first.unit,
        verdict=worst.report.verdict,
        health=_mean_nis(parts),
        noise_std=first.noise_std,
        usable_share=usable_share({verdict.name.lower(): count for verdict, count in counts.items()}),
        faults=faults_text(_faults(counts)),
        says=_says(worst),
        recipe=long.sensor.recipe[:SHOWN],
        rows=long.parsed_source.rows,
        rate_hz=long.parsed_source.clock.rate_hz,
    )


def _mean_nis(parts: Sequence[_Part]) -> float | None:
    judged = [(part.report.nis_mean, part.used) for part in parts if part.report.nis_mean is not None]
    total = sum(used for _, used in judged)
    return sum(nis * used for nis, used in judged) / total if total else None


def _faults(counts: Counter[Verdict]) -> list[Fault]:
    faults = [verdict for verdict in sorted(counts) if counts[verdict] and verdict not in _NO_FAULT]
    return [Fault(verdict.name.lower(), counts[verdict], 0, 0.0, 0.0) for verdict in faults]


def _says(worst: _Part) -> str:
    if worst.report.describes:
        return worst.report.says
    stretch = worst.estimates.stretch
    return f"Rows {stretch.first + 1} to {stretch.stop}: {worst.report.says}"
