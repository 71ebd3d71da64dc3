"""Put faults into healthy records, and measure when they are detected, for `sensor_faults.py`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm import Model, kalman_filter
from becalm.core.health.faults import Faults
from becalm.core.health.limits import Limits, find_limits
from becalm.core.health.monitor import Alarms, InnovationMonitor, cusum_delay, find_alarms
from becalm.core.reading_verdicts import Verdict
from sensor_faults_records import ALARMS_PER_HOUR, LEARNT, SIGNALS, Floats, digitised, record


def learnt(z: Floats, elapsed: Floats, rate_hz: float) -> Limits:
    """Identify the limits from the start of a record."""
    count = max(LEARNT, int(60 * rate_hz))
    return find_limits(z[:count], elapsed[:count], ALARMS_PER_HOUR, 1 / rate_hz)


def watched(z: Floats, elapsed: Floats, limits: Limits) -> Faults:
    """Check a record in blocks; return the faults."""
    faults = Faults(limits)
    for start in range(0, len(z), 1 << 16):
        faults.push(z[start : start + (1 << 16)], elapsed[start : start + (1 << 16)])
    return faults


def false_alarms(rate_hz: int, lsb: float, seed: int) -> dict[str, int]:
    """Return the number of readings called faulty in an hour of each healthy signal."""
    out = {}
    for name in SIGNALS:
        z, elapsed = record(name, 3600 * rate_hz, rate_hz, lsb, seed)
        faults = watched(z, elapsed, learnt(z, elapsed, rate_hz))
        out[name] = sum(found.readings for found in faults.found.values())
    return out


class Score(NamedTuple):
    """The detection of a fault, over signals and seeds."""

    records: int  # number of records whose limits can detect such a fault
    untold: int  # number of records whose limits cannot
    found: int  # number of faults that were detected within the stated delay
    stated: int  # longest stated delay, in readings
    worst: int  # longest delay of a detected fault, in readings
    wrong: int  # number of records with an alarm before the fault, or on readings without a fault

    @classmethod
    def of_all(cls, scores: list[Score]) -> Score:
        """Return the total of some scores."""
        records, untold, found, stated, worst, wrong = zip(*scores, strict=True)
        return cls(sum(records), sum(untold), sum(found), max(stated), max(worst), sum(wrong))

    def row(self, *names: str) -> str:
        """Return a row of the table."""
        found = f"{self.found} of {self.records}"
        return f"| {' | '.join(names)} | {self.stated} | {self.worst} | {found} | {self.untold} | {self.wrong} |"


RATE_HZ = 500
COUNT, FAULT_AT, TAUGHT_AT, HELD = 90_000, 60_000, 10_000, 10_000  # rows; a stuck stretch in the learnt part
SETTLING = 50  # readings: five time constants of a level filter with gain 0.1
SHOWN = 1 / 500  # smallest share of the learnt readings at a rail; with less, the record hardly shows the rail
CLIPS = {  # half of the range that clips a signal, in sigma
    "white": 2.0,
    "random walk": 15.0,
    "sine": 80.0,
    "vibration": 80.0,
    "ramp and hold": 95.0,
    "square wave": 40.0,
}


def _score(found: list[tuple[int | None, int | None, bool]]) -> Score:
    """Return the score of records, each with its stated and its real delay, or None, and whether an alarm was early."""
    detectable = [(stated, delay) for stated, delay, _ in found if stated is not None]
    within = [delay for stated, delay in detectable if delay is not None and delay <= stated]
    return Score(
        len(detectable),
        len(found) - len(detectable),
        len(within),
        max((stated for stated, _ in detectable), default=0),
        max((delay for _, delay in detectable if delay is not None), default=0),
        sum(early for _, _, early in found),
    )


def _delay(faults: Faults, verdict: Verdict, at: int) -> int | None:
    """Return the number of readings from a fault in row `at` to its detection; None if it was not detected."""
    return faults.found[verdict].first_row - at + 1 if verdict in faults.found else None


def stuck(lsb: float, seeds: int, taught: bool = False) -> Score:
    """Hold a reading until the end; with `taught`, for 20 s while limits are identified."""
    found = []
    for name in SIGNALS:
        for seed in range(seeds):
            z, elapsed = record(name, COUNT, RATE_HZ, lsb, seed)
            at = TAUGHT_AT if taught else FAULT_AT
            z[at : at + HELD if taught else None] = z[at]
            limits = learnt(z, elapsed, RATE_HZ)
            delay, stated = _delay(watched(z, elapsed, limits), Verdict.STUCK, at), limits.stuck_readings
            usable = None if stated is None or stated > HELD else stated
            found.append((usable, delay, delay is not None and delay < 1))
    return _score(found)


def clipped(name: str, lsb: float, seeds: int, given: bool = False) -> Score:
    """Clip a signal, and check each saturation limit; limits are identified from the record, or `given`."""
    found: list[tuple[int | None, int | None, bool]] = []
    for seed in range(seeds):
        z, elapsed = record(name, COUNT, RATE_HZ, lsb, seed)
        middle = float(z[:LEARNT].min() + z[:LEARNT].max()) / 2
        rails = digitised(np.array([middle - CLIPS[name], middle + CLIPS[name]]), lsb)
        z = np.clip(z, *rails)
        limits = find_limits(
            z[:LEARNT], elapsed[:LEARNT], ALARMS_PER_HOUR, 1 / RATE_HZ, (rails[0], rails[1]) if given else None
        )
        codes = Faults(limits).push(z, elapsed)
        wrong = bool((codes == Verdict.CLIPPED)[(z != rails[0]) & (z != rails[1])].any())
        for rail, limit in zip(rails, (limits.low, limits.high), strict=True):
            there = z == rail
            if there[:LEARNT].mean() > SHOWN:
                right = bool((codes[there] == Verdict.CLIPPED).all())
                found.append((1 if np.isfinite(limit) else None, 1 if right else None, wrong))
    return _score(found)


def dropout(lsb: float, seeds: int) -> Score:
    """Lose 1 to 500 rows in one place."""
    found: list[tuple[int | None, int | None, bool]] = []
    for name in SIGNALS:
        for seed in range(seeds):
            z, elapsed = record(name, COUNT, RATE_HZ, lsb, seed)
            lost = int(np.random.default_rng(seed).integers(1, 500))
            z, elapsed = np.delete(z, slice(FAULT_AT, FAULT_AT + lost)), elapsed[:-lost]
            elapsed[FAULT_AT] = 1 + lost
            faults = watched(z, elapsed, learnt(z, elapsed, RATE_HZ))
            found.append((1, _delay(faults, Verdict.GAP, FAULT_AT), len(faults.found) > 1))
    return _score(found)


def innovations(z: Floats, ratio: float) -> Floats:
    """Return the normalised innovations (N,) of a random-walk filter with R = 1 and Q/R = `ratio`."""
    one = np.ones((1, 1))
    estimate = kalman_filter(Model(F=one, H=one, Q=ratio * one, R=one, x0=z[:1], P0=one), z)
    return np.asarray((estimate.innovations / estimate.innovation_sigma)[:, 0])


def dead(lsb: float, seeds: int) -> Score:
    """Let a sensor return a constant with a hundredth of its noise, and monitor a filter with a gain of 0.1."""
    alarms = find_alarms(ALARMS_PER_HOUR, 1 / RATE_HZ)
    found: list[tuple[int | None, int | None, bool]] = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        z = np.cumsum(rng.normal(0, 0.1, COUNT)) + rng.normal(size=COUNT)
        z[FAULT_AT:] = z[FAULT_AT] + rng.normal(0, 0.01, COUNT - FAULT_AT)
        monitor = InnovationMonitor(alarms)
        monitor.push(innovations(digitised(z, lsb), 0.01))
        row = monitor.found[Verdict.DEAD].first_row if Verdict.DEAD in monitor.found else None
        delay = None if row is None else row - FAULT_AT + 1
        found.append((alarms.dead_delay + SETTLING, delay, delay is not None and delay < 1))
    return _score(found)


def drift(seeds: int) -> list[str]:
    """Return the rows of the drift table: kind of drift, stated delay, real delay, number of detections."""
    alarms = find_alarms(ALARMS_PER_HOUR, 1 / RATE_HZ)
    rows = []
    for what, shift in (("shift of 1 sigma", 1.0), ("shift of -1 sigma", -1.0), ("shift of 2 sigma", 2.0)):
        stated = cusum_delay(alarms.drift_threshold, abs(shift))
        delays = [_drift_delay(alarms, np.full(2000, shift), seed) for seed in range(20 * seeds)]
        real = [delay for delay in delays if delay is not None]
        rows.append(
            f"| {what} of white innovations | {stated:.1f} | {np.mean(real):.1f} | {len(real)} of {len(delays)} |"
        )
    ramp = np.arange(60.0 * RATE_HZ) / RATE_HZ * 0.1  # 0.1 sigma a second, for a minute
    for what, ratio in (("a filter of gain 0.1, that follows it", 0.01), ("a level known at rest", 0.0)):
        delays = [_ramp_delay(alarms, ramp, ratio, seed) for seed in range(seeds)]
        real = [delay for delay in delays if delay is not None]
        mean = f"{np.mean(real) / RATE_HZ:.1f} s" if real else "-"
        rows.append(f"| drift of 0.1 sigma a second, against {what} | - | {mean} | {len(real)} of {len(delays)} |")
    return rows


def _drift_delay(alarms: Alarms, shift: Floats, seed: int) -> int | None:
    monitor = InnovationMonitor(alarms)
    quiet = np.random.default_rng(seed).normal(size=1000 + len(shift))
    quiet[1000:] += shift
    monitor.push(quiet)
    return monitor.found[Verdict.DRIFT].first_row - 999 if Verdict.DRIFT in monitor.found else None


def _ramp_delay(alarms: Alarms, ramp: Floats, ratio: float, seed: int) -> int | None:
    noise = np.random.default_rng(seed).normal(size=len(ramp))
    monitor = InnovationMonitor(alarms)
    monitor.push(innovations(ramp + noise, ratio) if ratio else ramp + noise)
    return monitor.found[Verdict.DRIFT].first_row if Verdict.DRIFT in monitor.found else None


def monitor_alarms(rate_hz: int, hours: int, per_hour: float) -> dict[str, float]:
    """Return the number of false alarms per hour on white innovations, of drift and of a dead sensor."""
    monitor, counts = InnovationMonitor(find_alarms(per_hour, 1 / rate_hz)), {"drift": 0, "dead": 0}
    rng = np.random.default_rng(rate_hz)
    for _ in range(hours * 36):
        codes = monitor.push(rng.normal(size=100 * rate_hz))
        counts["drift"] += int((codes == Verdict.DRIFT).sum())
        counts["dead"] += int((codes == Verdict.DEAD).sum())
    return {name: count / hours for name, count in counts.items()}
