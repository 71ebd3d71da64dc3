"""Filter one channel causally, block by block; a block has any number of rows.

The filter itself is `native/channel.c`. It processes one row after the other, so that the boundaries between blocks
change no bit of the result.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.filter.channel_settings import ChannelSettings, StepTable, packed_coefficients, packed_settings
from becalm.core.health.faults import FaultCount
from becalm.core.health.monitor import HOPS
from becalm.core.model.components import Component
from becalm.core.model.parts import largest_magnitude_for_noise
from becalm.core.reading_verdicts import Verdict
from becalm.core.rows import EstimatedRows
from becalm.native import loaded, process, reduced, reset_counts, saved, score, set_history, start
from becalm.native.library import SETTINGS
from becalm.native.smoothers import Smoother

# The terms of a log-likelihood, summed over parts of a record.


class Sums(NamedTuple):
    """The terms of a log-likelihood, summed over readings."""

    squares: float = 0.0  # sum of nu' S^-1 nu
    log_det: float = 0.0  # sum of log det S
    used: int = 0  # number of readings

    @property
    def log_likelihood(self) -> float:
        """Return the Gaussian log-likelihood of the readings used, equation (8)."""
        return float(-0.5 * (self.squares + self.log_det + self.used * np.log(2 * np.pi)))

    def plus(self, other: Sums) -> Sums:
        """Return the sums over the readings of both objects."""
        return Sums(self.squares + other.squares, self.log_det + other.log_det, self.used + other.used)


class History(NamedTuple):
    """A summary of the earlier rows of a record, for a run that starts in the middle of it."""

    reading: float  # the first reading of the record, in unit
    readings: int  # number of readings that arrived
    rows: int  # number of rows
    steps: float  # time from the first earlier row to the last, in steps
    least: float = np.inf  # smallest reading, in unit
    most: float = -np.inf  # largest reading, in unit


class Estimates(NamedTuple):
    """The estimates of a channel for B rows."""

    signal: Floats  # (B,) in unit
    sigma: Floats  # (B,) in unit; inf while the signal is undetermined, NaN where there is no estimate
    verdict: Codes  # (B,) values of `Verdict`
    innovation: Floats  # (B,) measurement minus its prediction, in unit; NaN where there is none
    deviation: Floats  # (B,) expected standard deviation of the innovation, in unit
    x: Floats  # (B, n) filtered states if requested, else (B, 0); NaN while they are undetermined

    @classmethod
    def allocate(cls, rows: int, states: int = 0) -> Estimates:
        """Allocate arrays for this many rows and states."""
        signal, sigma, innovation, deviation = np.empty((4, rows))
        return cls(signal, sigma, np.zeros(rows, np.int8), innovation, deviation, np.empty((rows, states)))

    def rows(self, which: slice) -> Estimates:
        """Return the estimates of a slice of the rows."""
        signal, sigma, verdict, innovation, deviation, x = self
        return Estimates(signal[which], sigma[which], verdict[which], innovation[which], deviation[which], x[which])

    def outputs(self) -> dict[str, Any]:
        """Return the arrays that the C filter writes to, by name."""
        outputs = self._asdict()
        if not self.x.shape[1]:
            del outputs["x"]
        return outputs

    def to_rows(self) -> EstimatedRows:
        """Return signal, sigma and verdict as `EstimatedRows`, without parts."""
        return EstimatedRows(self.signal, self.sigma, np.empty((0, len(self.signal))), self.verdict)


def log_densities(innovation: Floats, deviation: Floats) -> Floats:
    """Return the log-likelihood (B,) of each measurement, given the earlier ones; NaN where there is no innovation."""
    with np.errstate(over="ignore"):  # the square of an extreme innovation overflows: its density is 0
        densities: Floats = -0.5 * (innovation / deviation) ** 2 - np.log(deviation) - 0.5 * np.log(2 * np.pi)
    return densities


def parts_of(component: Component, estimates: Estimates) -> Floats:
    """Return the contribution (p, B) of each part of the component; that of the first part includes the level.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    estimates : Estimates
        Estimates of B rows, with their states `x`.
    """
    parts = np.array([output[0] @ estimates.x.T for _, output in component.outputs()])
    if len(parts) == 1:
        return estimates.signal[np.newaxis]
    parts[0] += estimates.signal - component.signal_output[0] @ estimates.x.T
    return parts


class Channel:
    """A causal filter of one channel.

    Parameters
    ----------
    settings : ChannelSettings
        The model, the noise, the limits and the gate.

    Raises
    ------
    ModelError
        If the filter cannot start from measurements alone.
    """

    def __init__(self, settings: ChannelSettings) -> None:
        self._steps = StepTable(settings.component)
        self._settings = packed_settings(settings)
        self._coefficients = packed_coefficients(
            settings.component, settings.noise_variance, disturbed=settings.disturbed
        )
        self._state = start(self._settings)

    def process(self, z: Floats, elapsed: Floats, timing: Codes | None = None, *, states: bool = False) -> Estimates:
        """Process a block of rows.

        Parameters
        ----------
        z : (B,) float array
            Measurements, in unit; NaN where missing.
        elapsed : (B,) float array
            Steps since the row before.
        timing : (B,) int8 array, optional
            A `Verdict` on the time of each row; by default no time has a fault.
        states : bool
            Whether to return also the filtered states.

        Returns
        -------
        Estimates
            The estimates of the B rows.

        Raises
        ------
        ValueError
            If there is not one step, 0 or more, for each measurement, if the arrays are not contiguous float64, or if
            `timing` holds a value that is not a `Verdict`.
        """
        estimates = Estimates.allocate(len(z), int(self._settings["states"]) if states else 0)
        if timing is not None:
            if not np.isin(timing, list(Verdict)).all():
                raise ValueError("timing holds a value that is not a Verdict; pass values of Verdict.")
            estimates.verdict[:] = timing
        rows = estimates.outputs() | self._steps.before(elapsed) | {"z": z, "elapsed": elapsed}
        process(self._settings, self._coefficients, self._state, **rows)
        return estimates

    @property
    def counts(self) -> dict[Verdict, int]:
        """Return how often each verdict was given so far."""
        return dict(zip(Verdict, self._state["counts"].tolist(), strict=True))

    @property
    def faults(self) -> dict[Verdict, FaultCount]:
        """Return the faults of measurements and of their times, by verdict; they do not depend on the estimates."""
        met, rows, steps = (self._state[name].tolist() for name in ("met", "first_row", "first_step"))
        return {verdict: FaultCount(met[verdict], rows[verdict], steps[verdict]) for verdict in Verdict if met[verdict]}

    @property
    def timing_share(self) -> float:
        """Return the largest relative increase of sigma by uncertain times."""
        return float(self._state["timing_share"])

    @property
    def powers(self) -> Floats:
        """Return the sums of squared innovations over the last hops, in sigma^2, in any order."""
        powers: Floats = self._state["powers"][: int(self._state["hops"])].copy()
        return powers

    @property
    def drift_since(self) -> int | None:
        """Return the row where the first detected drift began; None without a drift."""
        since = int(self._state["drift_since"])
        return None if since < 0 else since

    @property
    def settled_row(self) -> int | None:
        """Return the first row with the steady-state gain; None if there is none yet."""
        row = int(self._state["settled_row"])
        return None if row < 0 else row

    @property
    def is_silent(self) -> bool:
        """Return whether the last window of innovations was as quiet as that of a dead sensor."""
        return bool(self._state["silent"])

    def set_history(self, before: History) -> None:
        """Set the history before the first row, for a run that starts in the middle of a record."""
        set_history(
            self._settings,
            self._coefficients,
            self._state,
            first=before.reading,
            rows=before.rows,
            steps=before.steps,
            least=before.least,
            most=before.most,
        )

    def reset_counts(self) -> None:
        """Reset the counts of verdicts and faults, and the row at which the gain settles."""
        reset_counts(self._state)

    def comparable_state(self) -> dict[str, Codes]:
        """Return the part of the state that determines all later estimates, bit for bit.

        The entry `HOPS` holds the complete state, including the part that matters only if the sensor may be dead.
        """
        if_alive, complete = (reduced(self._settings, self._state, alive=alive).tobytes() for alive in (True, False))
        return {"channel": np.frombuffer(if_alive, np.int8), HOPS: np.frombuffer(complete, np.int8)}

    def state_dict(self) -> dict[str, Codes]:
        """Return the state that later estimates depend on, as plain bytes."""
        return {"state": saved(self._settings, self._state)}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the state from the result of `state_dict`.

        Raises
        ------
        ModelError
            If the bytes are not the state of a channel with these settings.
        KeyError
            If the entry "state" is missing.
        """
        self._state = loaded(self._settings, np.asarray(arrays["state"]))


