"""What the benchmark of sensor faults does: breaks healthy records, and asks when it is told."""

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
    """Find the limits from the start of a record."""
    count = max(LEARNT, int(60 * rate_hz))
    return find_limits(z[:count], elapsed[:count], ALARMS_PER_HOUR, 1 / rate_hz)


def watched(z: Floats, elapsed: Floats, limits: Limits) -> Faults:
    """Push a record in blocks."""
    faults = Faults(limits)
    for start in range(0, len(z), 1 << 16):
        faults.push(z[start : start + (1 << 16)], elapsed[start : start + (1 << 16)])
    return faults


def false_alarms(rate_hz: int, lsb: float, seed: int) -> dict[str, int]:
    """Return how many readings of an hour of each healthy signal were called faulty."""
    out = {}
    for name in SIGNALS:
        z, elapsed = record(name, 3600 * rate_hz, rate_hz, lsb, seed)
        faults = watched(z, elapsed, learnt(z, elapsed, rate_hz))
        out[name] = sum(found.readings for found in faults.found.values())
    return out


class Score(NamedTuple):
    """How a fault was found over signals and seeds."""

    records: int  # in which the limits tell of such a fault
    untold: int  # in which they do not
    found: int  # within the stated delay
    stated: int  # the longest stated delay, in readings
    worst: int  # the longest real one, of those that were found
    wrong: int  # records with an alarm before the fault, or on readings that have none

    @classmethod
    def of_all(cls, scores: list[Score]) -> Score:
        """Put scores together."""
        records, untold, found, stated, worst, wrong = zip(*scores, strict=True)
        return cls(sum(records), sum(untold), sum(found), max(stated), max(worst), sum(wrong))

    def row(self, *names: str) -> str:
        """Write a row of the table."""
        told = f"{self.found} of {self.records}"
        return f"| {' | '.join(names)} | {self.stated} | {self.worst} | {told} | {self.untold} | {self.wrong} |"


RATE_HZ = 500
COUNT, FAULT_AT, TAUGHT_AT, HELD = 90_000, 60_000, 10_000, 10_000  # rows; of a stuck stretch among those learnt
SETTLING = 50  # readings: five time constants of a level filter of gain 0.1
SHOWN = 1 / 500  # share of the readings learnt: of a rail that holds less the record shows next to nothing
CLIPS = {  # half of the range that clips a signal, in sigma
    "white": 2.0,
    "random walk": 15.0,
    "sine": 80.0,
    "vibration": 80.0,
    "ramp and hold": 95.0,
    "square wave": 40.0,
}


def _score(found: list[tuple[int | None, int | None, bool]]) -> Score:
    """Put together stated delays, real ones (None where there is none) and whether an alarm came before."""
    told = [(stated, delay) for stated, delay, _ in found if stated is not None]
    within = [delay for stated, delay in told if delay is not None and delay <= stated]
    return Score(
        len(told),
        len(found) - len(told),
        len(within),
        max((stated for stated, _ in told), default=0),
        max((delay for _, delay in told if delay is not None), default=0),
        sum(early for _, _, early in found),
    )


def _delay(faults: Faults, verdict: Verdict, at: int) -> int | None:
    """Return how many readings a fault that began in row `at` had lasted when it was told; None if it was not."""
    return faults.found[verdict].first_row - at + 1 if verdict in faults.found else None


def stuck(lsb: float, seeds: int, taught: bool = False) -> Score:
    """Hold a reading for good; `taught`: for 20 s, within the record that the limits are found in."""
    found = []
    for name in SIGNALS:
        for seed in range(seeds):
            z, elapsed = record(name, COUNT, RATE_HZ, lsb, seed)
            at = TAUGHT_AT if taught else FAULT_AT
            z[at : at + HELD if taught else None] = z[at]
            limits = learnt(z, elapsed, RATE_HZ)
            delay, stated = _delay(watched(z, elapsed, limits), Verdict.STUCK, at), limits.stuck_readings
            told = None if stated is None or stated > HELD else stated
            found.append((told, delay, delay is not None and delay < 1))
    return _score(found)


def clipped(name: str, lsb: float, seeds: int, told: bool = False) -> Score:
    """Clip a signal all along, and ask for each rail; they are found from the record, or told."""
    found: list[tuple[int | None, int | None, bool]] = []
    for seed in range(seeds):
        z, elapsed = record(name, COUNT, RATE_HZ, lsb, seed)
        middle = float(z[:LEARNT].min() + z[:LEARNT].max()) / 2
        rails = digitised(np.array([middle - CLIPS[name], middle + CLIPS[name]]), lsb)
        z = np.clip(z, *rails)
        limits = find_limits(
            z[:LEARNT], elapsed[:LEARNT], ALARMS_PER_HOUR, 1 / RATE_HZ, (rails[0], rails[1]) if told else None
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
    """Return normalised innovations (N,) of a level filter for noise of variance 1 and a walk of Q/R = `ratio`."""
    one = np.ones((1, 1))
    estimate = kalman_filter(Model(F=one, H=one, Q=ratio * one, R=one, x0=z[:1], P0=one), z)
    return np.asarray((estimate.innovations / estimate.innovation_sigma)[:, 0])


def dead(lsb: float, seeds: int) -> Score:
    """Let a sensor give a level with a hundredth of its noise, seen by a filter of a gain of 0.1."""
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
    """Return rows of the drift table: what is pushed, what is stated, what came."""
    alarms = find_alarms(ALARMS_PER_HOUR, 1 / RATE_HZ)
    rows = []
    for what, shift in (("shift of 1 sigma", 1.0), ("shift of -1 sigma", -1.0), ("shift of 2 sigma", 2.0)):
        stated = cusum_delay(alarms.drift_threshold, abs(shift))
        delays = [_drift_delay(alarms, np.full(2000, shift), seed) for seed in range(20 * seeds)]
        told = [delay for delay in delays if delay is not None]
        rows.append(
            f"| {what} of white innovations | {stated:.1f} | {np.mean(told):.1f} | {len(told)} of {len(delays)} |"
        )
    ramp = np.arange(60.0 * RATE_HZ) / RATE_HZ * 0.1  # 0.1 sigma a second, for a minute
    for what, ratio in (("a filter of gain 0.1, that follows it", 0.01), ("a level known at rest", 0.0)):
        delays = [_ramp_delay(alarms, ramp, ratio, seed) for seed in range(seeds)]
        told = [delay for delay in delays if delay is not None]
        mean = f"{np.mean(told) / RATE_HZ:.1f} s" if told else "-"
        rows.append(f"| drift of 0.1 sigma a second, against {what} | - | {mean} | {len(told)} of {len(delays)} |")
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
    """Return how often white innovations were called a drift, or dead, per hour."""
    monitor, counts = InnovationMonitor(find_alarms(per_hour, 1 / rate_hz)), {"drift": 0, "dead": 0}
    rng = np.random.default_rng(rate_hz)
    for _ in range(hours * 36):
        codes = monitor.push(rng.normal(size=100 * rate_hz))
        counts["drift"] += int((codes == Verdict.DRIFT).sum())
        counts["dead"] += int((codes == Verdict.DEAD).sum())
    return {name: count / hours for name, count in counts.items()}
