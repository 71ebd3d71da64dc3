"""What a tuned filter is, in an engineer's words: bandwidth, lag, overshoot and noise left.

For one channel of a model whose gain settles, told from the model alone, before anything is filtered.
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
from becalm.core.steady.steady_filter import SteadyFilter
from becalm.core.steady.steady_gain import steady
from becalm.core.steady.step_response import StepResponse, lag_steps, tell_step
from becalm.errors import ModelError

_HOLDS = 0.1  # of the largest gain: an output with less at 0 Hz is a band-pass
_FORGETS = 1 - 1e-13  # largest pole of a filter that does
_BUTTERWORTHS = range(1, 7)


class Butterworth(NamedTuple):
    """The causal low-pass an engineer would draw for the same band."""

    order: int
    cutoff_hz: float
    delay_s: float  # of a slow signal
    noise_gain: float


@dataclass(frozen=True)
class Response:
    """A steady filter or smoother of one channel.

    Attributes
    ----------
    bandwidth_hz : float
        Highest frequency that still passes with half of the power (-3 dB) of 0 Hz, or of the peak
        where 0 Hz does not pass; half the rate if all pass.
    bands_hz : tuple of (low, high)
        Where that much passes; (0, bandwidth) of a low-pass.
    noise_bandwidth_hz : float
        Band of the ideal filter that would leave as much white noise, one-sided.
    noise_gain : float
        Variance of white noise after the filter over before.
    dc_gain : float
        Gain of a constant; below 1 where the model knows that the signal returns to 0.
    lag_s : float
        How far the output trails: the delay of a slow signal or that of a step at half of its height,
        whichever is longer; where tones stand beside a motion, that of the step. 0 for a smoother,
        NaN for a band-pass. See `step_response.lag_steps`.
    dc_delay_s : float
        Delay of a slow signal (group delay at 0 Hz); 0 from order 2 on, which the step is not.
    sine_delay_s : float
        Longest delay of a sine within the bandwidth (phase delay).
    peak_db, peak_hz : float
        How far the gain rises above that of 0 Hz, and where; 0 and 0 if nowhere. Of a band-pass 0, and its centre.
    poles : (n,) complex array
        Of the filter, each per step, the slowest first.
    step : StepResponse or None
        Of a causal filter that passes 0 Hz.
    butterworth : Butterworth or None
        Of the same -3 dB bandwidth, and the order whose output differs least in mean square when white
        noise comes; of a causal low-pass that does not pass everything.
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
        """Noise power after over before, in dB; negative: noise is removed."""
        return decibels(self.noise_gain)

    def __str__(self) -> str:
        """Say it in a sentence."""
        noise = f"noise {'down' if self.noise_gain <= 1 else 'up'} {abs(self.noise_gain_db):.1f} dB"
        bands = " and ".join(f"{low:.4g} to {high:.4g}" for low, high in self.bands_hz)
        if np.isnan(self.lag_s):
            return f"a band-pass from {bands} Hz, {noise}"
        shape = f"{self.bandwidth_hz:.3g} Hz low-pass" if len(self.bands_hz) == 1 else f"filter that passes {bands} Hz"
        delay = f"{_time(self.lag_s)} delay" if self.step else "no delay"
        peak = f", {self.peak_db:.1f} dB peaking" if self.peak_db >= 0.05 else ""
        fades = f", gain {self.dc_gain:.2g} at 0 Hz" if abs(self.dc_gain - 1) >= 0.005 else ""
        said = f"a {shape} with {delay}{peak}{fades}, {noise}"
        if self.butterworth is None:
            return said
        order, cutoff, late, left = self.butterworth
        twin = f"order {order}, {cutoff:.3g} Hz, {_time(late)} delay, noise down {-decibels(left):.1f} dB"
        return f"{said}; matched Butterworth: {twin}"


