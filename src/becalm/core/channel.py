"""One channel, causally: measurements and the steps before them in, estimates out, any number of rows at a time.

The filter itself is `native/channel.c`. Rows are processed one after the other, so that a recording gives the same bits
wherever it is cut.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Codes, Floats
from becalm.core.components import Component
from becalm.core.faults import Found
from becalm.core.gates import Gate, level_of
from becalm.core.limits import Limits
from becalm.core.monitor import NEVER, Alarms
from becalm.core.possible import largest_beside
from becalm.core.reach import reach_of
from becalm.core.standing import HOPS, Before
from becalm.core.starting import known_before, refuse_singular, root_of
from becalm.core.steps import Steps
from becalm.core.timeline import model_system
from becalm.core.told import Told
from becalm.core.verdict import Verdict
from becalm.errors import ModelError
from becalm.native import (
    COEFFICIENTS,
    MOST_STATES,
    SETTINGS,
    STATE,
    begin_after,
    forget_counts,
    is_sound,
    process,
    reduced,
    smooth,
    start,
)

_PARTS = 1 << 16  # of a sigma, that the monitor counts in
_ENDLESS = 1 << 53  # equal measurements in a row: no stream has so many


class Widening(NamedTuple):
    """What makes the sigma of a signal larger than its filter's: by a share, by times, and by a calibration."""

    factor: float = 1.0
    time_std_s: float | None = None  # standard uncertainty of a measurement's time
    included_std: float = 0.0  # what of it the noise holds already
    calibration: tuple[float, float] | None = None  # standard uncertainties of sensitivity, as a share, and of zero


class Settings(NamedTuple):
    """What a recipe says of one channel."""

    component: Component  # in steps
    noise_variance: float  # R, in unit^2
    step_s: float
    limits: Limits
    alarms: Alarms
    gate: Gate | None = None
    widening: Widening = Widening()
    unknown_from: float = np.inf  # sigma from which on a row without a measurement is a hole, in unit

    @property
    def disturbed(self) -> bool:
        """Whether its signal is less than what is measured."""
        return any(part.disturbance for part in self.component.parts)


class Estimates(NamedTuple):
    """What a channel makes of B rows."""

    signal: Floats  # (B,) in unit
    sigma: Floats  # (B,) in unit; inf where nothing is known yet, NaN where nothing is estimated
    verdict: Codes  # (B,) values of `Verdict`
    innovation: Floats  # (B,) measurement minus its prediction, in unit; NaN where there is none
    deviation: Floats  # (B,) standard deviation that is expected of it, in unit
    x: Floats  # (B, n) filtered states, where they were asked for, else (B, 0); NaN while nothing determines them

    def told(self) -> Told:
        """Return what is told of these rows."""
        return Told(self.signal, self.sigma, np.empty((0, len(self.signal))), self.verdict)


