"""Whether innovations stay what they should be, white noise of variance 1: drift, a dead sensor, a change of noise.

Innovations are counted in whole parts of a sigma, so that all sums are exact: the alarms are those of the whole
record wherever it is cut. One pass makes the sums of hops; what follows looks at hops alone, as long as all is well.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Codes, Floats, Integers, input_of
from becalm.core.health.aliveness import Aliveness
from becalm.core.health.cusum import cusum_delay, cusum_threshold
from becalm.core.health.faults import FaultCount, require_steps
from becalm.core.health.noise_change import NoiseHistory
from becalm.core.verdict import Verdict
from becalm.errors import ModelError, UsageError
from becalm.native.rows import SETTINGS
from becalm.native.scans import HOP, KEPT_HOPS, PARTS, WATCHED, WINDOW, Hops, new_watched, restored, scan_innovations

HOPS = "hops"
"""Key in `comparable_state` of what matters only to a channel that may be dead."""

NEVER = 1e12
"""Threshold, in sigma, that no cumulative sum reaches."""

_DEAD = 0.05  # of the variance that was expected; what is quieter than chance but above only rests
_THAN_REST = 0.25  # of the quietest window of a healthy record
_ALARMS = 3  # of drift to either side, and of death: each gets its share of the false alarms


class Alarms(NamedTuple):
    """Where innovations stop being noise of variance 1.

    Attributes
    ----------
    drift_threshold : float
        h of the cumulative sum, in sigma; a *small* one finds a drift sooner, and more that are none.
    dead_variance : float
        Variance of a window below which the channel is dead; a *small* one lets it rest, 0 never calls it dead.
    """

    drift_threshold: float
    dead_variance: float = _DEAD

    @property
    def drift_delay(self) -> float:
        """Readings that a shift of one sigma lasts, on average, until it is told."""
        return cusum_delay(self.drift_threshold, 1.0)

    @property
    def dead_delay(self) -> int:
        """Readings without noise, at most, until the channel is told to be dead; the filter must be at rest."""
        return WINDOW + HOP


NO_ALARMS = Alarms(NEVER, 0.0)
"""Thresholds that no innovation reaches: nothing is watched."""


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
    """The one pass over innovations that go on from push to push."""

    def __init__(self, drift_threshold: float) -> None:
        self.state, self._settings = new_watched(), np.zeros((), SETTINGS)
        self._settings["drift_threshold"] = int(np.ceil(min(drift_threshold, NEVER) * PARTS))

    def push(self, normalised: Floats, elapsed: Floats, codes: Codes) -> Hops:
        """Take innovations (B,) and the steps before them, write DRIFT into their codes; return the hops that ended."""
        return scan_innovations(self._settings, self.state, input_of(normalised), input_of(elapsed), codes)


def _hops_of(normalised: Floats) -> Integers:
    """Return the sums, and the sums of squares, of the hops of a whole record: (2, H)."""
    rows = len(normalised)
    return np.array(_Watch(NEVER).push(normalised, np.ones(rows), np.zeros(rows, dtype=np.int8))[:2])


def _window_spreads(sums: Integers) -> Integers:
    """Return WINDOW^2 times the variance of each window of hops (2, H), in parts^2; none where hops are too few."""
    hops = WINDOW // HOP
    count = max(sums.shape[1] - hops + 1, 0)
    total, squares = sum((sums[:, k : k + count] for k in range(1, hops)), start=sums[:, :count])
    return np.asarray(WINDOW * squares - total**2)


def _variances(spreads: Integers) -> Floats:
    """Return variances about the mean of a window, in sigma^2."""
    return np.asarray(spreads / float(WINDOW * (WINDOW - 1) * PARTS**2))


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
        `FaultCount` of `DRIFT` and `DEAD`; rows are counted as they came.
    history : NoiseHistory
        How large the innovations were, and when.
    powers : (up to 32,) float array
        Sums of squares of the last hops of 16 innovations, in sigma^2.
    aliveness : Aliveness
        Whether no window can have been dead, wherever hops begin.
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
        self._silent = False  # whether the last window was that of a dead channel

    @property
    def drift_since(self) -> int | None:
        """The row in which the drift that was told first began, as far as the sum tells."""
        since = int(self._watch.state["drift_since"])
        return None if since < 0 else since

    def push(self, normalised: Floats, elapsed: Floats | None = None) -> Codes:
        """Take innovations and tell what is wrong with them.

        Parameters
        ----------
        normalised : (B,) float array
            The next ones, over their standard deviations; NaN where there is none.
        elapsed : (B,) float array, optional
            Steps since the row before; one by default. Not looked at for the first row of all.

        Returns
        -------
        (B,) int8 array
            DRIFT, DEAD or USED for each.

        Raises
        ------
        UsageError
            If there are not as many steps as innovations.
        """
        elapsed = np.ones(len(normalised)) if elapsed is None else elapsed
        require_steps(elapsed, len(normalised))
        codes, open_before = np.zeros(len(normalised), dtype=np.int8), int(self._watch.state["hop_count"])
        begun = float(self._watch.state["now"])
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
                self._count(verdict, rows, begun, elapsed)
        self._rows += len(codes)
        return codes

    @property
    def is_silent(self) -> bool:
        """Whether the last window was that of a dead channel."""
        return self._silent

    def begin_after(self, innovations: int, rows: int, steps: float) -> None:
        """Say how much went before what will come, so that hops end, and rows are counted, as in the whole."""
        state = self._watch.state
        self._rows = state["rows"] = rows
        state["hop_count"], state["now"] = innovations % HOP, steps

    def saved(self) -> dict[str, Any]:
        """Return what alarms depend on, as arrays; what was found so far is not among it."""
        told = np.array([self._rows, int(self._silent)])
        watched = {"monitor_state": np.frombuffer(self._watch.state.tobytes(), np.int8)}
        return watched | {"monitor_hops": self._hops, "monitor_told": told, "monitor_powers": self.powers}

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned; raises a ModelError if it is not that of such a channel."""
        state = restored(arrays["monitor_state"], WATCHED)
        hops = arrays["monitor_hops"]
        if (
            state is None
            or hops.dtype != np.int64
            or hops.ndim != 2
            or len(hops) != 2
            or hops.shape[1] > WINDOW // HOP - 1
        ):
            raise ModelError("What a snapshot remembers of innovations is not valid: pass what snapshot() returned.")
        self._watch.state = state
        self._hops, self.powers = arrays["monitor_hops"], arrays["monitor_powers"]
        rows, silent = arrays["monitor_told"].tolist()
        self._rows, self._silent = rows, bool(silent)

    def comparable_state(self) -> dict[str, Floats]:
        """Return what later alarms depend on and nothing else; under `HOPS` what only matters to a dead channel."""
        state, never = self._watch.state, self.alarms.drift_threshold >= NEVER
        sums = [] if never else [state["above"], state["below"]]
        hop = [state["hop_count"], state["hop_total"], state["hop_squares"]]
        dead = [float(self.is_silent)]
        return {"alarms": np.array(sums, np.float64), HOPS: np.array([*hop, *np.ravel(self._hops), *dead], np.float64)}

    def _count(self, verdict: Verdict, rows: Integers, begun: float, elapsed: Floats) -> None:
        if verdict not in self.found:
            steps = np.append(begun, elapsed[0 if self._rows else 1 : rows[0] + 1])
            self.found[verdict] = FaultCount(0, self._rows + int(rows[0]), float(np.cumsum(steps)[-1]))
        before = self.found[verdict]
        self.found[verdict] = before._replace(readings=before.readings + len(rows))

    def _mark(self, codes: Codes, rows: Integers, open_before: int, silent: Booleans) -> None:
        """Write DEAD where the last whole window was that of a dead channel when an innovation came, in these rows."""
        said = np.append(self._silent, silent)[(open_before + 1 + np.arange(len(rows))) // HOP]
        codes[rows[said]] = Verdict.DEAD
        self._silent = bool(said[-1]) if len(said) else self._silent

    def _silences(self, about: Integers, count: int) -> Booleans:
        """Return whether the windows that end with the last hops (count,) are those of a dead channel."""
        silent = np.zeros(count, dtype=bool)
        silent[count - len(about) :] = _variances(about) < self.alarms.dead_variance
        return silent