# Filter or smooth a complete record of one channel, or compute its likelihood, with the C kernel.
#
# The smoother is that of Bryson and Frazier (1963) in Bierman's form (1973), equations (9) to (12) of
# `becalm.core.reference.kalman`; the likelihood is equation (8).


class ChannelRecord:
    """A complete record of one channel, without limits on measurements and gaps.

    Parameters
    ----------
    component : Component
        The model, in steps; the signal includes all disturbances.
    noise_variance : float
        R, in unit^2.
    z : (N,) float array
        Measurements, in unit; NaN where missing.
    elapsed : (N,) float array
        Steps since the row before; ignored for the first row.

    Raises
    ------
    ModelError
        If the filter cannot start from measurements alone, or the model has coloured noise and a step is not whole.
    """

    def __init__(self, component: Component, noise_variance: float, z: Floats, elapsed: Floats) -> None:
        even = np.concatenate([elapsed[1:2], elapsed[1:]]) if len(elapsed) > 1 else np.ones(len(elapsed))
        lengths, step = np.unique(even, return_inverse=True)
        F, Q = component.over(lengths if len(lengths) else np.ones(1))
        self._rows: dict[str, Any] = {
            "z": np.ascontiguousarray(z),
            "elapsed": even,
            "step": step.astype(np.int32),
            "F": F,
            "Q": Q,
        }
        self._coefficients = packed_coefficients(component, noise_variance, disturbed=False)
        self._settings = np.zeros((), SETTINGS)
        self._settings["states"] = len(component.drift)
        self._settings["longest_gap"] = self._settings["gap_spans"] = np.inf
        self._settings["largest_accepted"] = largest_magnitude_for_noise(noise_variance)

    @property
    def process_noise(self) -> Floats:
        """Return Q (u, n, n) for the u different step lengths of the record."""
        return np.asarray(self._rows["Q"])

    def filtered(self) -> Estimates:
        """Return the filtered estimates: each row uses the measurements up to its own."""
        estimates = Estimates.allocate(len(self._rows["z"]))
        Smoother(self._settings, self._coefficients).forward(ends=True, **estimates.outputs(), **self._rows)
        return estimates

    def smoothed(self, process_noise: Floats | None = None) -> Estimates:
        """Return the smoothed estimates: each row uses all measurements. The innovations are those of the filter.

        Parameters
        ----------
        process_noise : (u, n, n) float array, optional
            Process noise to use in place of that of the component.
        """
        estimates, smoother = Estimates.allocate(len(self._rows["z"])), Smoother(self._settings, self._coefficients)
        forward_pass = smoother.forward(ends=True, **estimates.outputs(), **self._with(process_noise))
        smoother.backward(forward_pass, smoother.no_later_rows())
        return estimates

    def score(self, scored_from: int, process_noise: Floats | None = None) -> Sums:
        """Return the terms of the log-likelihood, summed over the rows from `scored_from` on that have a prediction.

        Parameters
        ----------
        scored_from : int
            The first row that counts; earlier rows only start the filter.
        process_noise : (u, n, n) float array, optional
            Process noise to use in place of that of the component.
        """
        return Sums(*score(self._settings, self._coefficients, scored_from, **self._with(process_noise)))

    def _with(self, process_noise: Floats | None) -> dict[str, Any]:
        return self._rows if process_noise is None else self._rows | {"Q": process_noise}
