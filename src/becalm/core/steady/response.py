"""Describe a tuned filter in engineering terms: bandwidth, lag, overshoot and noise gain.

The description needs no readings, only the model of one channel, which must have a steady-state gain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Complexes, Floats
from becalm.core.closed_forms import butterworth_delay, butterworth_noise_gain, butterworth_response
from becalm.core.model.model import Model
from becalm.core.model.parts import checked_step
from becalm.core.steady.steady_filter import SteadyFilter, steady
from becalm.errors import ModelError

# The step response of a steady-state filter, and its lag.
#
# The response is computed from the transient of the states: first at every reading, then only at evenly spaced
# readings, so that a slow filter takes no more time than a fast one.

_WITHIN = 0.02  # largest deviation of a settled output, over the height of the step
_LAST = 1e-5  # remaining transient, over the height of the step, at which the computation ends
_PART = 4096  # number of readings in each of the two parts
_TONE = 1e-9  # the model has a tone if an eigenvalue of F has an imaginary part above this


class StepResponse(NamedTuple):
    """Step response of a causal filter; delays are from input to output, with straight lines between samples."""

    delay_50_s: float  # at half of the height
    delay_90_s: float  # at nine tenths of the height
    overshoot_percent: float  # largest value beyond the final value, in per cent of the height
    settling_s: float  # from the first reading of the step until the output stays within 2 % of its height


def lag_steps(steady_filter: SteadyFilter) -> float:
    """Return the lag of the output in steps: the longer of the delays at low frequency and of a step at half height.

    Notes
    -----
    With tones, or with oscillating noise, the lag is the time until the step response finally stays above half of the
    height, because the response of a tone rises at once and falls back. The delay at 0 Hz then describes only the small
    part of the step that the motion follows, and is long for a slow motion; see `Response.dc_delay_s`.
    """
    transient = _transient(steady_filter)
    if _has_tones(steady_filter):
        return transient.delay_for_good(0.5)
    return max(steady_filter.dc_delay, transient.delay(0.5))


def _has_tones(steady_filter: SteadyFilter) -> bool:
    """Return whether the model oscillates; the eigenvalues of a motion have no imaginary part."""
    return bool(np.abs(np.linalg.eigvals(steady_filter.model.F).imag).max() > _TONE)


class _Transient(NamedTuple):
    """The transient of a step response: the remaining part at every reading first, then at evenly spaced readings."""

    k: Floats  # (m,) reading number, from -1, the reading before the step
    remaining: Floats  # (m,) remaining part over the height of the step; it starts at 1

    def delay(self, level: float) -> float:
        """Return the delay in steps until the output first crosses a level."""
        return self._crossing(int(np.argmax(self.remaining <= 1 - level)), level)

    def delay_for_good(self, level: float) -> float:
        """Return the delay in steps until the output crosses a level for the last time."""
        return self._crossing(int(np.flatnonzero(self.remaining > 1 - level)[-1]) + 1, level)

    def _crossing(self, i: int, level: float) -> float:
        """Return the delay of the crossing between reading i - 1 and reading i."""
        before, now = self.remaining[i - 1], self.remaining[i]
        share = (before - (1 - level)) / (before - now)
        return float(self.k[i - 1] + share * (self.k[i] - self.k[i - 1]) + 1 - level)


def _transient(steady_filter: SteadyFilter) -> _Transient:
    """Return the transient of the step response of a filter that passes 0 Hz."""
    A, K = steady_filter.loop.A, steady_filter.loop.K
    x = np.linalg.solve(np.eye(len(A)) - A, K).astype(np.float64)  # states after the transient
    slowest = max(float(np.abs(steady_filter.poles[0])), 0.1)
    total = len(A) + int(np.log(_LAST) / np.log(slowest))
    stride = max(1, -(-(total - _PART) // _PART))
    power = np.linalg.matrix_power
    later = (power(A, _PART) @ x).astype(np.float64)
    orbit = np.hstack([_orbit(A, x, _PART), _orbit(power(A, stride), later, _PART)])
    k = np.append(np.arange(_PART), _PART + stride * np.arange(_PART)).astype(np.float64) - 1
    remaining: Floats = (steady_filter.row @ orbit)[0] / (steady_filter.row @ x)[0]
    return _Transient(k, remaining)


def _orbit(A: Floats, x: Floats, count: int) -> Floats:
    """Return x, A x, A^2 x and so on as columns, (n, count)."""
    while x.shape[1] < count:
        x, A = np.hstack([x, A @ x]), A @ A
    return x[:, :count]


def describe_step(steady_filter: SteadyFilter, step_s: float) -> StepResponse:
    """Return the step response of a filter that passes 0 Hz, for readings every `step_s` seconds."""
    transient = _transient(steady_filter)
    outside = int(np.flatnonzero(np.abs(transient.remaining) > _WITHIN)[-1])
    return StepResponse(
        delay_50_s=transient.delay(0.5) * step_s,
        delay_90_s=transient.delay(0.9) * step_s,
        overshoot_percent=100 * max(0.0, -float(transient.remaining.min())),
        settling_s=float(transient.k[min(outside + 1, len(transient.k) - 1)]) * step_s,
    )


_PASSES_DC = 0.1  # a filter whose gain at 0 Hz, over the largest gain, is below this is a band-pass
_STABLE = 1 - 1e-13  # the magnitudes of all poles of a filter with a steady state are below this
_BUTTERWORTHS = range(1, 7)  # orders of the Butterworth filters that are compared


class Butterworth(NamedTuple):
    """The causal Butterworth low-pass with the same bandwidth."""

    order: int
    cutoff_hz: float
    delay_s: float  # at low frequency
    noise_gain: float


@dataclass(frozen=True)
class Response:
    """Properties of a steady-state filter or smoother of one channel.

    Attributes
    ----------
    bandwidth_hz : float
        Highest frequency that passes with at least half of the power (-3 dB) of 0 Hz, or of the peak
        if 0 Hz does not pass; half the sampling rate if all frequencies pass.
    bands_hz : tuple of (low, high)
        Bands whose frequencies pass with at least that power; (0, bandwidth) for a low-pass.
    noise_bandwidth_hz : float
        One-sided bandwidth of the ideal filter with the same noise gain.
    noise_gain : float
        Variance of white noise after the filter, over its variance before the filter.
    dc_gain : float
        Gain at 0 Hz; below 1 if the signal of the model returns to 0.
    lag_s : float
        Lag of the output: the delay at low frequency or the delay of a step at half of its height, whichever is longer;
        for a motion with tones, the delay of the step; 0 for a smoother, NaN for a band-pass. See `lag_steps`.
    dc_delay_s : float
        Group delay at 0 Hz; 0 from order 2 on, although a step is delayed.
    sine_delay_s : float
        Longest phase delay of a sine within the bandwidth.
    peak_db, peak_hz : float
        Largest gain over that at 0 Hz, and its frequency; 0 and 0 without a peak; 0 and the centre for a band-pass.
    poles : (n,) complex array
        Poles of the filter, per step, the slowest first.
    step : StepResponse or None
        The step response, for a causal filter that passes 0 Hz.
    butterworth : Butterworth or None
        For a causal low-pass with a bandwidth below half the sampling rate: the Butterworth filter with the same -3 dB
        bandwidth. Its order is that for which the outputs for white noise differ least in mean square.
    """

    bandwidth_hz: float
    bands_hz: tuple[tuple[float, float], ...]
    noise_bandwidth_hz: float
    noise_gain: float
    dc_gain: float
    lag_s: float
    dc_delay_s: float
    sine_delay_s: float
    peak_db: float
    peak_hz: float
    poles: Complexes
    step: StepResponse | None = None
    butterworth: Butterworth | None = None

    @property
    def noise_gain_db(self) -> float:
        """Return the noise power after the filter over that before, in dB; negative if noise is removed."""
        return decibels(self.noise_gain)

    def __str__(self) -> str:
        """Return the description as one sentence."""
        noise = f"noise {'down' if self.noise_gain <= 1 else 'up'} {abs(self.noise_gain_db):.1f} dB"
        bands = " and ".join(f"{low:.4g} to {high:.4g}" for low, high in self.bands_hz)
        if np.isnan(self.lag_s):
            return f"a band-pass from {bands} Hz, {noise}"
        shape = f"{self.bandwidth_hz:.3g} Hz low-pass" if len(self.bands_hz) == 1 else f"filter that passes {bands} Hz"
        delay = f"{_time(self.lag_s)} delay" if self.step else "no delay"
        peak = f", {self.peak_db:.1f} dB peaking" if self.peak_db >= 0.05 else ""
        gain = f", gain {self.dc_gain:.2g} at 0 Hz" if abs(self.dc_gain - 1) >= 0.005 else ""
        text = f"a {shape} with {delay}{peak}{gain}, {noise}"
        if self.butterworth is None:
            return text
        order, cutoff, delay_s, noise_gain = self.butterworth
        match = f"order {order}, {cutoff:.3g} Hz, {_time(delay_s)} delay, noise down {-decibels(noise_gain):.1f} dB"
        return f"{text}; matched Butterworth: {match}"


def describe(model: Model, step_s: float, causal: bool = True, output: ArrayLike | None = None) -> Response:
    """Describe the steady-state filter or smoother of a model of one channel.

    Parameters
    ----------
    model : Model
        A model of one channel; unobservable states are left out unless all of them decay.
    step_s : float
        Step, in seconds.
    causal : bool
        True for the filter, False for the smoother.
    output : (n,) array_like, optional
        Row that computes the output from the states, for example that of one component of several; H by default.

    Raises
    ------
    ModelError
        If the model has several channels, R = 0 or no steady-state gain, if the step is not positive, or if the output
        is invalid or depends on an unobservable state.
    """
    step_s = checked_step(step_s)
    steady_filter = steady(model, output)
    if not abs(steady_filter.poles[0]) < _STABLE:
        raise ModelError(
            "This filter has no steady state: a constant state has no process noise,"
            " so its gain falls to 0. Give that state a positive Q."
        )
    response = steady_filter.filter_response if causal else steady_filter.smoother_response
    passing = _find_passing(response, steady_filter.frequencies)
    noise_gain, edge = steady_filter.noise_gain(0 if causal else np.inf), passing.bands[-1][1]
    delayed = causal and passing.passes_dc
    low_pass = delayed and len(passing.bands) == 1 and edge < 0.5
    no_delay = 0.0 if passing.passes_dc else np.nan  # the delay of a smoother is 0, that of a band-pass is undefined
    has_peak = not passing.passes_dc or passing.peak > passing.reference * (1 + 1e-12)
    return Response(
        bandwidth_hz=edge / step_s,
        bands_hz=tuple((low / step_s, high / step_s) for low, high in passing.bands),
        noise_bandwidth_hz=noise_gain / passing.reference / (2 * step_s),
        noise_gain=noise_gain,
        dc_gain=passing.dc_gain,
        lag_s=lag_steps(steady_filter) * step_s if delayed else no_delay,
        dc_delay_s=steady_filter.dc_delay * step_s if delayed else no_delay,
        sine_delay_s=passing.delay * step_s if delayed else no_delay,
        peak_db=decibels(passing.peak / passing.reference) if has_peak else 0.0,
        peak_hz=passing.peak_at / step_s if has_peak else 0.0,
        poles=steady_filter.poles,
        step=describe_step(steady_filter, step_s) if delayed else None,
        butterworth=_match_butterworth(steady_filter, edge, step_s) if low_pass else None,
    )


def decibels(power_ratio: float) -> float:
    """Return a ratio of powers in decibels."""
    return float(10 * np.log10(power_ratio))


class _Passing(NamedTuple):
    """The pass bands of a filter; frequencies in cycles per step."""

    reference: float  # power gain at 0 Hz, or the largest one if 0 Hz does not pass
    passes_dc: bool
    dc_gain: float
    bands: tuple[tuple[float, float], ...]
    peak: float  # power gain
    peak_at: float
    delay: float  # largest phase delay within the bands, in steps


def _find_passing(respond: Callable[[ArrayLike], Complexes], f: Floats) -> _Passing:
    """Return the pass bands of a frequency response, searched from frequencies f (k,) in cycles per step."""
    from scipy.optimize import brentq, minimize_scalar

    def power(x: float) -> float:
        return float(np.abs(respond([x])[0]) ** 2)

    f = np.append(0.0, f)
    G = respond(f)
    passed = np.abs(G) ** 2
    i = int(np.argmax(passed))
    near = (f[max(i - 1, 0)], f[min(i + 1, len(f) - 1)])
    fine = minimize_scalar(lambda x: -power(x), bounds=near, method="bounded", options={"xatol": 1e-6 * near[1]})
    peak_at = max(float(f[i]), float(fine.x), key=power)
    peak = power(peak_at)
    passes_dc = bool(passed[0] >= _PASSES_DC**2 * peak)
    reference = float(passed[0]) if passes_dc else peak
    passes = passed > reference / 2

    def edge(j: int) -> float:
        return float(brentq(lambda x: power(x) - reference / 2, f[j], f[j + 1], xtol=1e-16, rtol=1e-14))

    edges = [edge(j) for j in np.flatnonzero(passes[1:] != passes[:-1]).tolist()]
    edges = [0.0] * bool(passes[0]) + edges + [0.5] * bool(passes[-1])
    late = -np.unwrap(np.angle(G / G[0]))[1:] / (2 * np.pi * f[1:]) if passes_dc else np.zeros(1)
    late = late[passes[1:]] if passes_dc else late
    bands = tuple(zip(edges[::2], edges[1::2], strict=True))
    delay = max(0.0, float(late.max(initial=0.0)))
    return _Passing(reference, passes_dc, float(G[0].real), bands, peak, peak_at, delay)


def _match_butterworth(steady_filter: SteadyFilter, cutoff: float, step_s: float) -> Butterworth:
    """Return the Butterworth filter with a cut-off in cycles per step whose order fits the filter best."""
    f = steady_filter.frequencies
    G = steady_filter.filter_response(f) / steady_filter.dc_gain
    errors = [np.trapezoid(np.abs(G - butterworth_response(order, cutoff, f)) ** 2, f) for order in _BUTTERWORTHS]
    order = _BUTTERWORTHS[int(np.argmin(errors))]
    delay, noise_gain = butterworth_delay(order, cutoff), butterworth_noise_gain(order, cutoff)
    return Butterworth(order, cutoff / step_s, delay * step_s, noise_gain)


def _time(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"
