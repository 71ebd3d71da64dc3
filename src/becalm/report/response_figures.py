"""Draw a filter's trade-off between noise and lag, and its step response."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels.figures import response_of
from becalm.cleaning.channels.report import ChannelReport
from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.limits_entry import least_lag_s
from becalm.cleaning.recipes.recipe import ChannelRecipe, Recipe
from becalm.core.closed_forms import cutoff_to_ratio
from becalm.core.recording import Recording
from becalm.core.steady.response import Response
from becalm.identification.wishes.gain_of_waiting import Wait, waiting_curve
from becalm.identification.wishes.noise_against_lag import TradeOffCurve, trade_off_curve
from becalm.report.data.description import Axis, Curve, Figure, Layer
from becalm.report.pictures import Title

_ORDERS = (1, 2, 3)  # of the kinematic models on the trade-off curve
_CUTOFFS = np.geomspace(1e-4, 3.0, 20)  # radians per row
_HEIGHT = 10.0  # height of a step, in standard deviations of a reading's noise
_POINTS = 600  # approximate number of points of a step response
_MOST_ROWS = 200_000  # largest number of rows for a step response


class Behaviour(NamedTuple):
    """The known behaviour of a channel's filter."""

    channel: ChannelRecipe
    report: ChannelReport
    response: Response | None  # of the causal filter or the smoother; with several modes, of the most frequent mode
    waits: tuple[Wait, ...]  # remaining noise for each delay, the smoother last; () unless one kinematic model is alone

    def noise_left(self, wait_s: float | None) -> float | None:
        """Return the standard deviation of the remaining noise, in the channel's unit; None if it is unknown.

        Parameters
        ----------
        wait_s : float or None
            Time that the estimate waits for later readings, in seconds; None for the noise of `response`.
        """
        if self.response is None or self.report.noise_std is None:
            return None
        if wait_s is None:
            return self.report.noise_std * float(np.sqrt(self.response.noise_gain))
        waits = [one.wait_s for one in self.waits[:-1]]
        return float(np.interp(wait_s, waits, [one.noise_std for one in self.waits[:-1]])) if waits else None


def compute_trade_off(step_s: float) -> TradeOffCurve:
    """Return the trade-off curve (noise against lag) of causal filters of order 1 to 3, for readings with noise 1."""
    points = [
        trade_off_curve(1.0, step_s, (order,), [cutoff_to_ratio(order, float(cutoff)) for cutoff in _CUTOFFS]).points
        for order in _ORDERS
    ]
    return TradeOffCurve(1.0, step_s, tuple(chain.from_iterable(points)))


def trade_off_figure(title: Title, found: Behaviour, curve: TradeOffCurve, mode: str) -> Figure | None:
    """Draw remaining noise against delay, for causal filters and for this filter; None if this filter is unknown."""
    noise_std = found.report.noise_std
    if noise_std is None or found.response is None:
        return None
    layers: list[Layer] = []
    for order in curve.orders:
        points = [point for point in curve.points if point.order == order]
        x, y = np.array([(point.lag_s, noise_std * point.noise_std) for point in points]).T
        layers.append(Curve(f"causal, order {order}", x[::-1], y[::-1], "other", "dashed"))
    layers += _of_modes(found)
    late_s = found.response.lag_s
    later = found.waits[1:-1]  # empty if the filter is so fast that later readings change nothing
    if mode != "causal" and later:
        x, y = np.array([(one.wait_s, one.noise_std) for one in later]).T
        layers.append(Curve("this filter, with a delay", x, y, "clean"))
        late_s = float(x[-1]) if found.report.delay_s is None else found.report.delay_s
    left = found.noise_left(late_s if mode == "lagged" else None)
    if late_s > 0 and left is not None and not found.report.modes:
        chosen = "chosen" if mode != "smoothed" else "chosen: waits for all"
        layers.append(Curve("chosen", np.array([late_s]), np.array([left]), "truth", "points", (chosen,)))
    if len(layers) == len(curve.orders):  # nothing is known about this filter
        return None
    caption = "Delay: the lag of a causal output, or the time that a later output waits."
    unit = f" ({title.unit})" if title.unit else ""
    late, noise = Axis("delay (s)", log=True), Axis(f"noise left{unit}", log=True)
    return Figure(f"{title.slug}-front", "Noise against lag", late, noise, tuple(layers), caption)


