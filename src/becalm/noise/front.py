"""The front of noise against lag: what every filter would leave and how late it would be, before any is run.

Predicted from the Riccati solution and the variance of a reading alone. Of the signal it knows nothing: what
a filter does to that, its bandwidth and overshoot tell, and which order fits it, the likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from becalm.core.components import ORDERS
from becalm.core.dials import motion_filter, ratio_for_bandwidth, ratio_for_lag, ratio_for_noise_gain
from becalm.core.response import decibels, describe
from becalm.errors import UsageError
from becalm.noise.likelihood import cutoff_to_ratio

_CUTOFFS = np.geomspace(1e-4, 4.0, 48)  # radians a step
_WAITS = np.append(0.0, np.geomspace(0.05, 6.0, 40))  # in units of 1 / cut-off
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
        How far the output trails, and a step at half and at nine tenths of its height; see `core.response`.
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


@dataclass(frozen=True)
class Wait:
    """What is left if the output may wait for later readings.

    Attributes
    ----------
    wait_s : float
        0 is the filter, inf the smoother.
    sigma : float
        Standard deviation of the error where the model holds, in unit.
    noise_std : float
        Standard deviation of a reading's noise that is left, in unit.
    gain_db : float
        How much less error power than the filter leaves, in dB.
    """

    wait_s: float
    sigma: float
    noise_std: float
    gain_db: float


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
    _refuse_variance(noise_variance)
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
    wishes = {"max_lag_s": max_lag_s, "bandwidth_hz": bandwidth_hz, "noise_gain_db": noise_gain_db}
    given = [name for name, value in wishes.items() if value is not None]
    if len(given) != 1:
        raise UsageError(f"{len(given)} wishes came; give one of max_lag_s, bandwidth_hz and noise_gain_db.")
    name = given[0]
    found, refused = [], []
    for order in front.orders:
        try:
            ratio = _ratio_for(name, order, float(wishes[name] or 0.0), front.step_s)
            found.append(_point(order, ratio, front.noise_variance, front.step_s))
        except UsageError as cause:
            refused.append(str(cause))
    if not found:
        raise UsageError(" ".join(dict.fromkeys(refused)))
    quickest = name == "noise_gain_db"
    ranked = sorted(found, key=lambda point: point.lag_s if quickest else point.noise_std)
    return Pick(ranked[0], _why(name, float(wishes[name] or 0.0), ranked), tuple(ranked[1:]))


def waiting_curve(
    order: int, ratio: float, noise_variance: float, step_s: float, waits: Sequence[int] | None = None
) -> tuple[Wait, ...]:
    """Return the curve from the filter over fixed lags to the smoother: what waiting for later readings gains.

    Parameters
    ----------
    order : int
        1 to 5.
    ratio : float
        q/r, as in `Tuning.ratio`.
    noise_variance : float
        r of a reading, in unit^2.
    step_s : float
        Step in seconds.
    waits : sequence of int, optional
        Later readings that are waited for; by default to 6 / cut-off. The smoother comes last in any case.

    Raises
    ------
    UsageError
        If the ratio is not positive or a wait is negative.
    """
    if not 0 < ratio < np.inf or any(not wait >= 0 for wait in waits or ()):
        raise UsageError(f"ratio = {ratio} and waits = {waits}: q/r must be positive, and no wait below 0.")
    _refuse_variance(noise_variance)
    found = motion_filter(order, ratio)
    steps = np.unique(np.round(_WAITS / ratio ** (1 / (2 * order)))) if waits is None else np.sort(np.asarray(waits))
    alone = found.error_variance()
    curve = []
    for wait in (*steps.tolist(), np.inf):
        error, noise = found.error_variance(wait), found.noise_gain(wait)
        sigma, left = np.sqrt(error * noise_variance), np.sqrt(noise * noise_variance)
        curve.append(Wait(wait * step_s, float(sigma), float(left), decibels(alone / error)))
    return tuple(curve)


def _refuse_variance(noise_variance: float) -> None:
    if not 0 < noise_variance < np.inf:
        raise UsageError(f"noise_variance = {noise_variance} is no variance; give a positive number in unit^2.")


def _ratio_for(wish: str, order: int, value: float, step_s: float) -> float:
    if wish == "max_lag_s":
        return ratio_for_lag(order, value, step_s)
    return ratio_for_bandwidth(order, value, step_s) if wish == "bandwidth_hz" else ratio_for_noise_gain(order, value)


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


def _why(wish: str, value: float, ranked: list[Point]) -> str:
    best, others = ranked[0], ranked[1:]
    won = "quickest" if wish == "noise_gain_db" else "quietest"
    said = f"With {wish} = {value:.6g}, order {best.order} is the {won}: {_figures(best)}."
    rest = "; ".join(f"order {point.order}: {_figures(point)}" for point in others)
    return f"{said} {rest[:1].upper()}{rest[1:]}." if rest else said


def _figures(point: Point) -> str:
    overshoot = f", overshoot {point.overshoot_percent:.0f} %" if point.overshoot_percent >= 0.5 else ""
    return (
        f"noise {point.noise_gain_db:.1f} dB, lag {point.lag_s:.3g} s, 90 % of a step {point.step_90_s:.3g} s late,"
        f" {point.bandwidth_hz:.4g} Hz{overshoot}"
    )
