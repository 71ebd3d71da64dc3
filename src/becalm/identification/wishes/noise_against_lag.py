"""Compute the trade-off curve of remaining noise against lag, before any filter runs.

The curve is predicted from the Riccati solution and the noise variance of a reading alone. The curve does not depend on
the signal: bandwidth and overshoot show how a filter changes a signal, and the likelihood shows which order fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from becalm.core.closed_forms import cutoff_to_ratio
from becalm.core.model.components import ORDERS
from becalm.core.steady.dials import motion_filter
from becalm.core.steady.response import describe
from becalm.errors import UsageError
from becalm.identification.wishes.dial import Dial, Kind, ratio_for
from becalm.identification.wishes.gain_of_waiting import check_noise_variance

_CUTOFFS = np.geomspace(1e-4, 4.0, 48)  # default cut-offs, in radians a step


@dataclass(frozen=True)
class Point:
    """One causal filter on the trade-off curve.

    Attributes
    ----------
    order : int
        Order of the motion.
    ratio : float
        q/r, as in `Tuning.ratio`.
    noise_std : float
        Standard deviation of the remaining noise, in unit.
    noise_gain_db : float
        Power of the remaining noise over that of a reading's noise, in dB, below 0.
    lag_s, step_50_s, step_90_s : float
        Lag of the output, and delay of a step at 50 % and at 90 % of its height, in seconds; see
        `core.steady.response`.
    bandwidth_hz, noise_bandwidth_hz : float
        -3 dB bandwidth, and noise-equivalent bandwidth, one-sided, in Hz.
    overshoot_percent : float
        Overshoot of a step, in percent of its height.
    """

    order: int
    ratio: float
    noise_std: float
    noise_gain_db: float
    lag_s: float
    step_50_s: float
    step_90_s: float
    bandwidth_hz: float
    noise_bandwidth_hz: float
    overshoot_percent: float


@dataclass(frozen=True)
class TradeOffCurve:
    """The filters of a trade-off curve.

    Attributes
    ----------
    noise_variance : float
        Noise variance of a reading, in unit^2.
    step_s : float
        Step in seconds.
    points : tuple of Point
        The filters by order, the slowest first.
    """

    noise_variance: float
    step_s: float
    points: tuple[Point, ...]

    @property
    def orders(self) -> tuple[int, ...]:
        """Return the orders on the curve."""
        return tuple(dict.fromkeys(point.order for point in self.points))

    @property
    def best(self) -> tuple[Point, ...]:
        """Return the Pareto-optimal points, fastest first: no other point is both faster and quieter."""
        kept: list[Point] = []
        for point in sorted(self.points, key=lambda point: (point.lag_s, point.noise_std)):
            if not kept or point.noise_std < kept[-1].noise_std:
                kept.append(point)
        return tuple(kept)


@dataclass(frozen=True)
class Pick:
    """The chosen point of a trade-off curve, and why it was chosen.

    Attributes
    ----------
    point : Point
        The chosen filter.
    why : str
        The reason in a sentence or two, with the figures of the other orders.
    rivals : tuple of Point
        The filters of the other orders for the same wish.
    """

    point: Point
    why: str
    rivals: tuple[Point, ...]


def trade_off_curve(
    noise_variance: float, step_s: float, orders: Sequence[int] = ORDERS, ratios: Sequence[float] | None = None
) -> TradeOffCurve:
    """Predict the remaining noise and the lag of filters of several orders.

    Parameters
    ----------
    noise_variance : float
        r, the noise variance of a reading, in unit^2, as `tune_motion` returns it.
    step_s : float
        Step in seconds.
    orders : sequence of int
        Orders of the motion, each 1 to 5.
    ratios : sequence of float, optional
        Values of q/r; a *small* one smooths more. By default those of cut-offs from 1e-4 to 4 radians per step.

    Raises
    ------
    UsageError
        If the variance or a ratio is not positive, or there is no order or no ratio.
    ModelError
        If an order is not 1 to 5, or the step is not positive.
    """
    check_noise_variance(noise_variance)
    if len(orders) == 0 or (ratios is not None and len(ratios) == 0):
        raise UsageError("A trade-off curve needs an order and a ratio; leave them out to use the defaults.")
    wrong = [ratio for ratio in (() if ratios is None else ratios) if not 0 < ratio < np.inf]
    if wrong:
        raise UsageError(f"ratios holds {wrong[0]}; each q/r must be positive.")
    points = [
        _point(order, ratio, noise_variance, step_s)
        for order in orders
        for ratio in sorted((cutoff_to_ratio(order, float(one)) for one in _CUTOFFS) if ratios is None else ratios)
    ]
    return TradeOffCurve(noise_variance, step_s, tuple(points))


def pick(
    front: TradeOffCurve,
    *,
    max_lag_s: float | None = None,
    bandwidth_hz: float | None = None,
    noise_gain_db: float | None = None,
) -> Pick:
    """Choose the filter that fulfils one wish exactly; it need not be a point of the curve.

    Parameters
    ----------
    front : TradeOffCurve
        The curve whose orders are compared; give a curve of one order to keep that order.
    max_lag_s : float, optional
        Largest lag of the output behind a ramp, and behind a step at 50 % of its height; the quietest filter wins.
    bandwidth_hz : float, optional
        The -3 dB bandwidth; the quietest filter wins.
    noise_gain_db : float, optional
        Noise power after the filter over that before it, in dB, below 0; the fastest filter wins.

    Raises
    ------
    UsageError
        If not exactly one wish is given, or no order can fulfil it.
    """
    wishes: dict[Kind, float | None] = {
        "max_lag_s": max_lag_s,
        "bandwidth_hz": bandwidth_hz,
        "noise_gain_db": noise_gain_db,
    }
    given = [Dial(kind, value) for kind, value in wishes.items() if value is not None]
    if len(given) != 1:
        raise UsageError(f"{len(given)} wishes came; give exactly one of max_lag_s, bandwidth_hz and noise_gain_db.")
    dial = given[0]
    points, refused = [], []
    for order in front.orders:
        try:
            points.append(_point(order, ratio_for(order, dial, front.step_s), front.noise_variance, front.step_s))
        except UsageError as cause:
            refused.append(str(cause))
    if not points:
        raise UsageError(" ".join(dict.fromkeys(refused)))
    quickest = dial.kind == "noise_gain_db"
    ranked = sorted(points, key=lambda point: point.lag_s if quickest else point.noise_std)
    return Pick(ranked[0], _why(dial, ranked), tuple(ranked[1:]))


def _point(order: int, ratio: float, noise_variance: float, step_s: float) -> Point:
    response = describe(motion_filter(order, ratio).model, step_s)
    step = response.step
    assert step is not None  # a motion passes 0 Hz
    return Point(
        order=order,
        ratio=ratio,
        noise_std=float(np.sqrt(response.noise_gain * noise_variance)),
        noise_gain_db=response.noise_gain_db,
        lag_s=response.lag_s,
        step_50_s=step.delay_50_s,
        step_90_s=step.delay_90_s,
        bandwidth_hz=response.bandwidth_hz,
        noise_bandwidth_hz=response.noise_bandwidth_hz,
        overshoot_percent=step.overshoot_percent,
    )


def _why(dial: Dial, ranked: list[Point]) -> str:
    best, others = ranked[0], ranked[1:]
    won = "quickest" if dial.kind == "noise_gain_db" else "quietest"
    reason = f"With {dial.kind} = {dial.value:.6g}, order {best.order} is the {won}: {_figures(best)}."
    rest = "; ".join(f"order {point.order}: {_figures(point)}" for point in others)
    return f"{reason} {rest[:1].upper()}{rest[1:]}." if rest else reason


def _figures(point: Point) -> str:
    overshoot = f", overshoot {point.overshoot_percent:.0f} %" if point.overshoot_percent >= 0.5 else ""
    return (
        f"noise {point.noise_gain_db:.1f} dB, lag {point.lag_s:.3g} s, 90 % of a step {point.step_90_s:.3g} s late,"
        f" {point.bandwidth_hz:.4g} Hz{overshoot}"
    )