def _of_modes(found: Behaviour) -> list[Layer]:
    """Return a point for each mode of a filter with several modes."""
    return [
        Curve(name, np.array([mode.lag_s]), np.array([mode.noise_left]), "truth", "points", (name,))
        for name, mode in found.report.modes.items()
        if mode.lag_s and mode.noise_left
    ]


def step_figure(title: Title, found: Behaviour, recipe: Recipe, step_s: float) -> Figure | None:
    """Run the filter on a step, and draw its output; None if the response is unknown, or needs too many rows."""
    rows = _rows_to_show(found, step_s)
    if rows is None:
        return None
    assert found.channel.noise_std is not None  # a channel with a model has one
    step = np.repeat([0.0, 1.0], 2 * rows)
    alone = found.channel.model_copy(update={"gate": None, "limits": None, "calibration": None})
    readings = Recording(
        _HEIGHT * found.channel.noise_std * step[:, np.newaxis],
        names=[alone.name],
        units=[alone.unit],
        rate_hz=1 / step_s,
    )
    run = clean(readings, recipe.model_copy(update={"channel": (alone,)}))
    output = run.signal.samples[:, 0] / (_HEIGHT * found.channel.noise_std)
    shown = slice(rows, 3 * rows, max(1, 2 * rows // _POINTS))
    times_s = (np.arange(4.0 * rows)[shown] - 2 * rows) * step_s
    layers = (
        Curve("step", times_s, step[shown], "readings", "dashed"),
        Curve("output", times_s, output[shown], "clean"),
    )
    caption = f"Without noise and without a gate; the step is {_HEIGHT:g} times the noise of a reading."
    axis = Axis("output / step")
    return Figure(f"{title.slug}-step", "Step response", Axis("time (s)"), axis, layers, caption)


def _rows_to_show(found: Behaviour, step_s: float) -> int | None:
    """Return the number of rows to show on each side of the step; None if the step cannot be shown."""
    response = found.response
    if response is None or not response.bandwidth_hz > 0:
        return None
    narrowest_hz = min(high - low for low, high in response.bands_hz)
    quick_hz = max((mode.bandwidth_hz or 0.0 for mode in found.report.modes.values()), default=0.0)
    lasts_s = 2 / narrowest_hz if response.step is None else 2 * response.step.settling_s
    lasts_s = 2 / quick_hz if quick_hz else lasts_s  # with several modes, the fastest mode follows a step
    rows = max(20, int(np.ceil(lasts_s / step_s)))
    return rows if 4 * rows <= _MOST_ROWS else None


def behaviour_of(channel: ChannelRecipe, report: ChannelReport, recipe: Recipe, step_s: float) -> Behaviour:
    """Return the behaviour of a channel's filter.

    Parameters
    ----------
    channel : ChannelRecipe
        Recipe of the channel.
    report : ChannelReport
        Report of the cleaned channel.
    recipe : Recipe
        Recipe of the whole recording.
    step_s : float
        Time between two rows, in seconds.
    """
    response, motion = response_of(channel, report, step_s, recipe.mode == "causal"), channel.motion
    alone = motion is not None and channel.switching is None and not channel.parts[1:]
    if response is None or motion is None or not alone or not report.q_over_r:
        return Behaviour(channel, report, response, ())
    curve = waiting_curve(motion.order, report.q_over_r, motion.noise_std**2, step_s)
    waits = [replace(one, wait_s=least_lag_s(channel.limits, one.wait_s, step_s)) for one in curve]
    return Behaviour(channel, report, response, tuple(waits))
