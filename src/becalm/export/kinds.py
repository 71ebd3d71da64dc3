"""Which kind of filter a channel is written as."""

from __future__ import annotations

from typing import get_args

from becalm.cleaning.recipe import ChannelRecipe
from becalm.core.health.outlier_rule import NO_OUTLIERS
from becalm.errors import RecipeError, UsageError
from becalm.export.channel.kind import WholeChannel
from becalm.export.design import Design
from becalm.export.fixed.kind import FixedPointFilter
from becalm.export.kind import Kind
from becalm.export.number_type import DOUBLE, FLOAT, NumberType, Precision
from becalm.export.settled.kind import Settled
from becalm.export.settled.text import schedule_in
from becalm.export.word_length import start_of

GAINS = ("auto", "settled", "full")

_STARTED = 1e-3  # of a reading's noise: what rounding may leave of first signals
_HIGHEST_IN_FLOAT = 3  # order of a motion: above, rounded derivatives leave less than 120 dB of a signal that moves


def kind_of(recipe: ChannelRecipe, design: Design, precision: Precision, gain: str) -> Kind:
    """Choose how a channel is written.

    Parameters
    ----------
    recipe : ChannelRecipe
        What was decided for it.
    design : Design
        Its filter.
    precision : {"float32", "float64", "q31"}
        What it computes in.
    gain : {"auto", "settled", "full"}
        Whether a covariance is carried, as the library's own channel does; "auto" carries one where the recipe needs
        it, or says what is no reading; in float64 where a table of gains that is exact from the first reading on would
        be too long, and in float32 from order 4 on, and where the first readings hardly tell its state.

    Raises
    ------
    RecipeError
        If the recipe needs what this precision, or this gain, cannot do.
    UsageError
        If there is no such precision, or gain.
    """
    if precision not in get_args(Precision):
        raise UsageError(f"There is no precision {precision!r}; write float32, float64 or q31.")
    if gain not in GAINS:
        raise UsageError(f"There is no gain {gain!r}; write auto, settled or full.")
    needs = _needs(design)
    if needs and (gain == "settled" or precision == "q31"):
        asked = "--gain settled" if gain == "settled" else "--precision q31"
        raise RecipeError(
            f"{design.name} {needs} a covariance, which {asked} has not; leave that out, or {_mend(design)}."
        )
    if precision == "q31":
        if gain == "full":
            raise UsageError("Fixed point carries no covariance; leave --gain full out, or use --precision float32.")
        return FixedPointFilter()
    number = DOUBLE if precision == "float64" else FLOAT
    if needs or gain == "full" or (gain == "auto" and _is_better_whole(design, number)):
        return WholeChannel.alone(number, recipe, design)
    if not number.is_double and _is_lost_at_first(design, number):
        raise RecipeError(
            f"{design.name}: its first readings hardly tell its state, and float would lose the digits; leave --gain"
            " settled out, or use --precision float64."
        )
    return Settled(number)


def _is_better_whole(design: Design, number: NumberType) -> bool:
    """Whether the library's channel serves where no covariance is needed.

    It looks for gross outliers; a table would be thinned in double, and states lost in float.
    """
    if design.limits.outliers != NO_OUTLIERS:
        return True
    if number.is_double:
        return not schedule_in(design, number).exact
    return design.motion_order > _HIGHEST_IN_FLOAT or _is_lost_at_first(design, number)


def _is_lost_at_first(design: Design, number: NumberType) -> bool:
    """Whether rounding is seen in the first signals: far beyond, a start makes it grow without end."""
    return start_of(design, number) > _STARTED * design.noise_std


def _mend(design: Design) -> str:
    """Say how a channel needs none."""
    if design.modes is not None:
        return "take [channel.switching] out of the recipe"
    if design.gate is not None:
        return "take [channel.gate] out of the recipe"
    return "give it a process_noise_density above 0"


def _needs(design: Design) -> str:
    """Say why a channel needs a covariance; nothing where it needs none."""
    if design.modes is not None:
        return "switches between modes, which needs"
    if design.gate is not None:
        return "has a gate, which needs"
    return "" if design.steady is not None else "never settles, which needs"
