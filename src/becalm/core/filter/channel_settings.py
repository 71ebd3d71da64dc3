"""The settings and coefficients of one channel, and their form for the C kernel."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import Floats
from becalm.core.filter.gate import Gate, level_of
from becalm.core.health.limits import Limits
from becalm.core.health.monitor import NEVER, NO_ALARMS, Alarms
from becalm.core.model.components import Component
from becalm.core.model.model import Model
from becalm.core.model.parts import largest_magnitude_for_noise
from becalm.core.model.prior import flat_prior, refuse_singular, root_of
from becalm.core.model.step_matrices import StepMatrices, model_system
from becalm.errors import ModelError
from becalm.native.library import COEFFICIENTS, MOST_STATES
from becalm.native.scans import PARTS

# Find the longest gap that a filter may bridge before float64 loses the information from before the gap.
#
# Across a gap of T steps the predicted variance of a kinematic model of order n grows as q T^(2n-1); the part that
# comes from the first readings grows as (T / L)^(2n-2), where L is the time that these readings span. The first
# reading after the gap reduces the variance to about R in one update. If the predicted variance is too many times R,
# the difference has no correct digit left. In that case the readings before the gap have almost no information on
# the signal after it, so that a filter that restarts after the gap loses almost nothing.

_FORGOTTEN = 1e15  # largest predicted variance over R; from 1e18 on smoothers lose all digits
_CARRIED = 1e13  # largest part of it that comes from the first readings, over R; from 1e14 on it has no digits
_LENGTHS = np.ldexp(1.0, np.arange(53))  # lengths of gaps, in whole steps, which coloured noise needs
_LEAST = 2.0  # least longest gap, in steps: two rows one step apart are no gap, even with large process noise


class GapLimit(NamedTuple):
    """The longest gaps that a filter may bridge. A gap is the time between two readings that arrived."""

    longest: float  # in steps
    spans: float = np.inf  # longest gap over the time from the first to the last earlier reading
    readings: int = 1  # number of readings that determine the state; from then on `spans` applies


@lru_cache(maxsize=256)
def gap_limit_of(component: Component, noise_variance: float) -> GapLimit:
    """Return the gap limit of a component's filter.

    Parameters
    ----------
    component : Component
        The signal's model, in steps; its first part is the motion.
    noise_variance : float
        R, in unit^2; with a *small* one the filter bridges fewer gaps.

    Notes
    -----
    The highest coefficient of a polynomial of degree d = n - 1, fitted to m >= n readings at even times over the time
    L, has the variance (2d + 1) C(2d, d)^2 R / (m L^2d), by Legendre's polynomials. In a prediction over the time T
    this variance is multiplied by T^2d.
    """
    if len(component.drift) == 1:  # one reading determines the only state again, after a gap of any length
        return GapLimit(np.inf)
    order = 1 if component.returns else len(component.parts[0].state_names)
    degree, spans = order - 1, np.inf
    if degree and component.keeps_level and noise_variance > 0:
        spans = (_CARRIED * order / ((2 * degree + 1) * comb(2 * degree, degree) ** 2)) ** (1 / (2 * degree))
    return GapLimit(longest_gap(component, noise_variance), spans, len(component.drift))


def longest_gap(component: Component, noise_variance: float) -> float:
    """Return the longest gap, in steps, after which the prediction still has correct digits; a power of two.

    Parameters
    ----------
    component : Component
        The model, in steps.
    noise_variance : float
        R, in unit^2; with a *small* one the longest gap is short.

    Returns
    -------
    float
        The longest gap over which the variance of the measured quantity grows by at most 1e15 R, but at least 2 steps;
        inf if R is 0, or if the variance stays smaller over any time that a clock can count.
    """
    if not noise_variance > 0:
        return np.inf
    with np.errstate(all="ignore"):
        _, Q = component.over(_LENGTHS)
        grown = (component.output @ Q @ component.output.T)[:, 0, 0]
    beyond = np.flatnonzero(~(grown <= _FORGOTTEN * noise_variance))
    return max(_LEAST, float(_LENGTHS[max(beyond[0] - 1, 0)])) if len(beyond) else np.inf


def least_gap_limit(limits: Sequence[GapLimit]) -> GapLimit:
    """Return the limit for a filter with several modes: the gaps that all of its modes bridge."""
    longest, spans, readings = zip(*limits, strict=True)
    return GapLimit(min(longest), min(spans), max(readings))


_LIMIT_FIELDS = {
    *("low", "high", "largest", "stuck", "outlier_distance", "plausible_low", "plausible_high"),
    *("repeats_are_one", "blank", "far_from_0"),
}
_GATE_FIELDS = {"states", "largest_accepted", "gated", "gate_threshold", "gate_agree", "gate_most", "gate_level"}


class Widening(NamedTuple):
    """The uncertainties that increase sigma beyond the filter's value: of the tuning, the times and the calibration."""

    factor: float = 1.0  # sigma with the uncertainty of the tuning, over sigma without this uncertainty
    time_std_s: float | None = None  # standard uncertainty of a measurement's time
    included_std: float = 0.0  # effect of uncertain times on a measurement that R already includes, in unit
    calibration: tuple[float, float] | None = None  # standard uncertainties: relative, of sensitivity; of zero, in unit


class ChannelSettings(NamedTuple):
    """The settings of one channel, from a recipe."""

    component: Component  # in steps
    noise_variance: float  # R, in unit^2
    step_s: float = 1.0
    limits: Limits = Limits()
    alarms: Alarms = NO_ALARMS
    gate: Gate | None = None
    widening: Widening = Widening()
    hole_sigma: float = np.inf  # a missing row whose sigma reaches this value is a hole, in unit

    @property
    def disturbed(self) -> bool:
        """Return whether the signal leaves out disturbances that are part of the measurement."""
        return any(part.disturbance for part in self.component.parts)


