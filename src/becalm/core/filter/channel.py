"""One channel, causally: measurements and the steps before them in, estimates out, any number of rows at a time.

The filter itself is `native/channel.c`. Rows are processed one after the other, so that a recording gives the same bits
wherever it is cut.
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
from becalm.core.rows import EstimatedRows
from becalm.core.verdict import Verdict
from becalm.native import begin_after, forget_counts, loaded, process, reduced, saved, start


class History(NamedTuple):
    """What went before a run that begins amid a record, as far as its estimates depend on it."""

    reading: float  # the first of all, in unit
    readings: int  # that came
    rows: int
    steps: float  # from the first row to the last of them
    least: float = np.inf  # of the readings, in unit
    most: float = -np.inf


class Estimates(NamedTuple):
    """What a channel makes of B rows."""

    signal: Floats  # (B,) in unit
    sigma: Floats  # (B,) in unit; inf where nothing is known yet, NaN where nothing is estimated
    verdict: Codes  # (B,) values of `Verdict`
    innovation: Floats  # (B,) measurement minus its prediction, in unit; NaN where there is none
    deviation: Floats  # (B,) standard deviation that is expected of it, in unit
    x: Floats  # (B, n) filtered states, where they were asked for, else (B, 0); NaN while nothing determines them

    @classmethod
    def room(cls, rows: int, states: int = 0) -> Estimates:
        """Make room for what is estimated of some rows, and of so many states."""
        signal, sigma, innovation, deviation = np.empty((4, rows))
        return cls(signal, sigma, np.zeros(rows, np.int8), innovation, deviation, np.empty((rows, states)))

    def rows(self, which: slice) -> Estimates:
        """Return some of the rows."""
        signal, sigma, verdict, innovation, deviation, x = self
        return Estimates(signal[which], sigma[which], verdict[which], innovation[which], deviation[which], x[which])

    def outputs(self) -> dict[str, Any]:
        """Return where C writes what it finds."""
        outputs = self._asdict()
        if not self.x.shape[1]:
            del outputs["x"]
        return outputs

    def told(self) -> EstimatedRows:
        """Return what is told of these rows."""
        return EstimatedRows(self.signal, self.sigma, np.empty((0, len(self.signal))), self.verdict)


def log_densities(innovation: Floats, deviation: Floats) -> Floats:
    """Return the log-likelihood (B,) of measurements, given those before; NaN where there is none."""
    with np.errstate(over="ignore"):  # of a reading beyond all others nothing is left of its density
        densities: Floats = -0.5 * (innovation / deviation) ** 2 - np.log(deviation) - 0.5 * np.log(2 * np.pi)
    return densities


def parts_of(component: Component, found: Estimates) -> Floats:
    """Return the share (p, B) of each part of a signal whose states were asked for; the first holds the level."""
    parts = np.array([output[0] @ found.x.T for _, output in component.outputs()])
    if len(parts) == 1:
        return found.signal[np.newaxis]
    parts[0] += found.signal - component.signal_output[0] @ found.x.T
    return parts


class Channel:
    """A causal filter of one channel.

    Parameters
    ----------
    settings : ChannelSettings
        What it is made of.

    Raises
    ------
    ModelError
        If it cannot start from measurements alone.
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
            What is wrong with the time of each row, as `Verdict`; by default nothing.
        states : bool
            Whether the filtered states are wanted, too.

        Returns
        -------
        Estimates
            Of each row.

        Raises
        ------
        ValueError
            If there is not one step, 0 or more, for each measurement, if they are not contiguous float64, or if timing
            holds what is no `Verdict`.
        """
        found = Estimates.room(len(z), int(self._settings["states"]) if states else 0)
        if timing is not None:
            if not np.isin(timing, list(Verdict)).all():
                raise ValueError("timing holds what is no Verdict.")
            found.verdict[:] = timing
        rows = found.outputs() | self._steps.before(elapsed) | {"z": z, "elapsed": elapsed}
        process(self._settings, self._coefficients, self._state, **rows)
        return found

    @property
    def counts(self) -> dict[Verdict, int]:
        """Count of each verdict so far."""
        return dict(zip(Verdict, self._state["counts"].tolist(), strict=True))

    @property
    def faults(self) -> dict[Verdict, FaultCount]:
        """What was wrong with measurements, or with their times, whatever was estimated there."""
        met, rows, steps = (self._state[name].tolist() for name in ("met", "first_row", "first_step"))
        return {verdict: FaultCount(met[verdict], rows[verdict], steps[verdict]) for verdict in Verdict if met[verdict]}

    @property
    def timing_share(self) -> float:
        """The largest share that uncertain times have added to sigma."""
        return float(self._state["timing_share"])

    @property
    def powers(self) -> Floats:
        """The sums of squares of the last hops of innovations, in sigma^2, in no order."""
        powers: Floats = self._state["powers"][: int(self._state["hops"])].copy()
        return powers

    @property
    def drift_since(self) -> int | None:
        """The row in which the first drift that was found began."""
        since = int(self._state["drift_since"])
        return None if since < 0 else since

    @property
    def settled_row(self) -> int | None:
        """The first row that was filtered with a settled gain."""
        row = int(self._state["settled_row"])
        return None if row < 0 else row

    @property
    def is_silent(self) -> bool:
        """Whether the last window of innovations was that of a dead sensor."""
        return bool(self._state["silent"])

    def begin_after(self, before: History) -> None:
        """Say, before the first row, what went before it."""
        begin_after(
            self._settings,
            self._coefficients,
            self._state,
            first=before.reading,
            rows=before.rows,
            steps=before.steps,
            least=before.least,
            most=before.most,
        )

    def forget_counts(self) -> None:
        """Count verdicts and faults from 0 again, and find anew when the gain settles."""
        forget_counts(self._state)

    def comparable_state(self) -> dict[str, Codes]:
        """Return only what later estimates depend on: two channels that stand alike estimate alike, to the bit.

        Under `HOPS` there is what only matters to a sensor that may be dead.
        """
        alive, whole = (reduced(self._settings, self._state, alive=alive).tobytes() for alive in (True, False))
        return {"channel": np.frombuffer(alive, np.int8), HOPS: np.frombuffer(whole, np.int8)}

    def state_dict(self) -> dict[str, Codes]:
        """Return all that later rows depend on, as plain bytes."""
        return {"state": saved(self._settings, self._state)}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `state_dict` returned.

        Raises
        ------
        ModelError
            If these are not the bytes of such a channel.
        KeyError
            If there is no "state" among them.
        """
        self._state = loaded(self._settings, np.asarray(arrays["state"]))
