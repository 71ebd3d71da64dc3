"""One dial in an engineer's words: it sets q/r, and leaves to the recording what it told of noise and order."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from becalm.core.steady.dials import motion_filter, ratio_for_bandwidth, ratio_for_lag, ratio_for_noise_gain
from becalm.core.steady.step_response import lag_steps
from becalm.errors import UsageError
from becalm.identification.likelihood import Tuning

Kind = Literal["max_lag_s", "bandwidth_hz", "noise_gain_db"]


class Dial(NamedTuple):
    """What is asked of a filter, all else left to the recording."""

    kind: Kind
    value: float


def turn(tuning: Tuning, dial: Dial, step_s: float, causal: bool) -> Tuning:
    """Tune a motion as a dial asks.

    Parameters
    ----------
    tuning : Tuning
        What was found; its order and noise variance stay; tones and coloured noise beside it are left out.
    dial : Dial
        A *small* lag trusts the readings; a *small* bandwidth or noise gain smooths more.
    step_s : float
        Step in seconds.
    causal : bool
        Whether a filter or a smoother shall have what is asked.

    Raises
    ------
    UsageError
        If nothing of this order has it, or a lag is asked of a smoother or longer than the record.
    """
    if dial.kind == "max_lag_s" and causal:
        if lag_steps(motion_filter(tuning.order, tuning.ratio)) * step_s <= dial.value:
            return _at(tuning, tuning.ratio)  # quick enough as it is
        _refuse_longer(dial.value, tuning.count * step_s)
    return _at(tuning, ratio_for(tuning.order, dial, step_s, causal))


def ratio_for(order: int, dial: Dial, step_s: float, causal: bool = True) -> float:
    """Return the q/r of a motion that has exactly what a dial asks.

    Parameters
    ----------
    order : int
        1 to 5.
    dial : Dial
        What is asked.
    step_s : float
        Step in seconds.
    causal : bool
        Whether a filter or a smoother shall have it.

    Raises
    ------
    UsageError
        If nothing of this order has it, or a lag is asked of a smoother.
    """
    kind, value = dial
    if kind == "bandwidth_hz":
        return ratio_for_bandwidth(order, value, step_s, causal)
    if kind == "noise_gain_db":
        return ratio_for_noise_gain(order, value, causal)
    if not causal:
        raise UsageError("A smoother has no lag; with --max-lag add --causal, or ask for --bandwidth.")
    return ratio_for_lag(order, value, step_s)


def may_judge(tuning: Tuning, identified: Tuning) -> bool:
    """Return whether a gate may judge by a filter: one that is as quick as the identified filter, and as wide.

    A slower filter does not follow the signal, and its gate takes motion for spikes.
    """
    quick = tuning.ratio >= identified.ratio and tuning.noise_variance >= identified.noise_variance
    same = (tuning.order, tuning.lines, tuning.coloured) == (identified.order, identified.lines, identified.coloured)
    return quick and same


def _at(tuning: Tuning, ratio: float) -> Tuning:
    return replace(tuning, ratio=ratio, lines=(), coloured=None, log_likelihood=np.nan, loss=np.nan, at_edge="")


def _refuse_longer(lag_s: float, lasts_s: float) -> None:
    """Refuse a lag that no filter of the record could exceed."""
    if lag_s > lasts_s:
        raise UsageError(
            f"max_lag_s = {lag_s:.6g} asks nothing: it is longer than the readings last, {lasts_s:.6g} s;"
            " give less, in seconds, or leave it out."
        )
