"""Monitor innovations, which should stay white noise of variance 1: detect drift, a dead sensor, a change of noise.

Innovations are rounded to multiples of 2^-16 sigma, so that all sums are exact and the boundaries between blocks do not
change the alarms. One pass sums each hop (16 innovations); without an alarm, all further steps use only these sums.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Codes, Floats, Integers, input_of
from becalm.core.health.faults import FaultCount, possible_steps, require_steps
from becalm.core.reading_verdicts import Verdict
from becalm.errors import ModelError, UsageError
from becalm.native.library import SETTINGS
from becalm.native.scans import HOP, KEPT_HOPS, PARTS, WATCHED, WINDOW, Hops, new_watched, restored, scan_innovations

# Detect a change of the noise from mean squares of innovations, for a record of any length, in constant memory.
#
# A change is reported only if, both before and after it, the mean squares vary no more than those of stationary noise.
# So motion that comes and goes is not reported as a change of the noise.

_LEAST = 4  # number of hops in a block at the start
_MOST = 2048  # number of blocks at which neighbouring blocks are merged in pairs
_FEWEST = 8  # least number of blocks before a change, and after it
_RATIO = 1.5  # smallest ratio of standard deviations that is reported
_UNEVEN = 4.0  # largest variance of block means, over that of Gaussian noise; noise with heavy tails has up to 3


class NoiseChanged(NamedTuple):
    """A change of noise."""

    step: float  # time of the change, in steps from the first row; its resolution is one block
    ratio: float  # standard deviation of the innovations after the change, over that before


class NoiseHistory:
    """The mean squares of one channel's innovations over time, in blocks that grow with the record."""

    def __init__(self) -> None:
        self._powers, self._steps = np.empty(0), np.empty(0)  # hops of an incomplete block
        self._means, self._starts = np.empty(0), np.empty(0)  # complete blocks
        self._size = _LEAST  # hops in a block

    def push(self, powers: Floats, steps: Floats) -> None:
        """Take the next hops: the sums of their squared innovations, in sigma^2, and the steps at which they begin."""
        powers, steps = np.append(self._powers, powers), np.append(self._steps, steps)
        while len(powers) >= self._size:
            hops = min(len(powers) // self._size, _MOST - len(self._means)) * self._size
            self._means = np.append(self._means, self._mean(powers[:hops]))
            self._starts = np.append(self._starts, steps[: hops : self._size])
            powers, steps = powers[hops:], steps[hops:]
            if len(self._means) == _MOST:
                self._means = (self._means[::2] + self._means[1::2]) / 2
                self._starts, self._size = self._starts[::2].copy(), 2 * self._size
        self._powers, self._steps = powers.copy(), steps.copy()

    def _mean(self, powers: Floats) -> Floats:
        """Return the mean squares of blocks, averaged in pairs, so that the time of merging does not change them."""
        means = powers / HOP
        for _ in range(self._size.bit_length() - 1):
            means = (means[::2] + means[1::2]) / 2
        return means

    def change(self) -> NoiseChanged | None:
        """Return the change that splits the record best; None if there is none, or if a side varies more than noise.

        The split maximises the likelihood of Gaussian noise with two variances.
        """
        means, count = self._means, len(self._means)
        if count < 2 * _FEWEST or not means.min() > 0:
            return None
        split = np.arange(_FEWEST, count - _FEWEST + 1)
        before = np.cumsum(means)[split - 1] / split
        after = np.cumsum(means[::-1])[count - split - 1] / (count - split)
        at = int(np.argmin(split * np.log(before) + (count - split) * np.log(after)))
        k, ratio = int(split[at]), float(np.sqrt(after[at] / before[at]))
        is_change = max(ratio, 1 / ratio) >= _RATIO and all(map(self._is_even, (means[:k], means[k:])))
        return NoiseChanged(float(self._starts[k]), ratio) if is_change else None

    def _is_even(self, means: Floats) -> bool:
        """Return whether the means of blocks vary no more than those of noise."""
        return bool(means.var(ddof=1) <= _UNEVEN * 2 / (self._size * HOP) * means.mean() ** 2)


def noise_change_message(change: NoiseChanged | None, step_s: float) -> list[str]:
    """Return a sentence with the time and size of the change, and what to do; an empty list without a change."""
    if change is None:
        return []
    louder = "tune again on a record with this noise, or look for what shakes the sensor"
    quieter = "tune again if it stays so; if the machine only rests, nothing is needed"
    return [
        f"From {change.step * step_s:.6g} s on the noise is {change.ratio:.2g} times what it was before:"
        f" {louder if change.ratio > 1 else quieter}."
    ]


# Check that a sensor is surely alive: no window of its innovations is as quiet as a window of a dead sensor.
#
# A monitor tests windows of whole hops. The rows at which hops begin depend on all earlier innovations. Any 64
# innovations in a row include three whole hops (48 innovations), whose sum of squares about their own mean is at most
# that of the window. So if this sum is above the threshold for every three hops in a row, no window can look dead, at
# whichever rows the hops begin.

_WHOLE = WINDOW // HOP - 1
"""Number of whole hops within any 64 innovations in a row."""


class Aliveness:
    """A check that no window of a channel's innovations is as quiet as that of a dead sensor.

    Parameters
    ----------
    dead_variance : float
        Variance of a window, in sigma^2, below which the sensor counts as dead.

    Attributes
    ----------
    sure : bool
        True if no window so far is that quiet, at whichever rows the hops begin.
    """

    def __init__(self, dead_variance: float) -> None:
        self._least, self.sure = dead_variance * (WINDOW - 1) * PARTS**2, True

    def add(self, sums: Integers) -> None:
        """Take sums and sums of squares of consecutive hops, (2, H): up to three earlier hops, then the new ones."""
        count = sums.shape[1] - _WHOLE + 1
        if count > 0 and self._least > 0.0 and self.sure:
            total, squares = np.sum([sums[:, k : k + count] for k in range(_WHOLE)], axis=0)
            self.sure = bool(np.all(squares - total / (_WHOLE * HOP) * total > self._least))


# Delay and false alarms of the cumulative sum (CUSUM), which detects a small lasting shift of white noise.
#
# S_i = max(0, S_{i-1} + x_i - k); when S reaches h there is an alarm, and S restarts at 0 (Page 1954).
# `native/monitor.h` computes S. For noise of mean mu, the mean time to an alarm is
# (exp(-2 d b) + 2 d b - 1) / (2 d^2) with d = mu - k and b = h + 1.166, accurate to a few per cent here. Source:
# Siegmund, Sequential Analysis (1985), chapter 10.

SLACK = 0.5
"""k, in sigma. The sum is optimal for a shift of 2 k."""

_OVERSHOOT = 1.166  # sigma: a discrete random walk overshoots each of the two limits by 0.583


def cusum_delay(threshold: float, shift: float) -> float:
    """Return the mean number of readings until a one-sided sum raises an alarm.

    Parameters
    ----------
    threshold : float
        h, in sigma.
    shift : float
        Mean of the noise, in sigma; 0 gives the mean number of readings between false alarms.
    """
    d, b = shift - SLACK, threshold + _OVERSHOOT
    if d == 0:
        return b * b
    return float((np.exp(-2 * d * b) + 2 * d * b - 1) / (2 * d * d))


def cusum_threshold(readings: float) -> float:
    """Return h, in sigma, for which a two-sided sum raises one false alarm per `readings` readings of white noise."""
    b = 1.0
    for _ in range(60):  # fixed-point iteration b = ln(...) / 2k; it contracts because the slope is below 1 for b > 1
        b = float(np.log(2 * SLACK**2 * 2 * readings + 2 * SLACK * b + 1)) / (2 * SLACK)
    return max(b - _OVERSHOOT, 0.0)


HOPS = "hops"
"""Key in `comparable_state` of the part of the state that matters only if the sensor may be dead."""

NEVER = 1e12
"""Threshold, in sigma, that no cumulative sum reaches."""

_DEAD = 0.05  # largest variance of a dead window, over the expected one; a sensor at rest may have more
_THAN_REST = 0.25  # largest variance of a dead window, over that of the quietest window of a healthy record
_ALARMS = 3  # number of alarms that share the rate of false alarms: drift to either side, and dead sensors


class Alarms(NamedTuple):
    """The thresholds of a monitor of innovations.

    Attributes
    ----------
    drift_threshold : float
        h of the cumulative sum, in sigma; a *small* one detects a drift sooner, with more false alarms.
    dead_variance : float
        Variance of a window, in sigma^2, below which the sensor counts as dead. A *small* one tolerates a sensor at
        rest; 0 switches the alarm off.
    """

    drift_threshold: float
    dead_variance: float = _DEAD

    @property
    def drift_delay(self) -> float:
        """Return the mean number of readings until the monitor detects a shift of one sigma."""
        return cusum_delay(self.drift_threshold, 1.0)

    @property
    def dead_delay(self) -> int:
        """Return the largest number of readings without noise until a sensor counts as dead, if the signal rests."""
        return WINDOW + HOP


NO_ALARMS = Alarms(NEVER, 0.0)
"""Thresholds that no innovation reaches: they switch the monitor off."""


def find_alarms(false_alarms_per_hour: float, step_s: float, healthy: Floats | None = None) -> Alarms:
    """Choose the thresholds for a rate of false alarms on white innovations of variance 1.

    Parameters
    ----------
    false_alarms_per_hour : float
        Largest rate of false alarms of all kinds together; a *small* rate trusts the sensor.
    step_s : float
        One step, in seconds.
    healthy : (N,) float array, optional
        Normalised innovations of a healthy record. A filter tuned on motion expects more noise than a sensor at rest
        has. With this record, a window counts as dead only if it is far quieter than all windows of the record.

    Returns
    -------
    Alarms
        Without a healthy record, `dead_variance` is a twentieth of the expected variance, or less if the rate of
        false alarms requires it.

    Raises
    ------
    UsageError
        If the rate or the step is not above 0.

    Notes
    -----
    The variance of a window about its mean is chi-square with WINDOW - 1 degrees of freedom. Overlapping windows count
    as independent, which only lowers the number of false alarms.
    """
    from scipy.special import gammaincinv

    if not (0 < false_alarms_per_hour < np.inf and 0 < step_s < np.inf):
        raise UsageError(
            f"false_alarms_per_hour = {false_alarms_per_hour!r} and step_s = {step_s!r} came; both must be above 0,"
            " as in find_alarms(1.0, 0.002)."
        )
    readings = max(_ALARMS * 3600 / (step_s * false_alarms_per_hour), 2.0 * WINDOW)
    p, half = HOP / readings, (WINDOW - 1) / 2
    quiet = float(gammaincinv(half, p)) / half
    rest = np.empty(0) if healthy is None else _variances(_window_spreads(_hops_of(healthy)))
    dead = min(_DEAD, quiet, _THAN_REST * float(rest.min(initial=np.inf)))
    return Alarms(cusum_threshold(readings), dead)


class _Watch:
    """A pass over innovations whose state continues from push to push."""

    def __init__(self, drift_threshold: float) -> None:
        self.state, self._settings = new_watched(), np.zeros((), SETTINGS)
        self._settings["drift_threshold"] = int(np.ceil(min(drift_threshold, NEVER) * PARTS))

    def push(self, normalised: Floats, elapsed: Floats, codes: Codes) -> Hops:
        """Take innovations (B,) and the steps before them, write DRIFT into `codes`; return the completed hops."""
        return scan_innovations(self._settings, self.state, input_of(normalised), input_of(elapsed), codes)


def _hops_of(normalised: Floats) -> Integers:
    """Return the sums and the sums of squares of the H hops of a record, (2, H)."""
    rows = len(normalised)
    return np.array(_Watch(NEVER).push(normalised, np.ones(rows), np.zeros(rows, dtype=np.int8))[:2])


def _window_spreads(sums: Integers) -> Integers:
    """Return WINDOW^2 times the mean square of each window about its mean, in parts^2, from hops (2, H)."""
    hops = WINDOW // HOP
    count = max(sums.shape[1] - hops + 1, 0)
    total, squares = sum((sums[:, k : k + count] for k in range(1, hops)), start=sums[:, :count])
    return np.asarray(WINDOW * squares - total**2)


def _variances(spreads: Integers) -> Floats:
    """Return the variance of each window about its mean, in sigma^2."""
    return np.asarray(spreads / float(WINDOW * (WINDOW - 1) * PARTS**2))


class InnovationMonitor:
    """A monitor of the normalised innovations nu / sqrt(S) of one channel, in constant memory.

    A two-sided cumulative sum detects drift; its k = 0.5 is optimal for a shift of one sigma (Page, Biometrika 41
    (1954) 100). The alarm repeats as long as the drift lasts. Innovations show only what the filter does *not* follow.
    A model whose level may move follows a slow drift, such as that of a strain gauge, as if it were signal, and the
    innovations stay white. Only a reference without drift shows it: push (reading - reference) / sigma instead, where
    the reference is a value known at rest (a tare) or a slow second sensor. If the model does not fit, innovations are
    coloured, and there are more false alarms of drift than stated.

    Parameters
    ----------
    alarms : Alarms
        The thresholds.

    Attributes
    ----------
    found : dict
        `FaultCount` of `DRIFT` and of `DEAD`; rows and steps count from the first push.
    history : NoiseHistory
        Mean squares of the innovations over time.
    powers : (up to 32,) float array
        Sums of squares of the innovations in the last hops, in sigma^2.
    aliveness : Aliveness
        The check that the sensor is surely alive.
    """

    def __init__(self, alarms: Alarms) -> None:
        self.alarms = alarms
        self.found: dict[Verdict, FaultCount] = {}
        self.aliveness = Aliveness(alarms.dead_variance)
        self.history = NoiseHistory()
        self.powers = np.empty(0)
        self._watch = _Watch(alarms.drift_threshold)
        self._rows = 0
        self._hops = np.zeros((2, 0), dtype=np.int64)  # sums, and sums of squares, of the last hops
        self._silent = False  # whether the last window was as quiet as that of a dead sensor

    @property
    def drift_since(self) -> int | None:
        """Return the row where the first detected drift began, by the cumulative sum; None without a drift."""
        since = int(self._watch.state["drift_since"])
        return None if since < 0 else since

    def push(self, normalised: Floats, elapsed: Floats | None = None) -> Codes:
        """Take the next innovations and return a verdict for each.

        Parameters
        ----------
        normalised : (B,) float array
            Innovations over their standard deviations; NaN where there is no innovation.
        elapsed : (B,) float array, optional
            Steps since the row before; one by default. Ignored for the very first row.

        Returns
        -------
        (B,) int8 array
            DRIFT, DEAD or USED for each row.

        Raises
        ------
        UsageError
            If there are not as many steps as innovations.
        """
        elapsed = np.ones(len(normalised)) if elapsed is None else elapsed
        require_steps(elapsed, len(normalised))
        elapsed = possible_steps(elapsed)
        codes, open_before = np.zeros(len(normalised), dtype=np.int8), int(self._watch.state["hop_count"])
        now = float(self._watch.state["now"])
        hops = self._watch.push(normalised, elapsed, codes)
        self.history.push(hops.powers, hops.steps)
        self.powers = np.append(self.powers, hops.powers)[-KEPT_HOPS:]
        sums = np.hstack([self._hops, hops[:2]])
        self.aliveness.add(sums)
        silent = self._silences(_window_spreads(sums), len(hops.steps))
        self._hops = sums[:, -(WINDOW // HOP - 1) :].copy()
        if self._silent or silent.any():
            self._mark(codes, np.flatnonzero(~np.isnan(normalised)), open_before, silent)
        for verdict in (Verdict.DRIFT, Verdict.DEAD) if codes.any() else ():
            if len(rows := np.flatnonzero(codes == verdict)):
                self._count(verdict, rows, now, elapsed)
        self._rows += len(codes)
        return codes

    @property
    def is_silent(self) -> bool:
        """Return whether the last window was as quiet as that of a dead sensor."""
        return self._silent

    def set_history(self, innovations: int, rows: int, steps: float) -> None:
        """Set the numbers of earlier innovations, rows and steps; hops and rows then count as in the whole record."""
        state = self._watch.state
        self._rows = state["rows"] = rows
        state["hop_count"], state["now"] = innovations % HOP, steps

    def state_dict(self) -> dict[str, Any]:
        """Return the state that later alarms depend on, as arrays, without the faults detected so far."""
        flags = np.array([self._rows, int(self._silent)])
        watched = {"monitor_state": np.frombuffer(self._watch.state.tobytes(), np.int8)}
        return watched | {"monitor_hops": self._hops, "monitor_told": flags, "monitor_powers": self.powers}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`; raise a ModelError if it does not fit this monitor."""
        state = restored(arrays["monitor_state"], WATCHED)
        hops = arrays["monitor_hops"]
        if (
            state is None
            or hops.dtype != np.int64
            or hops.ndim != 2
            or len(hops) != 2
            or hops.shape[1] > WINDOW // HOP - 1
        ):
            raise ModelError("The innovations in the snapshot are not valid: pass what snapshot() returned.")
        self._watch.state = state
        self._hops, self.powers = arrays["monitor_hops"], arrays["monitor_powers"]
        rows, silent = arrays["monitor_told"].tolist()
        self._rows, self._silent = rows, bool(silent)

    def comparable_state(self) -> dict[str, Floats]:
        """Return only the state that later alarms depend on; `HOPS` matters only if the sensor may be dead."""
        state, never = self._watch.state, self.alarms.drift_threshold >= NEVER
        sums = [] if never else [state["above"], state["below"]]
        hop = [state["hop_count"], state["hop_total"], state["hop_squares"]]
        dead = [float(self.is_silent)]
        return {"alarms": np.array(sums, np.float64), HOPS: np.array([*hop, *np.ravel(self._hops), *dead], np.float64)}

    def _count(self, verdict: Verdict, rows: Integers, now: float, elapsed: Floats) -> None:
        if verdict not in self.found:
            steps = np.append(now, elapsed[0 if self._rows else 1 : rows[0] + 1])
            self.found[verdict] = FaultCount(0, self._rows + int(rows[0]), float(np.cumsum(steps)[-1]))
        before = self.found[verdict]
        self.found[verdict] = before._replace(readings=before.readings + len(rows))

    def _mark(self, codes: Codes, rows: Integers, open_before: int, silent: Booleans) -> None:
        """Write DEAD into the codes of `rows` for which the last complete window was that of a dead sensor."""
        dead = np.append(self._silent, silent)[(open_before + 1 + np.arange(len(rows))) // HOP]
        codes[rows[dead]] = Verdict.DEAD
        self._silent = bool(dead[-1]) if len(dead) else self._silent

    def _silences(self, about: Integers, count: int) -> Booleans:
        """Return for each of the last `count` hops whether the window that ends with it is that of a dead sensor."""
        silent = np.zeros(count, dtype=bool)
        silent[count - len(about) :] = _variances(about) < self.alarms.dead_variance
        return silent
