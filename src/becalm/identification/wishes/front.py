"""The front of noise against lag: what every filter would leave and how late it would be, before any is run.

Predicted from the Riccati solution and the variance of a reading alone. Of the signal it knows nothing: what
a filter does to that, its bandwidth and overshoot tell, and which order fits it, the likelihood.
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
from becalm.identification.wishes.waiting import refuse_variance

_CUTOFFS = np.geomspace(1e-4, 4.0, 48)  # radians a step
_SAME = 1e-9  # relative: what differs by less is equal


@dataclass(frozen=True)
class Point:
    """One causal filter on the front.

    Attributes
    ----------
    order : int
        Of the motion.
    ratio : float
        q/r, as in `Tuning.ratio`.
    noise_std : float
        Standard deviation of the noise that is left, in unit.
    noise_gain_db : float
        Its power over that of a reading's noise, in dB, below 0.
    lag_s, step_50_s, step_90_s : float
        How far the output trails, and a step at half and at nine tenths of its height; see `core.steady.response`.
    bandwidth_hz, noise_bandwidth_hz : float
        -3 dB, and noise-equivalent, one-sided.
    overshoot_percent : float
        Of a step.
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
class Front:
    """All filters that were looked at.

    Attributes
    ----------
    noise_variance : float
        Of a reading, in unit^2.
    step_s : float
        Step in seconds.
    points : tuple of Point
        By order, the slowest first.
    """

    noise_variance: float
    step_s: float
    points: tuple[Point, ...]

    @property
    def orders(self) -> tuple[int, ...]:
        """Orders that were looked at."""
        return tuple(dict.fromkeys(point.order for point in self.points))

    @property
    def best(self) -> tuple[Point, ...]:
        """The Pareto front, the quickest first: no other point is both quicker and quieter."""
        kept: list[Point] = []
        for point in sorted(self.points, key=lambda point: (point.lag_s, point.noise_std)):
            if not kept or point.noise_std < kept[-1].noise_std:
                kept.append(point)
        return tuple(kept)


@dataclass(frozen=True)
class Pick:
    """A point that was chosen, and why.

    Attributes
    ----------
    point : Point
        The chosen filter.
    why : str
        In a sentence or two, with the other orders' figures.
    rivals : tuple of Point
        What the other orders would give for the same wish.
    """

    point: Point
    why: str
    rivals: tuple[Point, ...]


def noise_lag_front(
    noise_variance: float, step_s: float, orders: Sequence[int] = ORDERS, ratios: Sequence[float] | None = None
) -> Front:
    """Predict what motions of several orders leave of the noise, and how late they are.

    Parameters
    ----------
    noise_variance : float
        r of a reading, in unit^2, as `tune_motion` finds it.
    step_s : float
        Step in seconds.
    orders : sequence of int
        1 to 5.
    ratios : sequence of float, optional
        q/r to look at; a *small* one smooths more. By default cut-offs from 1e-4 to 4 radians a step.

    Raises
    ------
    UsageError
        If the variance or a ratio is not positive, or there is nothing to look at.
    """
    refuse_variance(noise_variance)
    if len(orders) == 0 or (ratios is not None and len(ratios) == 0):
        raise UsageError("A front needs an order and a ratio to look at; leave them out to take the usual ones.")
    wrong = [ratio for ratio in ratios or () if not 0 < ratio < np.inf]
    if wrong:
        raise UsageError(f"ratios holds {wrong[0]}; each q/r must be positive.")
    points = [
        _point(order, ratio, noise_variance, step_s)
        for order in orders
        for ratio in sorted(ratios or (cutoff_to_ratio(order, float(cutoff)) for cutoff in _CUTOFFS))
    ]
    return Front(noise_variance, step_s, tuple(points))


def pick(
    front: Front,
    *,
    max_lag_s: float | None = None,
    bandwidth_hz: float | None = None,
    noise_gain_db: float | None = None,
) -> Pick:
    """Choose the filter for one wish: exactly, not only among the points of the grid.

    Parameters
    ----------
    front : Front
        Its orders are compared; give a front of one order to keep that.
    max_lag_s : float, optional
        The output trails neither a ramp nor a step, at half of its height, by more; the quietest wins.
    bandwidth_hz : float, optional
        The -3 dB bandwidth; the quietest wins.
    noise_gain_db : float, optional
        Noise power after over before, below 0; the quickest wins.

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
        raise UsageError(f"{len(given)} wishes came; give one of max_lag_s, bandwidth_hz and noise_gain_db.")
    dial = given[0]
    found, refused = [], []
    for order in front.orders:
        try:
            found.append(_point(order, ratio_for(order, dial, front.step_s), front.noise_variance, front.step_s))
        except UsageError as cause:
            refused.append(str(cause))
    if not found:
        raise UsageError(" ".join(dict.fromkeys(refused)))
    quickest = dial.kind == "noise_gain_db"
    ranked = sorted(found, key=lambda point: point.lag_s if quickest else point.noise_std)
    return Pick(ranked[0], _why(dial, ranked), tuple(ranked[1:]))


def _point(order: int, ratio: float, noise_variance: float, step_s: float) -> Point:
    told = describe(motion_filter(order, ratio).model, step_s)
    step = told.step
    assert step is not None  # a motion passes 0 Hz
    return Point(
        order=order,
        ratio=ratio,
        noise_std=float(np.sqrt(told.noise_gain * noise_variance)),
        noise_gain_db=told.noise_gain_db,
        lag_s=told.lag_s,
        step_50_s=step.delay_50_s,
        step_90_s=step.delay_90_s,
        bandwidth_hz=told.bandwidth_hz,
        noise_bandwidth_hz=told.noise_bandwidth_hz,
        overshoot_percent=step.overshoot_percent,
    )


def _why(dial: Dial, ranked: list[Point]) -> str:
    best, others = ranked[0], ranked[1:]
    won = "quickest" if dial.kind == "noise_gain_db" else "quietest"
    said = f"With {dial.kind} = {dial.value:.6g}, order {best.order} is the {won}: {_figures(best)}."
    rest = "; ".join(f"order {point.order}: {_figures(point)}" for point in others)
    return f"{said} {rest[:1].upper()}{rest[1:]}." if rest else said


def _figures(point: Point) -> str:
    overshoot = f", overshoot {point.overshoot_percent:.0f} %" if point.overshoot_percent >= 0.5 else ""
    return (
        f"noise {point.noise_gain_db:.1f} dB, lag {point.lag_s:.3g} s, 90 % of a step {point.step_90_s:.3g} s late,"
        f" {point.bandwidth_hz:.4g} Hz{overshoot}"
    )