def describe(model: Model, step_s: float, causal: bool = True, output: ArrayLike | None = None) -> Response:
    """Describe the steady filter, or the smoother, of a one-channel model.

    Parameters
    ----------
    model : Model
        One channel, any states; what no reading ever sees is left out.
    step_s : float
        Step in seconds.
    causal : bool
        Whether to describe the filter (True) or the smoother.
    output : (n,) array_like, optional
        The row that makes the output from the states, for one component of several; H if not given.

    Raises
    ------
    ModelError
        If the model has several channels, R = 0, or no steady gain; if the step is not positive.
    """
    step_s = checked_step(step_s)
    found = steady(model, output)
    if not abs(found.poles[0]) < _FORGETS:
        raise ModelError(
            "This filter never forgets its start: a state that stays for ever has no process noise,"
            " so its gain falls to 0. Give that state a positive Q."
        )
    passing = _find_passing(found.filter_response if causal else found.smoother_response, found.frequencies)
    noise_gain, edge = found.noise_gain(0 if causal else np.inf), passing.bands[-1][1]
    follows = causal and passing.holds
    simple = follows and len(passing.bands) == 1 and edge < 0.5
    still = 0.0 if passing.holds else np.nan  # the delay of a smoother, or of what no step passes
    rises = not passing.holds or passing.peak > passing.reference * (1 + 1e-12)
    return Response(
        bandwidth_hz=edge / step_s,
        bands_hz=tuple((low / step_s, high / step_s) for low, high in passing.bands),
        noise_bandwidth_hz=noise_gain / passing.reference / (2 * step_s),
        noise_gain=noise_gain,
        dc_gain=passing.dc_gain,
        lag_s=lag_steps(found) * step_s if follows else still,
        dc_delay_s=found.dc_delay * step_s if follows else still,
        sine_delay_s=passing.delay * step_s if follows else still,
        peak_db=decibels(passing.peak / passing.reference) if rises else 0.0,
        peak_hz=passing.peak_at / step_s if rises else 0.0,
        poles=found.poles,
        step=tell_step(found, step_s) if follows else None,
        butterworth=_match_butterworth(found, edge, step_s) if simple else None,
    )


def decibels(power_ratio: float) -> float:
    """Return ten times the decimal logarithm of a ratio of powers."""
    return float(10 * np.log10(power_ratio))


class _Passing(NamedTuple):
    """Where a filter passes, in cycles a step."""

    reference: float  # power at 0 Hz, or the largest where 0 Hz does not pass
    holds: bool  # whether 0 Hz passes
    dc_gain: float
    bands: tuple[tuple[float, float], ...]
    peak: float  # power
    peak_at: float
    delay: float  # of the slowest sine, in steps


def _find_passing(respond: Callable[[ArrayLike], Complexes], f: Floats) -> _Passing:
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
    holds = bool(passed[0] >= _HOLDS**2 * peak)
    reference = float(passed[0]) if holds else peak
    passes = passed > reference / 2

    def edge(j: int) -> float:
        return float(brentq(lambda x: power(x) - reference / 2, f[j], f[j + 1], xtol=1e-16, rtol=1e-14))

    edges = [edge(j) for j in np.flatnonzero(passes[1:] != passes[:-1]).tolist()]
    edges = [0.0] * bool(passes[0]) + edges + [0.5] * bool(passes[-1])
    late = -np.unwrap(np.angle(G / G[0]))[1:] / (2 * np.pi * f[1:]) if holds else np.zeros(1)
    late = late[passes[1:]] if holds else late
    bands = tuple(zip(edges[::2], edges[1::2], strict=True))
    return _Passing(reference, holds, float(G[0].real), bands, peak, peak_at, max(0.0, float(late.max(initial=0.0))))


def _match_butterworth(found: SteadyFilter, cutoff: float, step_s: float) -> Butterworth:
    """Find the order of the Butterworth filter of a cut-off, in cycles a step, that follows a filter best."""
    f = found.frequencies
    G = found.filter_response(f) / found.dc_gain
    missed = [np.trapezoid(np.abs(G - butterworth_response(order, cutoff, f)) ** 2, f) for order in _BUTTERWORTHS]
    order = _BUTTERWORTHS[int(np.argmin(missed))]
    late, left = butterworth_delay(order, cutoff), butterworth_noise_gain(order, cutoff)
    return Butterworth(order, cutoff / step_s, late * step_s, left)


def _time(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"
