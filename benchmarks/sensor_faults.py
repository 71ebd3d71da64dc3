"""Faults of a sensor: whether they are detected within the stated delay, and false alarms in hours of healthy readings.

Limits are identified from the first minute (or from 30 000 readings) of each record, and the record is then checked
in blocks, like a stream. Readings are in sigma of their white noise; LSB is the step of the converter.

Run: python benchmarks/sensor_faults.py [-o docs/sensor-faults.md] [--seeds N]
"""

from __future__ import annotations

from collections import Counter

import numpy as np

import becalm
from becalm.core.health.faults import fault_messages
from becalm.core.health.limits import find_limits, run_lengths
from pages import page_parser, publish
from sensor_faults_jobs import Score, clipped, dead, drift, dropout, false_alarms, monitor_alarms, stuck, watched
from sensor_faults_records import ALARMS_PER_HOUR, DATA, RATES_HZ, REAL, SIGNALS, STEPS


def real() -> list[str]:
    """Return a row for each channel of the real recordings that exist on this machine."""
    rows = []
    for file, rate_hz in REAL.items():
        if not (DATA / file).exists():
            continue
        recording = becalm.read(DATA / file, rate_hz=rate_hz)
        elapsed, step_s = recording.timebase.elapsed_steps, recording.timebase.step_s
        for name, z in zip(recording.names, recording.samples.T, strict=True):
            limits = find_limits(z, elapsed, ALARMS_PER_HOUR, step_s)
            faults = watched(z, elapsed, limits)
            rails = "none" if not np.isfinite(limits.rails).any() else f"{limits.low:.6g} to {limits.high:.6g}"
            sentences = " ".join(fault_messages(faults.found, limits, step_s)) or "nothing"
            label = name.replace("\\", "/")
            rows.append(
                f"| {file.partition('/')[0]} | {label} | {limits.resolution:.6g} | {rails}"
                f" | {int(max(run_lengths(z)))} | {limits.stuck_readings} | {sentences} |"
            )
    return rows


FOUND = (
    "| fault | signal | LSB | stated delay, readings | longest | found in time | not told | wrong |",
    "|---|---|---|---|---|---|---|---|",
)
ALARMS = (
    "| rate | asked, of all kinds, per hour | drift | dead |",
    "|---|---|---|---|",
)


def faults(seeds: int) -> str:
    """Return the table of simulated faults."""
    lines = list(FOUND)
    for lsb in STEPS:
        step = f"{lsb:g} sigma"
        lines += [
            stuck(lsb, seeds).row("stuck", "all", step),
            stuck(lsb, seeds, taught=True).row("stuck for 20 s while limits are found", "all", step),
            dropout(lsb, seeds).row("dropout", "all", step),
            dead(lsb, seeds).row("dead, behind a filter", "random walk", step),
        ]
        lines += [clipped(name, lsb, seeds).row("clipped", name, step) for name in SIGNALS]
        given = [clipped(name, lsb, seeds, given=True) for name in SIGNALS]
        lines.append(Score.of_all(given).row("clipped, range given", "all", step))
    return "\n".join(lines)


def healthy(seeds: int) -> str:
    """Return the table of readings that were called faulty in healthy hours."""
    lines = ["| rate | LSB | " + " | ".join(SIGNALS) + " |", "|---|---|" + "---|" * len(SIGNALS)]
    for rate_hz in RATES_HZ:
        hours = seeds if rate_hz <= 500 else 1
        for lsb in STEPS:
            total: Counter[str] = Counter()
            for seed in range(hours):
                total.update(false_alarms(rate_hz, lsb, seed))
            cells = " | ".join(f"{total[name]} in {hours} h" for name in SIGNALS)
            lines.append(f"| {rate_hz} Hz | {lsb:g} sigma | {cells} |")
    return "\n".join(lines)


def innovations_page(seeds: int) -> str:
    """Return the tables of drift, and of false alarms from innovations."""
    alarms = list(ALARMS)
    for rate_hz, hours, per_hour in ((500, seeds, 1.0), (500, seeds, 100.0), (10_000, 1, 1.0), (10_000, 1, 100.0)):
        got = monitor_alarms(rate_hz, hours, per_hour)
        cells = " | ".join(f"{count:.3g}" for count in got.values())
        alarms.append(f"| {rate_hz} Hz, {hours} h | {per_hour:g} | {cells} |")
    found = ["| what | stated, readings | got, mean | told |", "|---|---|---|---|", *drift(seeds)]
    return "\n".join(found) + "\n\n" + "\n".join(alarms)


def page(seeds: int) -> str:
    """Return the page with all tables and their explanations."""
    real_rows = real()
    head = ["| recording | channel | LSB | rails | longest run | stuck from | found |", "|---|---|---|---|---|---|---|"]
    table = "\n".join([*head, *real_rows]) if real_rows else "The recordings are not beside the project."
    return f"""## Faults that were made

{seeds} records of each signal. A rail, or a run, is *not told* where a record cannot tell it from a signal: a white
noise that is clipped looks like one of a smaller range where its last code is no rarer than those beside it. A dead
sensor whose level lies on the edge of a code toggles: that is told as less noise, not as dead. *Wrong* counts records
with an alarm before the fault, or on readings that have none.

{faults(seeds)}

## Healthy hours

Readings that were called faulty, with limits from the first minute, for {ALARMS_PER_HOUR:g} false alarm an hour.

{healthy(seeds)}

## Innovations

{innovations_page(seeds)}

- A filter that follows drift shows none in its innovations; the same drift against a level known at rest is told.

## Real recordings

Limits are found from each channel, and the channel is watched with them.

{table}
"""


def main() -> None:
    """Print the tables; with -o, write them as a page."""
    parser = page_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="records of each kind, and hours at 500 Hz")
    arguments = parser.parse_args()
    publish("Faults of a sensor", __doc__, page(arguments.seeds), arguments.output)


if __name__ == "__main__":
    main()