class Channel:
    """A causal filter of one channel.

    Parameters
    ----------
    settings : Settings
        What it is made of.

    Raises
    ------
    ModelError
        If it cannot start from measurements alone.
    """

    def __init__(self, settings: Settings) -> None:
        self._steps = StepTable(settings.component)
        self._settings, self._coefficients = _packed(settings), _coefficients(settings)
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
        found = _empty_estimates(len(z), int(self._settings["states"]) if states else 0)
        if timing is not None:
            if not np.isin(timing, list(Verdict)).all():
                raise ValueError("timing holds what is no Verdict.")
            found.verdict[:] = timing
        rows = _outputs(found) | self._steps.before(elapsed) | {"z": z, "elapsed": elapsed}
        process(self._settings, self._coefficients, self._state, **rows)
        return found

    @property
    def counts(self) -> dict[Verdict, int]:
        """Count of each verdict so far."""
        return dict(zip(Verdict, self._state["counts"].tolist(), strict=True))

    @property
    def faults(self) -> dict[Verdict, Found]:
        """What was wrong with measurements, or with their times, whatever was estimated there."""
        met, rows, steps = (self._state[name].tolist() for name in ("met", "first_row", "first_step"))
        return {verdict: Found(met[verdict], rows[verdict], steps[verdict]) for verdict in Verdict if met[verdict]}

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

    def begin_after(self, before: Before) -> None:
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

    def standing(self) -> dict[str, Codes]:
        """Return only what later estimates depend on: two channels that stand alike estimate alike, to the bit.

        Under `HOPS` there is what only matters to a sensor that may be dead.
        """
        alive, whole = (reduced(self._settings, self._state, alive=alive).tobytes() for alive in (True, False))
        return {"channel": np.frombuffer(alive, np.int8), HOPS: np.frombuffer(whole, np.int8)}

    def state_dict(self) -> dict[str, Codes]:
        """Return all that later rows depend on, as plain bytes."""
        return {"state": np.frombuffer(self._state.tobytes(), np.int8)}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `state_dict` returned.

        Raises
        ------
        ModelError
            If these are not the bytes of such a channel.
        KeyError
            If there is no "state" among them.
        """
        state = np.asarray(arrays["state"])
        if state.dtype != np.int8 or state.shape != (STATE.itemsize,):
            raise ModelError(f"The state of a snapshot is {state.dtype} of shape {state.shape}, not that of a channel.")
        loaded = np.frombuffer(bytearray(state.tobytes()), STATE).reshape(())
        if not is_sound(self._settings, loaded):
            raise ModelError("The state of a snapshot says what none can say; pass what snapshot() returned.")
        self._state = loaded


class StepTable:
    """The matrices of steps, for the kernel.

    Parameters
    ----------
    component : Component
        In steps.
    """

    def __init__(self, component: Component) -> None:
        self._steps, self._in_steps = Steps(component), component.goes_in_steps
        self._lengths, self._matrices = np.ones(1), self._steps.over(np.ones(1))

    def before(self, elapsed: Floats) -> dict[str, NDArray[np.int32] | Floats]:
        """Return which step each of some rows follows, and the matrices of these steps; those of the last are kept."""
        lengths, step = elapsed[:1], np.zeros(len(elapsed), np.int32)
        if not (elapsed == lengths).all():
            lengths, rows = np.unique(elapsed, return_inverse=True)
            step = rows.astype(np.int32)
        if not np.array_equal(lengths, self._lengths) and len(lengths):
            wanted = np.round(lengths) if self._in_steps else lengths  # the nearest: no stream ends by a late row
            self._lengths, self._matrices = lengths.copy(), self._steps.over(wanted)
        F, Q = self._matrices
        return {"step": step, "F": F, "Q": Q}


def smooth_record(settings: Settings, z: Floats, elapsed: Floats) -> Estimates:
    """Smooth a record of one channel: each estimate knows all of its rows.

    Parameters
    ----------
    settings : Settings
        What the channel is made of; its limits, gate and alarms are not looked at.
    z : (N,) float array
        Measurements that may enter, in unit; NaN elsewhere.
    elapsed : (N,) float array
        Steps since the row before.

    Returns
    -------
    Estimates
        Of each row; innovations are those of the pass forward.

    Raises
    ------
    ModelError
        If the channel cannot start from measurements alone.

    Notes
    -----
    Bryson and Frazier (1963), Bierman (1973); equations (9) to (12) of `becalm.core.reference`.
    """
    packed, found = _packed(settings._replace(gate=None)), _empty_estimates(len(z))
    steps = StepTable(settings.component).before(elapsed)
    smooth(packed, _coefficients(settings), **_outputs(found), **steps, z=z, elapsed=elapsed)
    return found


def _empty_estimates(rows: int, states: int = 0) -> Estimates:
    signal, sigma, innovation, deviation = np.empty((4, rows))
    return Estimates(signal, sigma, np.zeros(rows, np.int8), innovation, deviation, np.empty((rows, states)))


def _outputs(found: Estimates) -> dict[str, Any]:
    """Return where C writes what it finds."""
    outputs = found._asdict()
    if not found.x.shape[1]:
        del outputs["x"]
    return outputs


def _packed(settings: Settings) -> NDArray[np.void]:
    limits, gate, widening = settings.limits, settings.gate, settings.widening
    outliers, reach = limits.outliers, reach_of(settings.component, settings.noise_variance)
    timed, calibrated = widening.time_std_s is not None, widening.calibration is not None
    values = {
        "states": len(settings.component.drift),
        "low": limits.low,
        "high": limits.high,
        "largest": limits.largest,
        "largest_accepted": largest_beside(settings.noise_variance),
        "stuck": min(limits.stuck_readings or 0, _ENDLESS),
        "outlier_distance": outliers.causal_distance,
        "plausible_low": outliers.low,
        "plausible_high": outliers.high,
        "repeats_are_one": outliers.repeats_are_one,
        "blank": outliers.blank,
        "longest_gap": reach.longest,
        "gap_spans": reach.spans,
        "gap_measurements": reach.readings,
        "gated": gate is not None,
        "gate_threshold": gate.threshold if gate else np.inf,
        "gate_agree": gate.agree if gate else 0,
        "gate_most": gate.at_most if gate else 0,
        "gate_level": level_of(settings.component.to_model(1.0, settings.noise_variance)) if gate else -1,
        "drift_threshold": int(np.ceil(min(settings.alarms.drift_threshold, NEVER) * _PARTS)),
        "dead_variance": settings.alarms.dead_variance,
        "timed": timed,
        "step_s": settings.step_s,
        "time_std_s": widening.time_std_s if timed else 0.0,
        "time_variance": widening.included_std**2,
        "factor": widening.factor,
        "calibrated": calibrated,
        "relative_std": widening.calibration[0] if widening.calibration else 0.0,
        "offset_std": widening.calibration[1] if widening.calibration else 0.0,
        "unknown_from": settings.unknown_from,
    }
    packed = np.zeros((), SETTINGS)
    assert set(values) == set(SETTINGS.names or ()), "every field of the kernel's settings is filled in"
    for name, value in values.items():
        packed[name] = value
    return packed


def _coefficients(settings: Settings) -> NDArray[np.void]:
    component = settings.component
    model = component.to_model(1.0, settings.noise_variance)
    refuse_singular(model_system(model))
    n = model.states
    if n > MOST_STATES:
        raise ModelError(f"A channel has up to {MOST_STATES} states; this one has {n}. Leave a tone out.")
    coefficients = np.zeros((), COEFFICIENTS)
    coefficients["h"][:n] = model.H[0]
    coefficients["c"][:n] = (component.signal_output if settings.disturbed else component.output)[0]
    coefficients["R"] = model.R[0, 0]
    coefficients["prior"][: n * n] = root_of(known_before(model).Y).ravel()
    coefficients["keeps_level"], coefficients["disturbed"] = component.keeps_level, settings.disturbed
    return coefficients
