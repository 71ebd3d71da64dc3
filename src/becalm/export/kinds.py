"""Choose how a channel is exported: as the library's own channel, or as a settled filter in float or fixed point."""

from __future__ import annotations

from typing import get_args

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.health.outlier_rule import NO_OUTLIERS
from becalm.errors import RecipeError, UsageError
from becalm.export.channel.kind import WholeChannel
from becalm.export.design import Design
from becalm.export.fixed.kind import FixedPointFilter
from becalm.export.kind import Kind
from becalm.export.number_type import DOUBLE, FLOAT, NumberType, Precision
from becalm.export.settled.kind import Settled
from becalm.export.settled.text import schedule_in
from becalm.export.word_length import start_error

GAINS = ("auto", "settled", "full")

_STARTED = 1e-3  # largest rounding error of the first signals, over the noise std of a reading
_HIGHEST_IN_FLOAT = 3  # largest order of a motion in float: with a higher one, rounding errors exceed -120 dB


def kind_of(recipe: ChannelRecipe, design: Design, precision: Precision, gain: str) -> Kind:
    """Choose the kind of filter that a channel is exported as.

    Parameters
    ----------
    recipe : ChannelRecipe
        The recipe of the channel.
    design : Design
        The filter of the channel.
    precision : {"float32", "float64", "q31"}
        Number type of the filter.
    gain : {"auto", "settled", "full"}
        "full" is the library's own channel, with a covariance; "settled" is a filter without covariance. With "auto"
        the filter has a covariance if the recipe needs one or rejects gross outliers; in float64 also if an exact table
        of gains would be too long; in float32 also from order 4 on, or if the first readings hardly determine the
        state.

    Raises
    ------
    RecipeError
        If the precision or the gain does not support the recipe.
    UsageError
        If the precision or the gain does not exist, or a covariance is wanted in q31.
    """
    if precision not in get_args(Precision):
        raise UsageError(f"There is no precision {precision!r}; write float32, float64 or q31.")
    if gain not in GAINS:
        raise UsageError(f"There is no gain {gain!r}; write auto, settled or full.")
    needs = _needs(design)
    if needs and (gain == "settled" or precision == "q31"):
        option = "--gain settled" if gain == "settled" else "--precision q31"
        raise RecipeError(
            f"{design.name} {needs} a covariance, which {option} does not carry; leave that out, or"
            f" {_alternative(design)}."
        )
    if precision == "q31":
        if gain == "full":
            raise UsageError("Fixed point carries no covariance; leave --gain full out, or use --precision float32.")
        return FixedPointFilter()
    number = DOUBLE if precision == "float64" else FLOAT
    if needs or gain == "full" or (gain == "auto" and _is_better_whole(design, number)):
        return WholeChannel.for_design(number, recipe, design)
    if not number.is_double and _is_lost_at_first(design, number):
        raise RecipeError(
            f"{design.name}: its first readings hardly determine its state, and float would lose the digits; leave"
            " --gain settled out, or use --precision float64."
        )
    return Settled(number)


def _is_better_whole(design: Design, number: NumberType) -> bool:
    """Return whether the library's own channel is better, although no covariance is needed.

    It is better if the recipe rejects gross outliers, in double if the table of gains would be thinned, and in float if
    states would lose digits.
    """
    if design.limits.outliers != NO_OUTLIERS:
        return True
    if number.is_double:
        return not schedule_in(design, number).exact
    return design.motion_order > _HIGHEST_IN_FLOAT or _is_lost_at_first(design, number)


def _is_lost_at_first(design: Design, number: NumberType) -> bool:
    """Return whether the rounding errors of the first signals are too large."""
    return start_error(design, number) > _STARTED * design.noise_std


def _alternative(design: Design) -> str:
    """Return how the user can avoid the need for a covariance."""
    if design.modes is not None:
        return "take [channel.switching] out of the recipe"
    if design.gate is not None:
        return "take [channel.gate] out of the recipe"
    return "give it a process_noise_density above 0"


def _needs(design: Design) -> str:
    """Return why a channel needs a covariance, as the start of a clause; "" if it needs none."""
    if design.modes is not None:
        return "has several modes, which need"
    if design.gate is not None:
        return "has a gate, which needs"
    return "" if design.steady is not None else "has no steady state, which needs"
