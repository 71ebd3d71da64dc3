"""Whether innovations stay what they should be, white noise of variance 1: drift, a dead sensor, a change of noise.

Innovations are counted in whole parts of a sigma, so that all sums are exact: the alarms are those of the whole
record wherever it is cut.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv, gammaincinv

from becalm.core.arrays import Codes, Floats, Integers
from becalm.core.cusum import OneSidedCusum, cusum_delay, cusum_threshold
from becalm.core.faults import Found
from becalm.core.verdict import Verdict
from becalm.errors import UsageError

WINDOW = 64
"""Innovations whose variance is looked at together."""

HOP = 16
"""Innovations from one window to the next."""

LARGEST = 6.0
"""Sigma: what one spike may say."""

_PARTS = 1 << 16  # of a sigma
_DEAD = 0.05  # of the variance that was expected; what is quieter than chance but above only rests
_THAN_REST = 0.25  # of the quietest window of a healthy record
_ALARMS = 3  # of drift, of less noise, of more: each gets its share of the false alarms
_CALM, _LOUD, _QUIET, _SILENT = range(4)


class Alarms(NamedTuple):
    """Where innovations stop being noise of variance 1.

    Attributes
    ----------
    drift_threshold : float
        h of the cumulative sum, in sigma; a *small* one finds a drift sooner, and more that are none.
    quiet_variance, loud_variance : float
        Variance of a window below or above which the noise has changed; those near 1 find less of a change.
    dead_variance : float
        Variance of a window below which the channel is dead; a *small* one lets it rest, 0 never calls it dead.
    """

    drift_threshold: float
    quiet_variance: float
    loud_variance: float
    dead_variance: float = _DEAD

    @property
    def drift_delay(self) -> float:
        """Readings that a shift of one sigma lasts, on average, until it is told."""
        return cusum_delay(self.drift_threshold, 1.0)

    @property
    def dead_delay(self) -> int:
        """Readings without noise, at most, until the channel is told to be dead; the filter must be at rest."""
        return WINDOW + HOP


def find_alarms(false_alarms_per_hour: float, step_s: float, healthy: Floats | None = None) -> Alarms:
    """Choose the thresholds so that white innovations of variance 1 raise no more false alarms than this.

    Parameters
    ----------
    false_alarms_per_hour : float
        Of all kinds together; a *small* one trusts the sensor.
    step_s : float
        One step, in seconds.
    healthy : (N,) float array, optional
        Normalised innovations of a healthy record. A filter tuned on motion expects more noise than a sensor at rest
        has; with these, only what is far quieter than the quietest of them is dead.

    Returns
    -------
    Alarms
        Without a healthy record, `dead_variance` is a twentieth of the expected one, or what chance allows if less.

    Raises
    ------
    UsageError
        If a rate or step is not above 0.

    Notes
    -----
    The variance of a window about its mean is chi-square of WINDOW - 1 degrees of freedom; windows that
    overlap are counted as if they did not, which only makes false alarms fewer.
    """
    if not (0 < false_alarms_per_hour < np.inf and 0 < step_s < np.inf):
        raise UsageError(
            f"false_alarms_per_hour = {false_alarms_per_hour!r} and step_s = {step_s!r} came; both must be above 0,"
            " as in find_alarms(1.0, 0.002)."
        )
    readings = max(_ALARMS * 3600 / (step_s * false_alarms_per_hour), 2.0 * WINDOW)
    p, half = HOP / readings, (WINDOW - 1) / 2
    quiet, loud = float(gammaincinv(half, p)) / half, float(gammainccinv(half, p)) / half
    rest = np.empty(0) if healthy is None else _variances(_window_spreads(_hop_sums(_in_parts(healthy))))
    dead = min(_DEAD, quiet, _THAN_REST * float(rest.min(initial=np.inf)))
    return Alarms(cusum_threshold(readings), quiet, loud, dead)


def _in_parts(normalised: Floats) -> Integers:
    """Return the innovations that are there, in parts of a sigma."""
    known = normalised[~np.isnan(normalised)]
    return np.rint(np.clip(known, -LARGEST, LARGEST) * _PARTS).astype(np.int64)


def _hop_sums(parts: Integers) -> Integers:
    """Return the sums, and the sums of squares, of whole hops: (H, 2)."""
    hops = parts[: len(parts) // HOP * HOP].reshape(-1, HOP)
    return np.stack([hops.sum(axis=1), (hops**2).sum(axis=1)], axis=1)


def _window_spreads(sums: Integers) -> Integers:
    """Return WINDOW^2 times the variance of each window of hops, in parts^2; none where hops are too few."""
    hops = WINDOW // HOP
    if len(sums) < hops:
        return np.zeros(0, dtype=np.int64)
    windows = np.lib.stride_tricks.sliding_window_view(sums, hops, axis=0).sum(axis=2)
    return np.asarray(WINDOW * windows[:, 1] - windows[:, 0] ** 2)


def _variances(spreads: Integers) -> Floats:
    """Return variances about the mean of a window, in sigma^2."""
    return np.asarray(spreads / float(WINDOW * (WINDOW - 1) * _PARTS**2))


class Excursion(NamedTuple):
    """How the noise left what was expected: the windows of innovations that were too loud, or too quiet."""

    rows: int = 0  # that followed such a window, until one that was as expected
    first_row: int = 0
    windows: int = 0
    squares: int = 0  # WINDOW^2 times the variances of these windows, in parts^2

    @property
    def noise_ratio(self) -> float:
        """Standard deviation there over the expected one; NaN of no windows. Innovations count up to 6 sigma."""
        count = self.windows * WINDOW * (WINDOW - 1)
        return float(np.sqrt(self.squares / count)) / _PARTS if count else float("nan")


class InnovationMonitor:
    """Watches the normalised innovations nu / sqrt(S) of one channel, in constant memory.

    Drift is told by a two-sided cumulative sum of k = 0.5: the best for a shift of one sigma (Page, Biometrika 41
    (1954) 100). It is told again for as long as it lasts. Innovations are what the filter did *not* follow: one that
    follows drift, as all that keep no level do, takes the slow drift of a strain gauge for signal, and its
    innovations stay white. Such a drift shows only against something that has none: push (reading - reference) / sigma
    instead, the reference being a value known at rest (a tare), or a slow sensor beside it. Innovations that are
    coloured, of a model that does not fit, are told as drift more often than stated.

    Parameters
    ----------
    alarms : Alarms
        The thresholds.

    Attributes
    ----------
    found : dict
        `Found` of `DRIFT` and `DEAD`; rows are counted as they came.
    drift_since : int or None
        The row in which the drift that was told first began, as far as the sum tells.
    louder, quieter : Excursion
        Where the noise was more, or less, than the filter expects. Quieter is no fault: machines rest.
    """

    def __init__(self, alarms: Alarms) -> None:
        self.alarms = alarms
        self.found: dict[Verdict, Found] = {}
        self.drift_since: int | None = None
        self.louder, self.quieter = Excursion(), Excursion()
        threshold = int(np.ceil(alarms.drift_threshold * _PARTS))
        self._sides = OneSidedCusum(threshold), OneSidedCusum(threshold)
        self._rows = 0
        self._rest = np.empty(0, dtype=np.int64)  # innovations that fill no hop yet
        self._hops = np.zeros((0, 2), dtype=np.int64)  # sums, and sums of squares, of the last hops
        self._state = _CALM

    def push(self, normalised: Floats) -> Codes:
        """Take the next normalised innovations (B,), NaN where there is none; return DRIFT, DEAD or USED for each."""
        codes = np.zeros(len(normalised), dtype=np.int8)
        rows = np.flatnonzero(~np.isnan(normalised))
        parts = _in_parts(normalised)
        told = [
            side.push(sign * parts - _PARTS // 2, self._rows + rows)
            for side, sign in zip(self._sides, (1, -1), strict=True)
        ]
        codes[rows[np.concatenate([alarms for alarms, _ in told])]] = Verdict.DRIFT
        if self.drift_since is None:
            firsts = [(int(alarms[0]), since) for alarms, since in told if since is not None]
            self.drift_since = min(firsts)[1] if firsts else None
        codes[rows[self._look(parts, rows) == _SILENT]] = Verdict.DEAD
        for verdict in (Verdict.DRIFT, Verdict.DEAD):
            self._count(verdict, np.flatnonzero(codes == verdict))
        self._rows += len(codes)
        return codes

    def _count(self, verdict: Verdict, rows: Integers) -> None:
        if len(rows):
            first = self._rows + int(rows[0])
            before = self.found.get(verdict, Found(0, first, float(first)))
            self.found[verdict] = before._replace(readings=before.readings + len(rows))

    def _look(self, parts: Integers, rows: Integers) -> NDArray[np.int64]:
        """Return what the last whole window said when each innovation came."""
        held = np.append(self._rest, parts)
        fresh = _hop_sums(held)
        sums = np.concatenate([self._hops, fresh])
        states, spread = self._judge(_window_spreads(sums), len(fresh))
        said = np.append(self._state, states)[(len(self._rest) + 1 + np.arange(len(parts))) // HOP]
        self.louder = _joined(self.louder, self._rows + rows[said == _LOUD], spread[states == _LOUD])
        self.quieter = _joined(self.quieter, self._rows + rows[said == _QUIET], spread[states == _QUIET])
        self._rest, self._hops = held[len(fresh) * HOP :].copy(), sums[-(WINDOW // HOP - 1) :].copy()
        self._state = int(said[-1]) if len(said) else self._state
        return said

    def _judge(self, about: Integers, count: int) -> tuple[Integers, Integers]:
        """Return the states (count,) after the last hops, and the spreads of the windows that end there."""
        states, spread = np.full(count, _CALM), np.zeros(count, dtype=np.int64)
        variance = _variances(about)
        said = np.where(variance > self.alarms.loud_variance, _LOUD, _CALM)
        said[variance < self.alarms.quiet_variance] = _QUIET
        said[variance < self.alarms.dead_variance] = _SILENT
        states[count - len(said) :], spread[count - len(said) :] = said, about
        return states, spread


def _joined(change: Excursion, rows: Integers, spread: Integers) -> Excursion:
    first = change.first_row if change.rows or not len(rows) else int(rows[0])
    squares = change.squares + sum(map(int, spread))
    return Excursion(change.rows + len(rows), first, change.windows + len(spread), squares)
