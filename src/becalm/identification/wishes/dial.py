"""Tune q/r by one setting: a lag, a bandwidth or a noise gain. Order and noise variance remain the identified ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from becalm.core.steady.dials import motion_filter, ratio_for_bandwidth, ratio_for_lag, ratio_for_noise_gain
from becalm.core.steady.response import lag_steps
from becalm.errors import UsageError
from becalm.identification.likelihood import Tuning

Kind = Literal["max_lag_s", "bandwidth_hz", "noise_gain_db"]


class Dial(NamedTuple):
    """One wish for a filter: a lag, a bandwidth or a noise gain."""

    kind: Kind
    value: float  # seconds, Hz or dB


def tune_by_dial(tuning: Tuning, dial: Dial, step_s: float, causal: bool) -> Tuning:
    """Tune a motion model to one wish.

    Parameters
    ----------
    tuning : Tuning
        The identified tuning, undamped. Its order and noise variance are kept; its tones and coloured noise are left
        out.
    dial : Dial
        The wish. A *small* lag trusts the readings; a *small* bandwidth or noise gain smooths more. A filter
        that is already faster than a wished lag keeps its ratio.
    step_s : float
        Step in seconds.
    causal : bool
        True for a filter, False for a smoother.

    Raises
    ------
    UsageError
        If no filter of this order fulfils the wish, or a lag is wanted for a smoother, or a lag that the filter exceeds
        is longer than the record.
    ModelError
        If the step is not positive.
    """
    if dial.kind == "max_lag_s" and causal:
        if lag_steps(motion_filter(tuning.order, tuning.ratio)) * step_s <= dial.value:
            return _with_ratio(tuning, tuning.ratio)  # already fast enough
        _require_within_record(dial.value, tuning.count * step_s)
    return _with_ratio(tuning, ratio_for(tuning.order, dial, step_s, causal))


def ratio_for(order: int, dial: Dial, step_s: float, causal: bool = True) -> float:
    """Return the q/r of a motion that fulfils one wish exactly.

    Parameters
    ----------
    order : int
        1 to 5.
    dial : Dial
        The wish.
    step_s : float
        Step in seconds.
    causal : bool
        True for a filter, False for a smoother.

    Raises
    ------
    UsageError
        If no filter of this order fulfils the wish, or a lag is wanted for a smoother.
    ModelError
        If the order is not 1 to 5, or the step is not positive.
    """
    kind, value = dial
    if kind not in get_args(Kind):
        raise UsageError(f"{kind!r} is not a dial; give one of {', '.join(map(repr, get_args(Kind)))}.")
    if kind == "bandwidth_hz":
        return ratio_for_bandwidth(order, value, step_s, causal)
    if kind == "noise_gain_db":
        return ratio_for_noise_gain(order, value, causal)
    if not causal:
        raise UsageError("A smoother has no lag; with --max-lag add --causal, or give --bandwidth instead.")
    return ratio_for_lag(order, value, step_s)


def may_gate(tuning: Tuning, identified: Tuning) -> bool:
    """Return whether a filter may have a gate: its q/r and noise variance must be no smaller than the identified ones.

    Order, tones and coloured noise must be the same. A slower filter does not follow the signal, and its gate would
    reject motion as spikes.
    """
    fast_enough = tuning.ratio >= identified.ratio and tuning.noise_variance >= identified.noise_variance
    same = (tuning.order, tuning.tones, tuning.coloured) == (identified.order, identified.tones, identified.coloured)
    return fast_enough and same


def _with_ratio(tuning: Tuning, ratio: float) -> Tuning:
    return replace(tuning, ratio=ratio, tones=(), coloured=None, log_likelihood=np.nan, loss=np.nan, at_edge="")


def _require_within_record(lag_s: float, lasts_s: float) -> None:
    """Raise a UsageError for a lag that is longer than the record: every filter would fulfil it."""
    if lag_s > lasts_s:
        raise UsageError(
            f"max_lag_s = {lag_s:.6g} has no effect: it is longer than the record, {lasts_s:.6g} s;"
            " give less, in seconds, or leave it out."
        )
