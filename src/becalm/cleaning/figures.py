"""Describe the filter of a channel by bandwidth, lag and noise gain, for each of its modes if it has several."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.cleaning.modes import modes_in_steps
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.report import ChannelReport, ModeReport
from becalm.cleaning.steps import in_steps
from becalm.core.imm.modes import InteractingModels
from becalm.core.model.components import Component
from becalm.core.steady.response import Response, describe
from becalm.errors import ModelError
from becalm.identification.likelihood import Tuning
from becalm.identification.trust.independence import independence_steps

_NOTHING_REMOVED = 0.8
"""Noise gain above which a filter removes next to no noise."""


class Figures(NamedTuple):
    """The figures of a filter, see `ChannelReport`; a filter with a fixed lag has neither bandwidth nor lag here."""

    bandwidth_hz: float | None = None
    lag_s: float | None = None
    independence_s: float | None = None
    modes: dict[str, ModeReport] = {}  # noqa: RUF012  (never changed)
    noise_gain: float | None = None  # of a fixed filter that has a steady state

    @property
    def removes_nothing(self) -> bool:
        """Return whether the filter is known to remove next to no noise."""
        return self.noise_gain is not None and self.noise_gain >= _NOTHING_REMOVED

    @property
    def removes_noise(self) -> bool:
        """Return whether the filter is known to remove noise."""
        return self.noise_gain is not None and self.noise_gain < _NOTHING_REMOVED


def fixed_figures(tuning: Tuning, step_s: float, lag: int | None) -> Figures:
    """Return the figures of a fixed filter; `lag` as in `open_channel`."""
    response = _response(tuning.component, tuning.noise_variance, step_s, causal=lag is not None)
    gain = None if response is None else response.noise_gain
    if lag:
        return Figures(noise_gain=gain)
    steps = independence_steps(tuning, lag == 0)
    independent = None if steps is None else steps * step_s
    if response is None:
        return Figures(None if tuning.lines else 0.0, None, independent)
    return Figures(response.bandwidth_hz, response.lag_s, independent, noise_gain=gain)


def mode_figures(switching: InteractingModels, shares: dict[str, float], step_s: float, lag: int | None) -> Figures:
    """Return the figures of each mode of an IMM; `shares` are the shares of rows in which each was in force."""
    modes = {}
    for mode in switching.modes:
        response = _response(mode.component, mode.noise_variance, step_s, causal=lag is not None)
        report = ModeReport(shares[mode.name])
        if response is not None and not lag:
            left = float(np.sqrt(response.noise_gain * mode.noise_variance))
            lag_s = response.lag_s if np.isfinite(response.lag_s) else None
            report = ModeReport(shares[mode.name], response.bandwidth_hz, lag_s, left)
        modes[mode.name] = report
    return Figures(modes=modes)


def response_of(channel: ChannelRecipe, report: ChannelReport, step_s: float, causal: bool) -> Response | None:
    """Return the response of a channel's filter; with several modes, of the one that was in force most.

    Returns
    -------
    Response or None
        None for a channel that passes unchanged, or a filter without a steady state.
    """
    if channel.motion is None:
        return None
    tuning, own = in_steps(channel.motion, step_s), channel.own_steps(step_s)
    if channel.switching is None:
        return fixed_response(tuning.counted_in(own), step_s * own, causal)
    modes = {mode.name: mode for mode in modes_in_steps(channel.switching, tuning, step_s).modes}
    most = modes[max(report.modes, key=lambda name: report.modes[name].share)]
    return _response(most.component, most.noise_variance, step_s, causal=causal)


def fixed_response(tuning: Tuning, step_s: float, causal: bool) -> Response | None:
    """Return the response of a fixed filter; None if it has no steady state."""
    return _response(tuning.component, tuning.noise_variance, step_s, causal=causal)


def _response(component: Component, noise_variance: float, step_s: float, *, causal: bool) -> Response | None:
    """Return the response of a filter; None if it never forgets its start, so that it has no steady state."""
    try:
        return describe(component.to_model(1.0, noise_variance), step_s, causal, component.signal_output[0])
    except ModelError:
        return None