class StepTable:
    """The transition and process-noise matrices of steps of any length, for the kernel.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    nearest : bool
        Whether to round steps to whole ones for coloured noise, which has no other steps; a late row of a stream then
        does not cause an error.
    """

    def __init__(self, component: Component, *, nearest: bool = True) -> None:
        self._steps, self._in_steps = StepMatrices(component), component.has_recursion and nearest
        self._lengths, self._matrices = np.ones(1), self._steps.over(np.ones(1))

    @property
    def matrices(self) -> tuple[Floats, Floats]:
        """Return F and Q (u, n, n) of the last call of `before`; before the first call, the matrices of one step."""
        return self._matrices

    def before(self, elapsed: Floats) -> dict[str, NDArray[np.int32] | Floats]:
        """Return the index of the step before each row, and the matrices F and Q of the different steps."""
        lengths, step = elapsed[:1], np.zeros(len(elapsed), np.int32)
        if not (elapsed == lengths).all():
            lengths, rows = np.unique(elapsed, return_inverse=True)
            step = rows.astype(np.int32)
        if not np.array_equal(lengths, self._lengths) and len(lengths):
            wanted = np.round(lengths) if self._in_steps else lengths
            self._lengths, self._matrices = lengths.copy(), self._steps.over(wanted)
        F, Q = self._matrices
        return {"step": step, "F": F, "Q": Q}


def packed_settings(settings: ChannelSettings, gap_limit: GapLimit | None = None) -> NDArray[np.void]:
    """Return the settings of a channel as C's struct; by default `gap_limit` follows from the component and R."""
    packed, component, widening = settings.limits.packed(), settings.component, settings.widening
    gap_limit = gap_limit or gap_limit_of(component, settings.noise_variance)
    timed, calibrated = widening.time_std_s is not None, widening.calibration is not None
    _fill_in_gate(packed, settings.gate, component.to_model(1.0, settings.noise_variance))
    values = {
        "longest_gap": gap_limit.longest,
        "gap_spans": gap_limit.spans,
        "gap_measurements": gap_limit.readings,
        "drift_threshold": int(np.ceil(min(settings.alarms.drift_threshold, NEVER) * PARTS)),
        "dead_variance": settings.alarms.dead_variance,
        "timed": timed,
        "step_s": settings.step_s,
        "time_std_s": widening.time_std_s if timed else 0.0,
        "time_variance": widening.included_std**2,
        "factor": widening.factor,
        "calibrated": calibrated,
        "relative_std": widening.calibration[0] if widening.calibration else 0.0,
        "offset_std": widening.calibration[1] if widening.calibration else 0.0,
        "hole_sigma": settings.hole_sigma,
    }
    assert set(values) | _LIMIT_FIELDS | _GATE_FIELDS == set(packed.dtype.names or ()), (
        "a field of the C settings is not set"
    )
    for name, value in values.items():
        packed[name] = value
    return packed


def model_settings(model: Model, gate: Gate | None) -> NDArray[np.void]:
    """Return the settings for a model of one channel, without monitoring, as C's struct."""
    packed = Limits().packed()
    packed["longest_gap"] = packed["gap_spans"] = packed["hole_sigma"] = np.inf
    packed["factor"], packed["drift_threshold"] = 1.0, int(NEVER * PARTS)
    _fill_in_gate(packed, gate, model)
    if gate is None:
        packed["largest_accepted"] = np.inf
    return packed


def _fill_in_gate(packed: NDArray[np.void], gate: Gate | None, model: Model) -> None:
    values = {
        "states": model.states,
        "largest_accepted": largest_magnitude_for_noise(float(model.R[0, 0])),
        "gated": gate is not None,
        "gate_threshold": gate.threshold if gate else np.inf,
        "gate_agree": gate.agree if gate else 0,
        "gate_most": gate.at_most if gate else 0,
        "gate_level": level_of(model) if gate else -1,
    }
    assert set(values) == _GATE_FIELDS, "no other field is filled in here"
    for name, value in values.items():
        packed[name] = value


def packed_coefficients(component: Component, noise_variance: float, *, disturbed: bool) -> NDArray[np.void]:
    """Return the coefficients of a channel as C's struct.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    noise_variance : float
        R, in unit^2.
    disturbed : bool
        Whether the signal leaves out the disturbances.

    Raises
    ------
    ModelError
        If the component has too many states, or cannot start from measurements alone.
    """
    model = component.to_model(1.0, noise_variance)
    refuse_singular(model_system(model))
    coefficients = model_coefficients(model)
    coefficients["c"][: model.states] = (component.signal_output if disturbed else component.output)[0]
    coefficients["keeps_level"], coefficients["disturbed"] = component.keeps_level, disturbed
    return coefficients


def model_coefficients(model: Model) -> NDArray[np.void]:
    """Return the coefficients for a model of one channel, as C's struct; the signal includes all disturbances.

    Raises
    ------
    ModelError
        If the model has too many states.
    """
    n = model.states
    if n > MOST_STATES:
        raise ModelError(f"A channel has up to {MOST_STATES} states; this one has {n}. Leave a tone out.")
    coefficients = np.zeros((), COEFFICIENTS)
    coefficients["h"][:n] = coefficients["c"][:n] = model.H[0]
    coefficients["R"], coefficients["widest"] = model.R[0, 0], np.inf
    coefficients["prior"][: n * n] = root_of(flat_prior(model).Y).ravel()
    return coefficients
